"""Metrics of single frames and their regions, fed frame by frame, and who computes which metric."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.colour_correction import ColourMap, ColourMoments, apply_colour_map, unit_range
from ggvs_eval.metrics.image.fetch_lpips import LpipsNet
from ggvs_eval.metrics.image.lpips import lpips_between, lpips_features
from ggvs_eval.metrics.image.psnr import l1, psnr, ssim
from ggvs_eval.metrics.image.regions import REGIONS, Region, masked_l1, masked_psnr, masked_ssim
from ggvs_eval.metrics.image.ssim_variants import SsimName, ssim_variant
from ggvs_eval.metrics.time import strred
from ggvs_eval.metrics.time_scorers import ChangeScorer, FlickerScorer, SpreadScorer, StredScorer
from ggvs_eval.metrics.truth_frame import Scorer, TruthFrame, Value

REGION_MEASURES: dict[str, Callable[[Image8, Image8, Mask], float]] = {"PSNR": masked_psnr, "SSIM": masked_ssim, "L1": masked_l1}
CORRECTED = ("PSNR_cc", "SSIM_cc", "LPIPS_cc")


@dataclass(frozen=True)
class MetricOptions:
    """What a protocol may choose about the metrics.

    Attributes:
        ssim: which SSIM, see `ssim_variants.SSIM_VARIANTS`; regions and colour-corrected frames take the default one.
        lpips_net: network of LPIPS.
        sted_pairing: which frames ST-RRED compares, see `strred.strred`.
        sted_pooling: how its pairs become one number, see `strred.pool`.
        colour_scope: one colour correction per view, or one per frame.
        ddof: 1 for unbiased standard deviations, 0 for plain ones.
    """

    ssim: SsimName = "gaussian-valid"
    lpips_net: LpipsNet = "vgg"
    sted_pairing: strred.Pairing = "disjoint"
    sted_pooling: strred.Pooling = "means"
    colour_scope: Literal["view", "frame"] = "view"
    ddof: Literal[0, 1] = 1


def make_scorers(names: Sequence[str], options: MetricOptions, colour_map: ColourMap | None) -> list[Scorer]:
    """One scorer, or one for several metrics that share work, for the metrics of a view.

    Args:
        names: metrics.
        options: their variants.
        colour_map: of the view where colours are corrected per view.
    """
    measures: dict[str, Callable[[Image8, Image8], float]] = {
        "PSNR": psnr,
        "SSIM": lambda rendered, truth: ssim_variant(rendered, truth, options.ssim),
        "L1": l1,
    }
    scorers: list[Scorer] = [FrameScorer(name, measures[name]) for name in names if name in measures]
    if "LPIPS" in names:
        scorers.append(LpipsScorer(options.lpips_net))
    if corrected := [name for name in names if name in CORRECTED]:
        scorers.append(CorrectedScorer(corrected, options, colour_map))
    for region in REGIONS:
        if asked := [name for name in REGION_MEASURES if f"{name}_{region}" in names]:
            scorers.append(RegionScorer(region, asked))
    if "TCC" in names:
        scorers.append(ChangeScorer())
    if sted_names := [name for name in ("STED", "STED_ssn") if name in names]:
        scorers.append(StredScorer(sted_names, options.sted_pairing, options.sted_pooling))
    if flicker_names := [name for name in ("Flicker", "Flicker_excess") if name in names]:
        scorers.append(FlickerScorer(flicker_names))
    if "SDT" in names:
        scorers.append(SpreadScorer(options.ddof))
    return scorers


class FrameScorer:
    """A metric of single frames."""

    def __init__(self, name: str, measure: Callable[[Image8, Image8], float]) -> None:
        self.names = (name,)
        self._measure = measure

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        return [(self.names[0], index, self._measure(rendered, truth.image))]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []


class LpipsScorer:
    """LPIPS; the truth's features are shared by all methods."""

    names = ("LPIPS",)

    def __init__(self, net: LpipsNet) -> None:
        self._net = net

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        theirs = truth.lpips_features
        return [("LPIPS", index, lpips_between(lpips_features(rendered, self._net), theirs, self._net))]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []


class CorrectedScorer:
    """Metrics of the frame after an affine colour map; without a map of the view each frame has its own."""

    def __init__(self, names: Sequence[str], options: MetricOptions, colour_map: ColourMap | None) -> None:
        self.names = names
        self._net = options.lpips_net
        self._map = colour_map

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        corrected = apply_colour_map(self._map_of(rendered, truth.image), rendered)
        captured = unit_range(truth.image)
        measures = {
            "PSNR_cc": lambda: psnr(corrected, captured),
            "SSIM_cc": lambda: ssim(corrected, captured),
            "LPIPS_cc": lambda: lpips_between(lpips_features(corrected, self._net), truth.lpips_features, self._net),
        }
        return [(name, index, measures[name]()) for name in self.names]

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        return []

    def _map_of(self, rendered: Image8, truth: Image8) -> ColourMap:
        if self._map is not None:
            return self._map
        moments = ColourMoments()
        moments.add(rendered, truth)
        return moments.map()


class RegionScorer:
    """Metrics of one region; frames in which it is too small, or not known, have no value."""

    def __init__(self, region: Region, measures: Sequence[str]) -> None:
        self.names = [f"{measure}_{region}" for measure in measures]
        self._region = region
        self._measures = measures
        self._reasons = {name: "no masks are known; run `ggvs-eval prepare`" for name in self.names}
        self._measured: set[str] = set()

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        mask = truth.region(self._region)
        if mask is None:
            return []
        values: list[Value] = []
        for name, measure in zip(self.names, self._measures, strict=True):
            try:
                values.append((name, index, REGION_MEASURES[measure](rendered, truth.image, mask)))
                self._measured.add(name)
            except MetricError as error:
                self._reasons[name] = str(error)
        return values

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        absent = [name for name in self.names if name not in self._measured]
        if absent:
            raise MetricError(f"{', '.join(absent)}: in no frame, {self._reasons[absent[0]]}")
        return []
