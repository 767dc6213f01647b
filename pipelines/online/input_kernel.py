"""The blending network's input by a compiled kernel: what `input_channels` says, which defines this in the tests."""

import numpy as np

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.kernels import get_threads
from ggvs_eval.pipelines.online.blend_maps import BlendMaps, Guidance
from ggvs_eval.pipelines.online.network_inputs import GUIDED, input_channels, ray_slopes, reference_depth


def network_channels(maps: BlendMaps, guidance: Guidance, views: int) -> Map:
    """The channels of the network's input, (channels, H, W); by the kernel where the fused depth guides.

    Args:
        maps: the views, K of them, of the network's own size.
        guidance: as in `input_channels`.
        views: how many views the network is made for.
    """
    if guidance not in GUIDED:
        return input_channels(maps, guidance, views)
    from ggvs_eval.kernels import _core

    target, unit = maps.target, reference_depth(maps.fused_depth, maps.target)
    stacks = (maps.colours, maps.depths, maps.alphas)
    colours, depths, alphas = (np.ascontiguousarray(each, np.float32) for each in stacks)
    seen = np.ascontiguousarray(maps.seen, np.float32) if guidance == "registered" else None
    fused = np.ascontiguousarray(maps.fused_depth, np.float32)
    centres = np.stack([rigid_between(source, target)[:3, 3] for source in maps.sources])
    distances = [float(np.linalg.norm(source.centre - target.centre)) / unit for source in maps.sources]
    axes = [float(source.axis @ target.axis) for source in maps.sources]
    cameras = centres.astype(np.float32), np.array(distances, np.float32), np.array(axes, np.float32)
    settings = (target.far, unit, views, get_threads())
    return _core.network_inputs(colours, depths, alphas, seen, fused, ray_slopes(target), cameras, *settings)
