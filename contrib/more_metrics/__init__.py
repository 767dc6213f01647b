"""Metrics beyond the usual ones: of other packages, of networks that must be fetched, of COLMAP,
and their conventions.
"""
