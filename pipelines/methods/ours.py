"""The paper's method and its ablations, with trained and with geometric weights."""

from functools import partial
from typing import TYPE_CHECKING, Any

from ggvs_eval.method import Method
from ggvs_eval.pipelines.methods.spec import OnlineMethod, make, shipped
from ggvs_eval.plugins import DEVICE_PARTS, missing_part

if TYPE_CHECKING:
    from ggvs_eval.pipelines.online.network_inputs import Guidance

ONLINE = "ggvs_eval.pipelines.online"
GEOMETRIC = (f"{ONLINE}.geometry_guided", f"{ONLINE}.blending")
LEARNED = (f"{ONLINE}.geometry_guided", f"{ONLINE}.network_blender")
_STEP = str(DEVICE_PARTS.root("online step"))
ON_DEVICE = () if missing_part(_STEP) else (_STEP,)  # with or without Warp: another machine may have it
OFFLINE = (f"{ONLINE}.whole_sequence",)

# What the paper does not have, as the table of differences says it.
UNFUSED = "adds exposure compensation and a recurrent output where nothing moves"
INSTANT = "adds exposure compensation, settled and forgiven depth"
ADDED = "adds exposure compensation, settled and forgiven depth and a recurrent output where nothing moves"


def _geometric(options: Any = None, background: bool = True, **changed: Any) -> Method:
    """With geometric weights in place of the network, and `OnlineOptions` or some of them."""
    from ggvs_eval.pipelines.online.blending import GeometricBlender
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions

    return GeometryGuided(options or OnlineOptions(**changed), GeometricBlender(background=background))


def _learned(options: Any = None, guidance: "Guidance" = "registered", device: str = "cpu", **changed: Any) -> Method:
    """With the network that ships for a guidance, on a device, and `OnlineOptions` or some of them.

    The one place that chooses: on a GPU with Warp (``ggvs-eval[gpu]``) every stage computes there, without it the network alone.
    """
    from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
    from ggvs_eval.pipelines.online.network_blender import NetworkBlender

    options = options or OnlineOptions(**changed)
    if device != "cpu" and "online step" in DEVICE_PARTS:
        on_device = DEVICE_PARTS["online step"]
        if on_device.covers(options, guidance):
            return on_device(options, guidance, device)
    return GeometryGuided(options, NetworkBlender(guidance=guidance, device=device))


OURS: dict[str, OnlineMethod] = {
    "naive": OnlineMethod(
        "Naive Network",
        "splatted views alone: the network was trained without any depth, neither fused nor of the views",
        LEARNED,
        _learned,
        given={"guidance": "naive", "fused": False},
        takes=("device",),
        device_modules=ON_DEVICE,
        departs=UNFUSED,
        ours=True,
        usual=False,
        weights=(shipped("blend-naive.safetensors"),),
    ),
    "ours+no-tsdf": OnlineMethod(
        "GGVS (online), no TSDF guidance",
        "no fused depth; the network was trained without it",
        LEARNED,
        _learned,
        given={"guidance": "none", "fused": False},
        takes=("device",),
        device_modules=ON_DEVICE,
        departs=UNFUSED,
        ours=True,
        weights=(shipped("blend-no-tsdf.safetensors"),),
    ),
    "ours+no-temporal": OnlineMethod(
        "GGVS (online), no temporal filtering",
        "without temporal depth filter, temporal term of the ray march and recurrent output",
        LEARNED,
        _learned,
        given={"guidance": "registered", "temporal": False},
        takes=("device",),
        device_modules=ON_DEVICE,
        departs=INSTANT,
        ours=True,
        weights=(shipped("blend.safetensors"),),
    ),
    "ours": OnlineMethod(
        "GGVS (online)",
        "the whole online method: splats, filtered and fused depth, blending network",
        LEARNED,
        _learned,
        device_modules=ON_DEVICE,
        departs=ADDED,
        ours=True,
        weights=(shipped("blend.safetensors"),),
        takes=("options", "device"),
    ),
    "ours-geometric": OnlineMethod(
        "GGVS (online), geometric weights",
        "the whole online method with geometric weights in place of the blending network",
        GEOMETRIC,
        _geometric,
        departs=ADDED,
        ours=True,
        takes=("options",),
    ),
    "ours-geometric+no-temporal": OnlineMethod(
        "GGVS (online), geometric weights, no temporal filtering",
        "without temporal depth filter, temporal term of the ray march and recurrent output",
        GEOMETRIC,
        _geometric,
        given={"temporal": False},
        departs=INSTANT,
        ours=True,
        usual=False,
    ),
    "ours-geometric+point-splat": OnlineMethod(
        "GGVS (online), geometric weights, point splats",
        "views rendered forward as points of one pixel, not as pixel-sized Gaussians",
        GEOMETRIC,
        _geometric,
        given={"splatted_as": "points"},
        departs=ADDED,
        ours=True,
        usual=False,
    ),
    "ours-geometric+no-background": OnlineMethod(
        "GGVS (online), geometric weights, no background blending",
        "areas without a source view stay black",
        GEOMETRIC,
        _geometric,
        given={"background": False},
        departs=ADDED,
        ours=True,
        usual=False,
    ),
    "ours-geometric+offline": OnlineMethod(
        "GGVS (offline), geometric weights",
        "a reference that uses the whole sequence: depth filtered backwards in time, then forwards",
        OFFLINE,
        partial(make, "ggvs_eval.pipelines.online.whole_sequence:WholeSequence"),
        departs=ADDED,
        ours=True,
        online=False,
        usual=False,
    ),
}
