"""A captured frame as the metrics see it, and what a metric that is fed frame by frame looks like."""

from collections.abc import Sequence
from functools import cached_property
from typing import TYPE_CHECKING, Protocol

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.metrics.image.fetch_lpips import LpipsNet
from ggvs_eval.metrics.image.lpips import lpips_features
from ggvs_eval.metrics.image.regions import Region, moving_mask
from ggvs_eval.metrics.time import strred

if TYPE_CHECKING:
    import torch

Value = tuple[str, int | None, float]  # metric, frame (None: the whole view), value


class TruthFrame:
    """A captured frame with what the metrics derive from it alone, computed when first asked for.

    SSIM's moments of the truth are not kept: the kernel filters four maps while they are in cache, and keeping one of them would
    save at most a quarter of its 8.8 ms at 1352x1014, less than the 2.7 ms of reading 33 MB of moments back.
    """

    def __init__(self, image: Image8, previous: Image8 | None, disoccluded: Mask | None, lpips_net: LpipsNet) -> None:
        """Take a frame, the one before it, and where no source camera sees it; None where there is no such thing."""
        self.image = image
        self._previous = previous
        self._disoccluded = disoccluded
        self._lpips_net = lpips_net
        self._entropies: strred.Entropies | None = None

    @cached_property
    def lpips_features(self) -> "list[torch.Tensor]":
        """What LPIPS compares."""
        return lpips_features(self.image, self._lpips_net)

    @cached_property
    def band(self) -> strred.Array:
        """What ST-RRED compares."""
        return strred.spatial_band(strred.luma(self.image))

    def entropies(self, band_before: strred.Array, pairing: strred.Pairing) -> strred.Entropies:
        """What ST-RRED keeps of the frame before and this one, the same for all methods.

        Args:
            band_before: `band` of the captured frame before.
            pairing: one per view.
        """
        if self._entropies is None:
            self._entropies = strred.reduced_references(band_before, self.band, pairing)
        return self._entropies

    @cached_property
    def _moving(self) -> Mask | None:
        return None if self._previous is None else moving_mask(self.image, self._previous)

    def region(self, region: Region) -> Mask | None:
        """Where a region lies; None in the first frame, of which nobody knows what moves, and where masks are not known."""
        if region == "disoccluded":
            return self._disoccluded
        return self._moving if region == "moving" or self._moving is None else ~self._moving


class Scorer(Protocol):
    """One or several metrics fed frame by frame."""

    @property
    def names(self) -> Sequence[str]:
        """The metrics it computes."""

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """Take the next frame and return what it completes."""

    def finish(self) -> list[Value]:
        """Return what only the whole view has."""
