"""Sweeps: many runs over captures, methods and variants of the protocol, and one table of them."""
