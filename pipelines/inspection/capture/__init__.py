"""Checks of a capture: faults that would spoil results, detected before it is used."""
