"""A camera between the cameras: its trajectory, live synthesis, and its film."""
