"""Samples to train on: views of procedural rooms and of captures, made once and kept on disk."""
