"""What ships, by kind and name: as text, in the form of outsiders' entry points, so that whoever names a thing does not load it.

Parts of `contrib` stand here like everything else; one whose package is not there is left out.
"""

# The online step, the finish of found depth, and training samples, where another device computes them.
DEVICE_STEPS = {"warp": "ggvs_eval.contrib.warp.step:DeviceGuided"}
DEVICE_FINISHES = {"warp": "ggvs_eval.contrib.warp.depth:finish_maps"}
DEVICE_SAMPLES = {"warp": "ggvs_eval.contrib.warp.sampling:sampled_maps"}
