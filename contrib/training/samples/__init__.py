"""Training samples: views of procedural rooms and of captures, computed once and stored on disk."""
