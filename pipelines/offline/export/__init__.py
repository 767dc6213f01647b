"""Depth for other programs: a fused point cloud and mesh, a COLMAP dense workspace."""
