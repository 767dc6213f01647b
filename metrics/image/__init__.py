"""Fidelity of single frames: differences of pixels, structure, learned features, parts of the
image.
"""
