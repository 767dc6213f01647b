"""GPS-Gaussian (Zheng et al., CVPR 2024): stereo of one rectified pair, one Gaussian per pixel, all of them rendered at once."""
