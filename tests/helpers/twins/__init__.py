"""Slow, readable versions of the compiled kernels: they define what the kernels compute."""
