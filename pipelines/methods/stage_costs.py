"""Time of a run's stages before they begin: known costs of this package's stages, by the pace of
this machine.
"""

from ggvs_eval.protocol import Measurement
from ggvs_eval.results import split_label

# Core-seconds per megapixel at `pace` 1, K = 4, frames of 480 x 360 to 1352 x 1014; a plug-in's
# method has none until it has rendered a frame. of what has one way to be made
COSTS = {"truth": 0.3, "checked depth": 0.5, "mask": 0.3, "path depth": 0.6}
DEPTH = {"sgbm": 4.0, "live": 0.9, "raft": 25.0, "itermvs": 26.0}
RENDERED = {
    "no-blending": 0.3,
    "distance-based": 0.3,
    "ours-geometric": 0.6,
    "ours": 0.8,
    "fwd": 5.0,
    "gps-gaussian": 35.0,
    "enerf": 23.0,
    "ibrnet": 125.0,
    "mvsplat": 60.0,
    "mvsnerf": 400.0,
    "interpolation": 0.6,
}
SCORED, LPIPS = 0.3, {"vgg": 2.0, "vgg-bf16": 2.5, "alex": 0.4}
# Per pixel: frames as PNG, with and without sensor noise as on the demo; depth as it is stored;
# renders and their small copies.
N_BYTES = {
    "truth": 2.1,
    "depth": 2.9,
    "checked depth": 2.9,
    "path depth": 4.0,
    "render": 1.95,
    "path render": 1.95,
}
# Each stage of a plan's table, and what makes it shorter.
STAGES: dict[str, str] = {
    "decoding": "fewer views.test",
    "depth": "fewer views.test or --matcher live",
    "fits": "+steps=N in a fitted method's label",
    "rendering": "fewer methods, a smaller synthesis.width or --device cuda",
    "scoring": "a larger measurement.lpips_every or --device cuda",
}


def depth_cost(matcher: str) -> float | None:
    """Return the core-seconds per megapixel of a depth map; None if they are not known."""
    return DEPTH.get(matcher.partition(":")[0].partition("+")[0])


def render_cost(label: str) -> float | None:
    """Return the core-seconds per megapixel of a method's frame; None if they are not known."""
    return RENDERED.get(split_label(label)[0])


def score_cost(measurement: Measurement) -> float:
    """Return the core-seconds per megapixel of scoring one method's frame."""
    wants_lpips = any(name.startswith("LPIPS") for name in measurement.metrics)
    return SCORED + wants_lpips * LPIPS[measurement.lpips_net] / measurement.lpips_every


def stage_of(kind: str) -> str:
    """Return the row of a plan's table that a kind of piece belongs to."""
    stages = {
        "truth": "decoding",
        "fit": "fits",
        "render": "rendering",
        "path render": "rendering",
        "score": "scoring",
    }
    return stages.get(kind, "depth")
