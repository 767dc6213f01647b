"""Files of every kind that more than one room reads or writes: images, videos, TOML tables, trained weights, digests."""
