"""From frames on disk to numbers."""
