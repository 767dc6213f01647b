"""Depth that a sensor measured: registered to its colour, cleaned, its holes closed and filled
along colours.
"""
