"""The metrics by the names that stand in protocols, tables and figures."""

from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Literal

from ggvs_eval.errors import MetricError

Kind = Literal["frame", "pair", "view", "rig", "path"]


@dataclass(frozen=True)
class MetricSpec:
    """What a table needs to know about a metric.

    Attributes:
        name: as in protocols and tables.
        kind: what one value belongs to: a ``frame``, a ``pair`` of neighbouring frames, a ``view`` (all its frames), or the
            ``rig`` (all views), or a camera ``path`` without truth.
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
_VIEWS = "docs/view_consistency.md"
_TIME = "docs/temporal_metrics.md"


def _region_spec(measure: str, region: str) -> MetricSpec:
    """A metric of one region of the image."""
    units = {"PSNR": "dB", "SSIM": "", "L1": "grey levels of 255"}
    where = {"static": "what stands still", "moving": "what moves", "disoccluded": "what no source camera sees"}[region]
    inside = " in windows wholly inside it" if measure == "SSIM" else ""
    describe = f"{measure} of {where}{inside}"
    return MetricSpec(f"{measure}_{region}", "frame", units[measure], measure != "L1", describe, "regions by the masks of Eq. 1")


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
    MetricSpec(
        "PSNR_cc", "frame", "dB", True, "PSNR after the best affine colour map of the view or frame", "as gsplat's cc_psnr"
    ),
    MetricSpec("SSIM_cc", "frame", "", True, "SSIM after an affine colour map", "as gsplat's cc_ssim"),
    MetricSpec("LPIPS_cc", "frame", "", False, "LPIPS after an affine colour map", "as gsplat's cc_lpips"),
    MetricSpec(
        "Flicker", "view", "grey levels of 255", False, "change over time that the scene does not have, and lack of it", _TIME
    ),
    MetricSpec("Flicker_excess", "view", "grey levels of 255", False, "the same, signed: below 0 is frozen or blurred", _TIME),
    *(_region_spec(measure, region) for region in ("static", "moving", "disoccluded") for measure in ("PSNR", "SSIM", "L1")),
    MetricSpec("EPI_coherence", "path", "", True, "how straight the lines of epipolar plane images are", _VIEWS),
    MetricSpec("EPI_line_texture", "path", "grey levels per px", True, "contrast across these lines; blur lowers it", _VIEWS),
    MetricSpec("EPI_slope_error", "path", "px per pose", False, "their slope against that of the fused depth", _VIEWS),
    MetricSpec("EPI_slope_agreeing", "path", "", True, "share of pixels whose slope agrees with the fused depth", _VIEWS),
    MetricSpec(
        "reprojection", "path", "grey levels of 255", False, "colour change of points seen from two neighbouring poses", _VIEWS
    ),
    MetricSpec("reprojection_visible", "path", "", True, "share of pixels that two neighbouring poses both see", _VIEWS),
    MetricSpec("switch_ratio", "path", "", False, "change where the source cameras switch over change elsewhere", _VIEWS),
    MetricSpec(
        "switch_excess", "path", "grey levels of 255", False, "change where the source cameras switch minus elsewhere", _VIEWS
    ),
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
