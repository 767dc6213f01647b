"""Metric options of a protocol, in a separate module so that a metric depends only on these."""

from dataclasses import dataclass, field
from typing import Literal

SsimName = Literal["gaussian-valid", "gaussian-zero", "uniform7", "uniform7-range2"]
LpipsNet = Literal["vgg", "alex", "vgg-bf16"]
StedPairing = Literal["disjoint", "consecutive"]
StedPooling = Literal["means", "products"]
# Of a field that came after the first protocols: at its default it is left out, so that the hashes
# of older results stay valid.
LATER = {"left out": True}


@dataclass(frozen=True, kw_only=True)
class MetricChoices:
    """Metric options of a protocol.

    Attributes:
        ssim: variant of SSIM, see `ggvs_eval.metrics.image.ssim.SSIM_VARIANTS`; regions and
            colour-corrected frames use the default.
        lpips_net: backbone of LPIPS v0.1; ``vgg-bf16`` computes VGG in bfloat16, which is faster
            and gives other digits.
        lpips_every: distance of the frames that LPIPS measures, from the first on; 1 measures all.
        sted_pairing: pairs of frames of ST-RRED: ``disjoint`` (0-1, 2-3, ...) or ``consecutive``.
        sted_pooling: ``means`` (mean spatial times mean temporal difference) or ``products`` (mean
            of the pairs' products).
        colour_scope: one affine map per ``view`` or per ``frame`` for the colour-corrected metrics.
        ddof: delta degrees of freedom of the standard deviations SDT and SDV.
    """

    ssim: SsimName = "gaussian-valid"
    lpips_net: LpipsNet = "vgg"
    lpips_every: int = field(default=1, metadata=LATER)
    sted_pairing: StedPairing = "disjoint"
    sted_pooling: StedPooling = "means"
    colour_scope: Literal["view", "frame"] = "view"
    ddof: int = 1
