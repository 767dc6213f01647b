"""Colour maps of renderings, fitted to sums over their pixels."""

import numpy as np

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import Image, check_pair, white_level
from ggvs_eval.metrics.metric import ColourMap

SINGULAR_BELOW = 1e-12  # of the largest eigenvalue of the moments
ROWS_AT_ONCE = 64  # so that float64 copies of pixels stay small


class ColourMoments:
    """Sums over the pixels of a frame, or of all frames of a view, from which the best colour map
    follows; no frame is kept.

    Reading:
        Not in the paper. gsplat fits its ``cc_`` map to every image alone, which also removes
        flicker. One map per view (all frames added to one `ColourMoments`) removes what is constant
        and leaves flicker visible. The fit is linear least squares in sRGB; it also lowers the
        contrast of what does not agree with the truth, so that noise on a flat frame costs less
        after it: read corrected scores with the plain ones, never instead of them.
    """

    def __init__(self) -> None:
        # of the outer products of (rendered rgb, 1, true rgb), all in [0, 1]
        self._sums = np.zeros((7, 7))

    def add(self, rendered: Image, truth: Image) -> None:
        """Add the pixels of one frame.

        Args:
            rendered: (H, W, 3), uint8 in 0..255 or float in [0, 1].
        """
        check_pair(rendered, truth)
        white = white_level(truth)
        unit = np.array([1, 1, 1, white, 1, 1, 1]) / white
        # in the images' own scale: of 8-bit values these are integers, exact in float64
        sums = np.zeros((7, 7))
        for start in range(0, len(truth), ROWS_AT_ONCE):
            pixels = np.ones((truth[start : start + ROWS_AT_ONCE].size // 3, 7))
            pixels[:, :3] = rendered[start : start + ROWS_AT_ONCE].reshape(-1, 3)
            pixels[:, 4:] = truth[start : start + ROWS_AT_ONCE].reshape(-1, 3)
            sums += pixels.T @ pixels
        self._sums += sums * np.outer(unit, unit)

    def map(self) -> ColourMap:
        """Return the least-squares affine map from rendered to true colours.

        Returns:
            (3, 4) so that truth is about map @ (r, g, b, 1), colours in [0, 1]; the shortest such
            map where the rendered colours do not span the space.
        """
        if not self._sums[3, 3]:
            raise MetricError("colour correction: no pixels were added; render this view first")
        if not np.isfinite(self._sums).all():
            raise MetricError(
                "colour correction: the frames hold values that are not finite; render them again"
            )
        inverse = np.linalg.pinv(self._sums[:4, :4], rcond=SINGULAR_BELOW, hermitian=True)
        return np.asarray((inverse @ self._sums[:4, 4:]).T, dtype=np.float64)
