"""The online method as labels name it: with trained or with geometric weights, and other
options.
"""

from typing import Any

from ggvs_eval.method import Method
from ggvs_eval.pipelines.online.blending import GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from ggvs_eval.pipelines.online.network_inputs import Guidance
from ggvs_eval.plugins import DEVICE_PARTS


def geometric(
    options: OnlineOptions | None = None, background: bool = True, **changed: Any
) -> Method:
    """With geometric weights in place of the network, and `OnlineOptions` or some of them."""
    return GeometryGuided(
        options or OnlineOptions(**changed), GeometricBlender(background=background)
    )


def learned(
    options: OnlineOptions | None = None,
    guidance: Guidance = "registered",
    device: str = "cpu",
    **changed: Any,
) -> Method:
    """With the network that ships for a guidance, on a device, and `OnlineOptions` or some of them.

    The one place that chooses: on a GPU with Warp (``ggvs-eval[gpu]``) every stage computes there,
    without it the network alone.
    """
    from ggvs_eval.pipelines.online.network_blender import NetworkBlender

    options = options or OnlineOptions(**changed)
    if device != "cpu" and "online step" in DEVICE_PARTS:
        on_device = DEVICE_PARTS["online step"]
        if on_device.covers(options, guidance):
            return on_device(options, guidance, device)
    return GeometryGuided(options, NetworkBlender(guidance=guidance, device=device))
