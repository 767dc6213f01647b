"""Filming: the cameras of a rig or of a hand, the rays of their pixels, and the sensors of light
and depth.
"""
