"""The metrics by the names that stand in protocols, tables and figures."""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

from ggvs_eval.errors import MetricError

Kind = Literal["frame", "pair", "view", "rig"]


@dataclass(frozen=True)
class MetricSpec:
    """What a table needs to know about a metric.

    Attributes:
        name: as in protocols and tables.
        kind: what one value belongs to: a ``frame``, a ``pair`` of neighbouring frames, a ``view`` (all its frames), or the
            ``rig`` (all views).
        unit: unit of a value, empty where it has none.
        higher_is_better: direction of the arrow in tables.
        describe: one line for a reader who meets the metric for the first time.
        reference: where it is defined.
    """

    name: str
    kind: Kind
    unit: str
    higher_is_better: bool
    describe: str
    reference: str


_PAPER = "Ha et al. 2025, section 4"
_SPECS = (
    MetricSpec("PSNR", "frame", "dB", True, "peak signal-to-noise ratio of the 8-bit frame", _PAPER),
    MetricSpec("SSIM", "frame", "", True, "structural similarity, 11 x 11 Gaussian window, RGB mean", "Wang et al. 2004"),
    MetricSpec("LPIPS", "frame", "", False, "learned perceptual distance, v0.1", "Zhang et al. 2018"),
    MetricSpec("L1", "frame", "grey levels of 255", False, "mean absolute error over pixels and channels", _PAPER),
    MetricSpec("TCC", "pair", "", True, "SSIM of the colour changes between neighbouring frames", "Ha et al. 2025, Eq. 8"),
    MetricSpec("STED", "view", "", False, "ST-RRED, entropy differences over space and time", "Soundararajan & Bovik 2013"),
    MetricSpec("STED_ssn", "view", "", False, "ST-RRED from single-number differences", "Soundararajan & Bovik 2013"),
    MetricSpec("SDT", "view", "grey levels of 255", False, "standard deviation of L1 over the frames of a view", _PAPER),
    MetricSpec("SDV", "rig", "grey levels of 255", False, "standard deviation of L1 over the views of an instant", _PAPER),
    MetricSpec("PSNR_cc", "frame", "dB", True, "PSNR after the best affine colour map of the frame", "as gsplat's cc_psnr"),
)
METRICS: dict[str, MetricSpec] = {spec.name: spec for spec in _SPECS}


def select_metrics(names: Iterable[str]) -> tuple[MetricSpec, ...]:
    """The metrics of these names, in this order.

    Raises:
        MetricError: an unknown name; the message has the nearest known one.
    """
    names = tuple(names)
    for name in names:
        if name not in METRICS:
            nearest = get_close_matches(name, METRICS, n=1, cutoff=0.0)[0]
            raise MetricError(f"no metric {name!r}; nearest is {nearest!r}, all are {', '.join(METRICS)}")
    return tuple(METRICS[name] for name in names)
