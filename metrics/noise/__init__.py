"""Noise of sensor and codec in captured views."""
