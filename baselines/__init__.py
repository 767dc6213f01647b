"""Baselines of the paper, behind one interface."""
