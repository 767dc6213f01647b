"""Results and Gaussians for other programs: trackers, and glTF with KHR_gaussian_splatting."""
