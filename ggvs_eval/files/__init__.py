"""Files that several rooms read or write: images, videos, TOML tables, trained weights, digests."""
