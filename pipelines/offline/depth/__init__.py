"""Depth of every camera: which partners, by which matcher, held against other cameras, and stored."""
