"""Parts of training samples, on a device: views splatted and warped, and what geometric weights
make of them.
"""

from collections.abc import Mapping

import torch
from torch import Tensor

from ggvs_eval.arrays import Map
from ggvs_eval.compute_device import out_of_memory
from ggvs_eval.contrib.warp.filter import weigh_depths
from ggvs_eval.contrib.warp.march import march
from ggvs_eval.contrib.warp.picture import fill_holes
from ggvs_eval.contrib.warp.registration import settle_depth, warp_views
from ggvs_eval.contrib.warp.splat import DeviceSplats, splat_views
from ggvs_eval.contrib.warp.step import PAIRS_PER_GAUSSIAN, ROOM, Program
from ggvs_eval.contrib.warp.tables import Sizes
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.geometry.tsdf import march_end
from ggvs_eval.method import Instant
from ggvs_eval.pipelines.online.blend_network import weighted_mean_tensor
from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions


def sampled_maps(instant: Instant, options: OnlineOptions, device: torch.device) -> dict[str, Map]:
    """Compute the maps of one instant that a training sample holds, and the geometric blender's
    picture.

    Args:
        instant: its sources have the order of the maps.
        options: constants of the method; what would need an instant before is left out.
        device: a GPU, or the CPU for tests.

    Returns:
        By the names of a training sample, all float32: ``splats`` and ``warps``, (K, H, W, 3),
        ``alphas``, ``depths`` and ``visibilities``, (K, H, W), ``fused_depth``, (H, W);
        ``geometric``: the picture of `GeometricBlender`, (H, W, 3).

    Raises:
        DeviceError: the GPU's memory is out.

    Reading:
        On a CPU all except the colours of warps and of the picture have the bits of the compiled
        path; those differ by up to 1e-6, since images are taken in 8 bit here, and in [0, 1] by
        `warp`.
    """
    target, sources, room = instant.target, instant.sources, PAIRS_PER_GAUSSIAN
    tau = options.tau_m * instant.units_per_metre
    with out_of_memory(device, "take smaller samples"), torch.inference_mode():
        program = Program(
            Sizes(tuple(source.camera.size for source in sources), target.size, 1), 1, device
        )
        end = march_end(target, tau, options.min_step, [source.depth for source in sources])
        program.constants.fill(instant, sources, options, end, None, [0] * program.sizes.pairs)
        program.upload(sources, 0)
        with program.working(launching=True):
            while True:
                maps, crowding = _maps(program, options, room)
                *arrays, needed = program.downloaded(
                    [tensor.contiguous() for tensor in (*maps.values(), crowding)]
                )
                if needed[0] <= room:
                    return dict(zip(maps, arrays, strict=True))
                room = ROOM * float(needed[0])


def _maps(
    program: Program, options: OnlineOptions, room: float
) -> tuple[Mapping[str, Tensor], Tensor]:
    """Compute `sampled_maps` on the device, with `DeviceSplats.crowding`."""
    c, t, images, depths = (
        program.constants,
        program.tables,
        program.states[0].images,
        program.depths,
    )
    splats = splat_views(images, depths, torch.ones_like(depths), c, t, room)
    weights, past, out = (
        weigh_depths(depths, c, t),
        program.states[1].march,
        program.states[0].march,
    )
    no_gain = torch.full_like(out[0], -1.0)  # no past
    march(depths, weights, past, no_gain, c, t, (options.min_step, options.eta), out)
    surface = settle_depth(out[0], images, splats, c, t) if options.settled else out[0]
    warps, visibilities = warp_views(surface, images, depths, c, t)
    blended = _blend_geometrically(program, splats, warps, visibilities)
    maps = {
        "splats": splats.features[..., :3],
        "alphas": splats.alphas,
        "depths": splats.depths,
        "warps": warps.permute(0, 2, 3, 1),
        "visibilities": visibilities,
        "fused_depth": surface,
        "geometric": blended.permute(1, 2, 0),
    }
    return maps, splats.crowding


def _blend_geometrically(
    program: Program, splats: DeviceSplats, warps: Tensor, visibilities: Tensor
) -> Tensor:
    """Blend warped views by visibility and parallax over the splats' mean, (3, H, W), as
    `GeometricBlender` does.
    """
    weights = program.constants.weights[:, None, None]
    splatted = splats.features[..., :3].permute(0, 3, 1, 2)
    mean = weighted_mean_tensor(splatted[None], (weights * splats.alphas)[None])[0]
    covered = (splats.alphas > COVERED_ALPHA).any(dim=0).float()
    background = fill_holes(mean.contiguous(), covered, program.tables)
    surface = weighted_mean_tensor(warps[None], (weights * visibilities)[None])[0]
    return surface + (1 - visibilities.sum(dim=0).clamp(max=1)) * (background - surface)
