"""FWD (Cao, Rockwell, Johnson, CVPR 2022): features of every view warped forward as points, fused by attention, decoded."""
