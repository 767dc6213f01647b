"""What the package can do without: each folder can be deleted, and a table of the core names what it brings."""
