"""Filming: the cameras of a rig or of a hand, the rays of their pixels, and what sensors make of light and depth."""
