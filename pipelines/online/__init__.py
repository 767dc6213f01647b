"""The method of the paper: one step per instant."""
