"""Depth page: maps, confidence and rectified pairs for a person to look at before trusting depth."""
