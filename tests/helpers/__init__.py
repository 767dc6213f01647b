"""What several tests build on: captures and scenes made by hand, readers of pages, and numpy twins
of kernels.
"""
