"""Validation of depth: matchers against measured disparity, sparse points, exact depth, and
themselves over time.
"""
