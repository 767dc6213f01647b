"""The paper's method and its ablations, with trained and with geometric weights."""

from dataclasses import replace

from ggvs_eval.pipelines.methods.spec import OnlineMethod, shipped
from ggvs_eval.plugins import DEVICE_PARTS, missing_part

ONLINE = "ggvs_eval.pipelines.online"
_STEP = str(DEVICE_PARTS.root("online step"))
# with or without Warp: another machine may have it
ON_DEVICE = () if missing_part(_STEP) else (_STEP,)

# What the paper does not have, as the table of differences says it.
UNFUSED = "adds exposure compensation and a recurrent output where nothing moves"
INSTANT = "adds exposure compensation, settled and forgiven depth"
ADDED = (
    "adds exposure compensation, settled and forgiven depth and a recurrent output where "
    "nothing moves"
)

OURS = OnlineMethod(
    "GGVS (online)",
    "the whole online method: splats, filtered and fused depth, blending network",
    f"{ONLINE}.online_methods:learned",
    device_modules=ON_DEVICE,
    departs=ADDED,
    ours=True,
    weights=(shipped("blend.safetensors"),),
    takes=("options", "device"),
)
NO_TEMPORAL = replace(
    OURS,
    title="GGVS (online), no temporal filtering",
    describe="without temporal depth filter, temporal term of the ray march and recurrent output",
    given={"guidance": "registered", "temporal": False},
    takes=("device",),
    departs=INSTANT,
)
NO_TSDF = replace(
    OURS,
    title="GGVS (online), no TSDF guidance",
    describe="no fused depth; the network was trained without it",
    given={"guidance": "none", "fused": False},
    takes=("device",),
    departs=UNFUSED,
    weights=(shipped("blend-no-tsdf.safetensors"),),
)
NAIVE = replace(
    NO_TSDF,
    title="Naive Network",
    describe="splatted views alone: the network was trained without any depth, neither fused nor "
    "of the views",
    given={"guidance": "naive", "fused": False},
    weights=(shipped("blend-naive.safetensors"),),
)
GEOMETRIC = OnlineMethod(
    "GGVS (online), geometric weights",
    "the whole online method with geometric weights in place of the blending network",
    f"{ONLINE}.online_methods:geometric",
    departs=ADDED,
    ours=True,
    takes=("options",),
)
GEOMETRIC_NO_TEMPORAL = replace(
    GEOMETRIC,
    title="GGVS (online), geometric weights, no temporal filtering",
    describe=NO_TEMPORAL.describe,
    given={"temporal": False},
    takes=(),
    departs=INSTANT,
)
POINT_SPLAT = replace(
    GEOMETRIC,
    title="GGVS (online), geometric weights, point splats",
    describe="views rendered forward as points of one pixel, not as pixel-sized Gaussians",
    given={"splatted_as": "points"},
    takes=(),
)
NO_BACKGROUND = replace(
    GEOMETRIC,
    title="GGVS (online), geometric weights, no background blending",
    describe="areas without a source view stay black",
    given={"background": False},
    takes=(),
)
OFFLINE = OnlineMethod(
    "GGVS (offline), geometric weights",
    "a reference that uses the whole sequence: depth filtered backwards in time, then forwards",
    f"{ONLINE}.whole_sequence:WholeSequence",
    departs=ADDED,
    ours=True,
    online=False,
)
