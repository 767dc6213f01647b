"""Misregistration, colour offset and noise in an error: the gap between the PSNR of YCbCr and IV-PSNR, in words."""

from collections.abc import Mapping

import numpy as np

from ggvs_eval.metrics.image.psnr import PSNR_CEILING_DB, psnr
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, spread

FRAMES_PER_VIEW = 3
FORGIVING, PLAIN = "IV_PSNR", "PSNR_YCbCr"


def forgiven_error(views: Mapping[str, ViewFrames]) -> str:
    """Say what IV-PSNR forgives of some renders.

    Args:
        views: name -> rendered and captured frames, of which a few are read.

    Returns:
        A sentence with both numbers; empty where no frame has the size of its truth, all are the truth itself, or the metric is
        not installed.
    """
    if FORGIVING not in METRICS or PLAIN not in METRICS:
        return ""
    iv_psnr, psnr_ycbcr = METRICS[FORGIVING].function, METRICS[PLAIN].function
    pairs = (pair for view in views.values() for pair in view.pairs(spread(view.frames, FRAMES_PER_VIEW)))
    alike = (pair for pair in pairs if pair[0].shape == pair[1].shape)
    values = np.array([(psnr_ycbcr(*pair), iv_psnr(*pair), psnr(*pair)) for pair in alike])
    if not len(values) or values[:, 2].min() >= PSNR_CEILING_DB:
        return ""
    plain, forgiving, _ = values.mean(axis=0)
    numbers = f"PSNR of YCbCr {plain:.2f} dB, IV-PSNR {forgiving:.2f} dB: the {forgiving - plain:.1f} dB between them"
    return f"{numbers} are misregistration of up to 2 pixels, a global colour offset of up to 3 levels, and noise"
