"""The training of any network: what it is told, its loop, and what it leaves on disk."""
