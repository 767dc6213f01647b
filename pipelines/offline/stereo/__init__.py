"""Depth from pairs of cameras: rectification undone, semi-global matching, RAFT-Stereo, and the
fusion of pairs.
"""
