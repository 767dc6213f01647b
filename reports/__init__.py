"""Reports: tables, slices, curves and the page, read from run folders on disk.

Nothing is rendered or measured here.
"""
