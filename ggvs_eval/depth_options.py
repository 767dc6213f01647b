"""How depth is found, in the few words that the command line takes and a run folder keeps.

Finding it is a part of its own.
"""

import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from ggvs_eval import built_in
from ggvs_eval.files.download import cache_folder
from ggvs_eval.plugins import Registry

FREE_MATCHER = "sgbm"  # that needs no file
LIVE_MATCHER = "live"  # the default of play and view
ITERMVS, RAFT = built_in.NETWORK_MATCHERS[::-1]
SensorUse = Literal["compare", "alone", "fill", "no"]
# in a record of depth: the latter by sensors and by stereo
DEVICE, UNEXPLAINED = "device", "unexplained"
DEPTH_CHOICES: Registry[Callable[..., Any]] = Registry("depth", built_in.DEPTH_CHOICES)


def cached_weights() -> Path:
    """Return IterMVS' weights that are taken where a user names none, present or not: in the cache
    folder.
    """
    return cache_folder() / "itermvs-blendedmvs.ckpt"


def default_matcher() -> str:
    """Return the matcher of those who name none: with IterMVS where its weights are in the cache
    folder.
    """
    # a foreign folder has none
    return f"{FREE_MATCHER}+{ITERMVS}" if os.path.isfile(cached_weights()) else FREE_MATCHER


@dataclass(frozen=True)
class DepthRunOptions:
    """Options of depth estimation on the command line and in a run folder.

    Attributes:
        matcher: sgbm, live, sweep, raft[:FILE], itermvs:FILE; sgbm+raft or sgbm+itermvs:FILE fill
            gaps of sgbm.
        stereo_weights: checkpoint of RAFT-Stereo's authors; the same as --matcher raft:FILE.
        sensor: filtered depth of a sensor (RGB-D): alone, filling what stereo does not find, or no
            use of it; compare: alone if it explains the pictures of other cameras better than
            stereo, else filling.
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

    def options(self, device: str = "cpu") -> Any:
        """Return all parameters of the depth estimation, `DepthOptions`."""
        return DEPTH_CHOICES["depth"](self, device)

    def record(self, device: str = "cpu") -> dict[str, Any]:
        """As values that JSON knows; the device of a network is named where it is not the CPU."""
        weights = None if self.stereo_weights is None else str(self.stereo_weights)
        return (
            asdict(self)
            | {"stereo_weights": weights}
            | ({DEVICE: device} if self.is_learned and device != "cpu" else {})
        )

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> "DepthRunOptions":
        """Restore the options that `record` wrote, all except what was found where it was written
        or is no option any more.
        """
        weights = record.get("stereo_weights")
        values = record | {"stereo_weights": None if weights is None else Path(weights)}
        # as older folders have it
        values["sensor"] = {True: "alone", False: "no"}.get(values["sensor"], values["sensor"])
        return cls(
            **{
                name: value
                for name, value in values.items()
                if name not in (DEVICE, UNEXPLAINED, "registration")
            }
        )
