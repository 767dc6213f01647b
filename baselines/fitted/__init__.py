"""Methods that are fitted to one scene: offline references of 3D Gaussians, and what is between them and the online method."""
