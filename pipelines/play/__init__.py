"""A camera between the cameras: its trajectory, live synthesis, and the film of what it sees."""
