"""Baselines beyond the usual ones: MVSplat and MVSNeRF."""
