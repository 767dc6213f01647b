"""Methods that are fitted to one scene: offline references of 3D Gaussians, and methods between
them and the online method.
"""
