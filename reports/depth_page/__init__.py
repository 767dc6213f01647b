"""Depth page: maps, confidence and rectified pairs for inspection of depth before a run."""
