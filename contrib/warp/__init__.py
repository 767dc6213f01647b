"""The online step on a device: every stage by kernels of NVIDIA Warp, recorded in one CUDA graph on
a GPU.
"""
