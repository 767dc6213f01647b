"""Training of the stereo network: procedural data made on the fly and the loop that learns from it."""
