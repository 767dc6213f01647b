"""Training of the blending network."""
