"""Temporal stability: over the frames of a view, and over the views of an instant."""
