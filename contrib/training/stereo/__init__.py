"""Training of the stereo network."""
