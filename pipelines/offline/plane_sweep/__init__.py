"""Depth from all partners at once, by sweeping planes through the scene."""
