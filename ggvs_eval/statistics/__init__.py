"""Uncertainty of a number: variance over views and time, intervals, paired comparisons, ties."""
