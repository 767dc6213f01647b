"""Copies of captured frames among the rendered ones: bit by bit, in each patch, or by their sensor noise.

The noise of the truth is its fingerprint: no method can guess it, so a rendering that has it took it from the truth.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.files.images import mean_of_channels
from ggvs_eval.finding import Finding, Verdict, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, named_frames, spread
from ggvs_eval.scoring import FrameReader

FineReader = Callable[[int], Array32]
# The middle of a large picture says as much as is needed.
CROP_PX = 640
CELL_PX = 16
# The cells that change most move, and are left out: what moves within a cell is in a good rendering too.
STEADY_SHARE = 0.5
QUESTION = "truth copied in"
# Instants of a clip from which the noise is estimated.
NOISE_INSTANTS = 48
# Share of the truth: 0.01 at most in honest renders of several methods, 0.05 in a perfect one without noise, where the scene
# changes within a cell; 0.06 and more, by 12 and more standard errors, where a tenth is blended in. It is less well known
# of a single frame. Below NO_COPY nothing was copied.
LEAST_SHARE, CERTAIN_SHARE, LEAST_DEVIATIONS, NO_COPY = 0.05, 0.07, 10.0, 0.2
FRAME_SHARE, FRAME_DEVIATIONS = 0.3, 8.0
# Without noise to compare (codecs take it out): a rendering fails somewhere, a copy nowhere. Correlation of fine detail in the
# worst twentieth of the textured patches: 0.5 for a rendering of 24 dB, 0.82 for ghosted truth, 0.98 for JPEG of quality 80.
WORST_SHARE, SUSPICIOUS_CORRELATION, USUAL_CORRELATION = 0.05, 0.97, 0.9
# Frames that are looked at together.
WINDOW = 8
TEXTURE_255, FEWEST_PATCHES = 3.0, 20


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
    """Return the ratio of the sums over some instants; the scatter of the cells gives its uncertainty."""
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


def noise_sums(view: ViewFrames, rendered: FineReader, truth: FineReader, index: int) -> NoiseSums:
    """Sum products of an instant's captured and rendered frame with the noise of the captured one.

    The noise n is what the captured frame has beyond its neighbours' mean, brightness and a shift fitted to each cell, so that
    neither lights nor slow motion count. A rendering r = (1 - a) r0 + a c of the captured frame c has <r, n> = a <c, n> where the
    method's own r0 knows nothing of n: n is an instrument (in the sense of econometrics) for a. Both r and c are taken beyond
    the mean of the frames two instants away, whose noise is not in n, so that static content does not drown it. Cells
    in which the rendering changes much, on its own account, count less.

    Args:
        rendered: fine detail of its rendered frames, as `_fine` gives it; so `truth` of the captured ones.
        index: frame number of which `has_far_frames` holds; two to either side make the answer sharp.
    """
    near, far = (_beside(view, index, lag) for lag in (1, 2))
    around = _mean(truth, near)
    design = _design(around)
    noise = _beyond(truth(index) - around, design)
    theirs, ours = (_beyond(read(index) - _mean(read, far), design) for read in (truth, rendered))
    energy, own = (np.square(image).sum(axis=1) for image in (noise, ours))
    steady = energy <= np.quantile(energy, STEADY_SHARE)
    weights = 1 / (own + np.median(own) + 1)
    return NoiseSums(*((weights * (image * noise).sum(axis=1))[steady] for image in (theirs, ours)))


def has_far_frames(view: ViewFrames, index: int) -> bool:
    """Return whether a frame is two instants away; without one static content would count as noise."""
    return bool(_beside(view, index, 2))


def _beside(view: ViewFrames, index: int, lag: int) -> list[int]:
    return [other for other in (index - lag, index + lag) if other in view.frames]


def _mean(read: FineReader, indices: Sequence[int]) -> Array32:
    return np.mean([read(index) for index in indices], axis=0) if indices else np.zeros((), np.float32)


def _fine(read: FrameReader, index: int) -> Array32:
    """Fine detail of the mean of the channels, in the middle of the picture, whole cells of it."""
    image = read(index)
    top, left = (max(size - CROP_PX, 0) // 2 for size in image.shape[:2])
    height, width = (min(size, CROP_PX) // CELL_PX * CELL_PX for size in image.shape[:2])
    grey = mean_of_channels(image[top : top + height, left : left + width])
    return np.asarray(grey - cv2.blur(grey, (5, 5)), dtype=np.float32)


def _cells(image: Array32) -> Array32:
    """Whole squares of a picture, (cells, pixels)."""
    rows, columns = (size // CELL_PX for size in image.shape)
    squares = image[: rows * CELL_PX, : columns * CELL_PX].reshape(rows, CELL_PX, columns, CELL_PX).swapaxes(1, 2)
    return squares.reshape(rows * columns, CELL_PX**2)


def _design(image: Array32) -> Array32:
    """Orthonormal changes of each cell by brightness and shift, (cells, pixels, 4)."""
    slopes = (cv2.Sobel(image, cv2.CV_32F, dx, dy, ksize=3) for dx, dy in ((1, 0), (0, 1)))
    parts = np.stack([_cells(part) for part in (np.ones_like(image), image, *slopes)], axis=-1)
    return np.linalg.qr(parts)[0]


def _beyond(image: Array32, design: Array32) -> Array32:
    """Return the cells without what the changes of a design explain."""
    cells = _cells(image)
    return cells - np.einsum("cpk,ck->cp", design, np.einsum("cpk,cp->ck", design, cells))


def find_copied(name: str, view: ViewFrames) -> list[Finding]:
    """Look for frames that are copies, each compared with the others, and for a share of the truth in all others."""
    view = replace(view, rendered=lru_cache(WINDOW)(view.rendered), truth=lru_cache(WINDOW)(view.truth))
    fits: dict[int, float] = {}
    identical: list[int] = []
    for index, (rendered, truth) in zip(view.frames, view.pairs(list(view.frames)), strict=True):
        fits[index] = worst_patches(rendered, truth)
        identical += [index] if np.array_equal(rendered, truth) else []
    instants = [index for index in spread(view.frames, NOISE_INSTANTS) if has_far_frames(view, index)]
    ours, theirs = (lru_cache(WINDOW)(partial(_fine, read)) for read in (view.rendered, view.truth))
    noise = {index: noise_sums(view, ours, theirs, index) for index in instants if index not in identical}
    written = _written_again({index: fit for index, fit in fits.items() if index not in identical}, noise)
    usual = [fit for index, fit in fits.items() if index not in {*identical, *written}]
    counted = {"n_frames": len(identical)}
    return [
        *([_finding(name, "certain", f"{_named(identical, view)} captured, bit by bit", counted)] if identical else []),
        *_copies(name, view, {index: fits[index] for index in written}, usual, [noise[i] for i in written if i in noise]),
        *_blend(name, [sums for index, sums in noise.items() if index not in written]),
    ]


def _written_again(fits: Mapping[int, float], noise: Mapping[int, NoiseSums]) -> list[int]:
    """Return the frames that fit everywhere, all alike or much better than others, and those with much more of the truth's noise.

    What fits but has nothing of that noise is a very good rendering.
    """
    shares = {index: pooled_share([sums]) for index, sums in noise.items()}
    usual = float(np.median([one.share for one in shares.values()])) if shares else 0.0
    misfit = 1 - float(np.median(list(fits.values()) or [0.0]))
    most = 1 - SUSPICIOUS_CORRELATION if misfit < 1 - SUSPICIOUS_CORRELATION else min(1 - SUSPICIOUS_CORRELATION, misfit / 2)
    close = {index for index, fit in fits.items() if 1 - fit < most}
    close -= {index for index in close if index in shares and shares[index].most < NO_COPY}
    noisy = {i for i, one in shares.items() if one.share > max(FRAME_SHARE, 2 * usual) and one.deviations > FRAME_DEVIATIONS}
    return sorted(close | noisy)


def _copies(
    name: str, view: ViewFrames, fits: Mapping[int, float], usual: Sequence[float], noise: Sequence[NoiseSums]
) -> list[Finding]:
    """Return the frames that are hardly anything else; proved by their noise, or by the other frames that are not like them."""
    if not fits:
        return []
    least, others = min(fits.values()), float(np.median(usual)) if usual else 1.0
    one = pooled_share(noise)
    measured = f"{_named(list(fits), view)} captured, written again: fine detail correlates {least:.3f} in the worst patches"
    measured += f", {others:.2f} in the other frames" if usual else ""
    measured += f"; they have {100 * one.share:.0f} % of its noise" if one.deviations > LEAST_DEVIATIONS else ""
    values = {"n_frames": len(fits), "worst_patches": least, "worst_patches_others": others, "share": one.share}
    is_proved = one.share > CERTAIN_SHARE and one.deviations > LEAST_DEVIATIONS
    return [_finding(name, verdict_of(is_proved or others < USUAL_CORRELATION), measured, values)]


def _blend(name: str, noise: Sequence[NoiseSums]) -> list[Finding]:
    """Return a share of the truth in all frames that are no copies."""
    one = pooled_share(noise)
    if one.share < LEAST_SHARE or one.deviations < LEAST_DEVIATIONS:
        return []
    measured = (
        f"{100 * one.share:.0f} % of the truth's sensor noise is in the rendering, {one.deviations:.0f} standard errors from "
        "none: the reference was blended in, or copied and changed"
    )
    return [_finding(name, verdict_of(one.share > CERTAIN_SHARE), measured, {"share": one.share, "share_error": one.error})]


def _named(frames: Sequence[int], view: ViewFrames) -> str:
    return f"{'all frames are' if len(frames) == len(view.frames) else named_frames(list(frames))} as"


def worst_patches(rendered: Image8, truth: Image8) -> float:
    """Return the correlation of fine detail in the worst of the textured patches; 0 where too few have texture."""
    ours, theirs = (_patches(image) for image in (rendered, truth))
    textured = theirs.std(axis=1) > TEXTURE_255
    if np.count_nonzero(textured) < FEWEST_PATCHES:
        return 0.0
    ours, theirs = ours[textured], theirs[textured]
    energy = np.sqrt(np.square(ours).sum(axis=1) * np.square(theirs).sum(axis=1)) + 1e-6
    return float(np.quantile((ours * theirs).sum(axis=1) / energy, WORST_SHARE))


def _patches(image: Image8) -> Array32:
    """Fine detail of the mean of the channels in squares, each without its mean, (patches, pixels)."""
    grey = mean_of_channels(image)
    flat = _cells(np.asarray(cv2.GaussianBlur(grey, (0, 0), 0.8) - cv2.GaussianBlur(grey, (0, 0), 3.0), np.float32))
    return np.asarray(flat - flat.mean(axis=1, keepdims=True), dtype=np.float32)


def _finding(name: str, verdict: Verdict, measured: str, values: Mapping[str, float]) -> Finding:
    advice = "exclude the test view from the method's inputs; are reference and render folders swapped?"
    return Finding(name, QUESTION, verdict, measured, values, advice)
