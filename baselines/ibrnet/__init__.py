"""IBRNet (Wang et al. 2021): colours of the source views, blended along each target ray by a network that was trained once."""
