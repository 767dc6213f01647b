"""Geometry of the method and of rigs: splatting, image-based TSDF, warping, epipolar lines, sources
of a view.
"""
