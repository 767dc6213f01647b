"""Choice of depth estimation: the matchers by name, and all parameters that follow from a user's
few words.
"""

import re

from ggvs_eval import built_in
from ggvs_eval.depth_options import (
    FREE_MATCHER,
    LIVE_MATCHER,
    RAFT,
    DepthRunOptions,
    default_matcher,
)
from ggvs_eval.errors import DepthError, did_you_mean
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.matchers import MATCHERS, Matcher

# names of others
FORMS = ("raft:CHECKPOINT", "itermvs:CHECKPOINT", "sgbm+raft", "sgbm+itermvs:CHECKPOINT")
KEYFRAME_EVERY = 16  # instants, where instants depend on each other
# is before a filler's name
FILLER = re.compile(rf"\+(?=(?:{'|'.join(built_in.NETWORK_MATCHERS)})(?::|$))")


def find_matcher(name: str, device: str = "cpu", *, dense: bool = False) -> Matcher:
    """Return the matcher of a name without a filler: one of `MATCHERS`, or ``NETWORK:CHECKPOINT``.

    Args:
        device: where a network computes; the others are the CPU's. Whether it is there shows when
            it computes.
        dense: it fills what another matcher does not find.

    Raises:
        DepthError: no such matcher.
        AbsentPartError: it is not installed.
    """
    kind, _, checkpoint = name.partition(":")
    if kind in built_in.NETWORK_MATCHERS:
        return MATCHERS[kind](checkpoint, device, dense)
    if name not in MATCHERS.known():
        choices = (*MATCHERS, *FORMS)
        raise DepthError(
            f"wanted a matcher, got {name!r}; known are "
            f"{', '.join(choices)}{did_you_mean(name, choices)}"
        )
    return MATCHERS[name]()


def depth_options(choice: DepthRunOptions, device: str = "cpu") -> DepthOptions:
    """Return all parameters of the depth estimation that a user has chosen.

    Raises:
        DepthError: matchers that do not go together.
    """
    if choice.stereo_weights is not None and choice.matcher not in (
        FREE_MATCHER,
        default_matcher(),
        LIVE_MATCHER,
        RAFT,
    ):
        raise DepthError(f"--stereo-weights: wanted --matcher raft, got {choice.matcher}")
    name = choice.matcher if choice.stereo_weights is None else f"{RAFT}:{choice.stereo_weights}"
    name, *fillers = FILLER.split(name, maxsplit=1)
    matcher = find_matcher(name, device)
    # of several cameras at once, which ask no filler
    if fillers and (matcher.rig or matcher.batch):
        raise DepthError(
            f"matcher {choice.matcher}: wanted sgbm, sweep or raft before the +, got {name}; use "
            f"one of these"
        )
    filler = find_matcher(fillers[0], device, dense=True) if fillers else None
    keyframe_every = KEYFRAME_EVERY if choice.reuse_static else 1
    sensor, fills = choice.sensor != "no", choice.sensor == "fill"
    return DepthOptions(
        matcher, filler, keyframe_every=keyframe_every, sensor=sensor, sensor_fills=fills
    )
