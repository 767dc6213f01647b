"""Depth from elsewhere: maps of another program in place of stereo, aligned with the capture's
calibration.
"""
