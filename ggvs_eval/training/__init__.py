"""Training loop, options and checkpoints."""
