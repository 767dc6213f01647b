"""Sensor noise of the truth as its fingerprint: no method can guess it, so a rendering that has it took it from the truth."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.pipelines.inspection.renders.view_frames import FrameReader, ViewFrames

# The middle of a large picture says as much as is needed.
CROP_PX = 640
CELL_PX = 16
# The cells that change most move, and are left out: what moves within a cell is in a good rendering too.
STEADY_SHARE = 0.5


@dataclass(frozen=True)
class TruthShare:
    """Share of the captured frames' noise in their rendering.

    Attributes:
        share: 1 for a copy, the weight of the truth in a blend, 0 for a rendering.
        error: standard error of `share`; infinite where the truth has no noise.
    """

    share: float
    error: float

    @property
    def deviations(self) -> float:
        """The share in its standard errors."""
        return self.share / max(self.error, 1e-9)

    @property
    def most(self) -> float:
        """Upper bound that the share hardly exceeds."""
        return self.share + 5 * self.error


@dataclass(frozen=True, eq=False)
class NoiseSums:
    """Products with the truth's noise, summed over each cell of an instant, (cells,)."""

    captured: Array32
    rendered: Array32


def pooled_share(instants: Iterable[NoiseSums]) -> TruthShare:
    """Ratio of the sums over some instants; the cells, each with an error of its own, tell how well it is known."""
    sums = list(instants)
    if not sums:
        return TruthShare(0.0, np.inf)
    captured, rendered = (np.concatenate([getattr(one, part) for one in sums]) for part in ("captured", "rendered"))
    total = float(captured.sum())
    if total <= 0:
        return TruthShare(0.0, np.inf)
    share = float(rendered.sum()) / total
    error = float(np.sqrt(np.square(rendered - share * captured).sum())) / total
    return TruthShare(share, error)


def noise_sums(view: ViewFrames, index: int) -> NoiseSums:
    """Products of an instant's captured and rendered frame with the noise of the captured one.

    The noise n is what the captured frame has beyond its neighbours' mean, brightness and a shift fitted to each cell, so that
    neither lights nor slow motion count. A rendering r = (1 - a) r0 + a c of the captured frame c has <r, n> = a <c, n> where the
    method's own r0 knows nothing of n: n is an instrument (in the sense of econometrics) for a. Both r and c are taken beyond
    the mean of the frames two instants away, whose noise is not in n, so that what stands still does not drown it. Cells
    in which the rendering changes much, on its own account, count less.

    Args:
        index: frame number of which `has_far_frames` holds; two to either side make the answer sharp.
    """
    near, far = (_beside(view, index, lag) for lag in (1, 2))
    around = _mean(view.truth, near)
    design = _design(around)
    noise = _beyond(_fine(view.truth(index)) - around, design)
    captured, rendered = (_beyond(_fine(read(index)) - _mean(read, far), design) for read in (view.truth, view.rendered))
    energy, own = (np.square(image).sum(axis=1) for image in (noise, rendered))
    steady = energy <= np.quantile(energy, STEADY_SHARE)
    weights = 1 / (own + np.median(own) + 1)
    theirs, ours = ((weights * (image * noise).sum(axis=1))[steady] for image in (captured, rendered))
    return NoiseSums(theirs, ours)


def has_far_frames(view: ViewFrames, index: int) -> bool:
    """Tell whether a frame lies two instants away; without one what stands still would pass for noise, in honest renders too."""
    return bool(_beside(view, index, 2))


def _beside(view: ViewFrames, index: int, lag: int) -> list[int]:
    return [other for other in (index - lag, index + lag) if other in view.frames]


def _mean(read: FrameReader, indices: Sequence[int]) -> Array32:
    return np.mean([_fine(read(index)) for index in indices], axis=0) if indices else np.zeros((), np.float32)


def _fine(image: Image8) -> Array32:
    """Fine detail of the mean of the channels, in the middle of the picture, whole cells of it."""
    top, left = (max(size - CROP_PX, 0) // 2 for size in image.shape[:2])
    height, width = (min(size, CROP_PX) // CELL_PX * CELL_PX for size in image.shape[:2])
    grey = image[top : top + height, left : left + width].mean(axis=-1, dtype=np.float32)
    return np.asarray(grey - cv2.blur(grey, (5, 5)), dtype=np.float32)


def _cells(image: Array32) -> Array32:
    """(cells, pixels)."""
    rows, columns = (size // CELL_PX for size in image.shape)
    return image.reshape(rows, CELL_PX, columns, CELL_PX).swapaxes(1, 2).reshape(rows * columns, CELL_PX**2)


def _design(image: Array32) -> Array32:
    """Orthonormal changes of each cell by brightness and shift, (cells, pixels, 4)."""
    slopes = (cv2.Sobel(image, cv2.CV_32F, dx, dy, ksize=3) for dx, dy in ((1, 0), (0, 1)))
    parts = np.stack([_cells(part) for part in (np.ones_like(image), image, *slopes)], axis=-1)
    return np.linalg.qr(parts)[0]


def _beyond(image: Array32, design: Array32) -> Array32:
    """Cells without what the changes of a design explain."""
    cells = _cells(image)
    return cells - np.einsum("cpk,ck->cp", design, np.einsum("cpk,cp->ck", design, cells))
