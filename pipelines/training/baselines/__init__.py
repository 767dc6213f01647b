"""Training of the learned baselines."""
