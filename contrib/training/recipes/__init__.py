"""Recipes of learned baselines on top of the shared training: network, loss, validation view."""
