"""The online step on a device: NVIDIA Warp kernels and torch, one source for GPUs and for Warp's CPU device."""
