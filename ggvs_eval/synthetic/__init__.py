"""Included demo captures: a procedural dynamic room, filmed by rigs like those of three
data sets.
"""
