"""What every training shares: its task, loop, checkpoints, log, curves and card."""
