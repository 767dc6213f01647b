"""Depth of every camera: which partners, by which matcher, checked against other cameras, and
stored.
"""
