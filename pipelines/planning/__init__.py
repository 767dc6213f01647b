"""A run before it starts: what is left to do, how large, how long."""
