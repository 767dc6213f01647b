"""Rectified pairs with exact disparity, for stereo networks to learn from."""
