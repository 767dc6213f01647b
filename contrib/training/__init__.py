"""Training: the networks of the method, of the baselines and of stereo, on stored samples."""
