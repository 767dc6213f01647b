"""Optional parts: each folder can be deleted, and a table of the core lists what it provides."""
