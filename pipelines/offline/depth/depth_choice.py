"""Choice of depth estimation: the matchers by name, and the few words that the command line takes and a run folder keeps."""

import os
import re
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, cast

from ggvs_eval import built_in
from ggvs_eval.errors import DepthError, did_you_mean
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.itermvs.options import IterMvs, cached_weights
from ggvs_eval.pipelines.offline.plane_sweep.planes import PlaneSweep
from ggvs_eval.pipelines.offline.stereo.live import LiveMatcher
from ggvs_eval.pipelines.offline.stereo.matcher import StereoMatcher
from ggvs_eval.plugins import Registry

FREE_MATCHER = "sgbm"  # that needs no file
LIVE_MATCHER = "live"  # the default of play and view
MATCHERS: Registry[Callable[..., StereoMatcher | PlaneSweep | IterMvs]] = Registry("matchers", built_in.MATCHERS)
FORMS = ("raft:CHECKPOINT", "itermvs:CHECKPOINT", "sgbm+raft", "sgbm+itermvs:CHECKPOINT")  # names of others
SensorUse = Literal["compare", "alone", "fill", "no"]
KEYFRAME_EVERY = 16  # instants, where instants depend on each other
DEVICE, UNEXPLAINED = "device", "unexplained"  # in a record of depth: the latter by sensors and by stereo
ITERMVS, RAFT = built_in.NETWORK_MATCHERS[::-1]
FILLER = re.compile(rf"\+(?=(?:{'|'.join(built_in.NETWORK_MATCHERS)})(?::|$))")  # is before a filler's name


def default_matcher() -> str:
    """Return the matcher of those who name none: with IterMVS where its weights are in the cache folder."""
    return f"{FREE_MATCHER}+{ITERMVS}" if os.path.isfile(cached_weights()) else FREE_MATCHER  # a foreign folder has none


def find_matcher(name: str, device: str = "cpu", *, dense: bool = False) -> StereoMatcher | PlaneSweep | IterMvs:
    """Return the matcher of a name without a filler: one of `MATCHERS`, or ``NETWORK:CHECKPOINT``.

    Args:
        device: where a network computes; the others are the CPU's. Whether it is there shows when it computes.
        dense: it fills what another matcher does not find.

    Raises:
        DepthError: no such matcher.
    """
    kind, _, checkpoint = name.partition(":")
    if kind in built_in.NETWORK_MATCHERS:
        return MATCHERS[kind](checkpoint, device, dense)
    if name not in MATCHERS:
        known = (*MATCHERS, *FORMS)
        raise DepthError(f"wanted a matcher, got {name!r}; known are {', '.join(known)}{did_you_mean(name, known)}")
    return MATCHERS[name]()


@dataclass(frozen=True)
class DepthRunOptions:
    """Options of depth estimation on the command line and in a run folder.

    Attributes:
        matcher: sgbm, live, sweep, raft[:FILE], itermvs:FILE; sgbm+raft or sgbm+itermvs:FILE fill gaps of sgbm.
        stereo_weights: checkpoint of RAFT-Stereo's authors; the same as --matcher raft:FILE.
        sensor: filtered depth of a sensor (RGB-D): alone, filling what stereo does not find, or no use of it; compare: alone if
            it explains the pictures of other cameras better than stereo, else filling.
        reuse_static: recompute depth only where the picture changes, and all every 16 instants.
    """

    matcher: str = field(default_factory=default_matcher)
    stereo_weights: Path | None = None
    sensor: SensorUse = "compare"
    reuse_static: bool = False

    @property
    def is_learned(self) -> bool:
        """True if a network finds depth, which may compute on a GPU."""
        return self.stereo_weights is not None or any(
            name in self.matcher.partition(":")[0] for name in built_in.NETWORK_MATCHERS
        )

    def options(self, device: str = "cpu") -> DepthOptions:
        """Return all parameters of the depth estimation."""
        if self.stereo_weights is not None and self.matcher not in (FREE_MATCHER, default_matcher(), LIVE_MATCHER, RAFT):
            raise DepthError(f"--stereo-weights: wanted --matcher raft, got {self.matcher}")
        name = self.matcher if self.stereo_weights is None else f"{RAFT}:{self.stereo_weights}"
        name, *fillers = FILLER.split(name, maxsplit=1)
        matcher = find_matcher(name, device)
        if fillers and isinstance(matcher, LiveMatcher | IterMvs):
            raise DepthError(f"matcher {self.matcher}: wanted sgbm, sweep or raft before the +, got {name}; use one of these")
        filler = cast(IterMvs | StereoMatcher, find_matcher(fillers[0], device, dense=True)) if fillers else None
        keyframe_every = KEYFRAME_EVERY if self.reuse_static else 1
        sensor, fills = self.sensor != "no", self.sensor == "fill"
        return DepthOptions(matcher, filler, keyframe_every=keyframe_every, sensor=sensor, sensor_fills=fills)

    def record(self, device: str = "cpu") -> dict[str, Any]:
        """As values that JSON knows; the device of a network is named where it is not the CPU."""
        weights = None if self.stereo_weights is None else str(self.stereo_weights)
        return asdict(self) | {"stereo_weights": weights} | ({DEVICE: device} if self.is_learned and device != "cpu" else {})

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> "DepthRunOptions":
        """Restore the options that `record` wrote, all except what was found where it was written or is no option any more."""
        weights = record.get("stereo_weights")
        values = record | {"stereo_weights": None if weights is None else Path(weights)}
        values["sensor"] = {True: "alone", False: "no"}.get(values["sensor"], values["sensor"])  # as older folders have it
        return cls(**{name: value for name, value in values.items() if name not in (DEVICE, UNEXPLAINED, "registration")})
