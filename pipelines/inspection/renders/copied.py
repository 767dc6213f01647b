"""Whether the rendered frames contain the captured ones: their sensor noise is a fingerprint that no method can guess."""

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.pipelines.inspection.finding import Finding, Verdict, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import correlation
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames

PAIRS = 3
CELL_PX = 16
# The quieter half of the cells: what changes there from frame to frame is noise.
QUIET_SHARE = 0.5
LEAST_NOISE_255 = 0.4
# Chance gives below 0.03 with ten thousand pixels. A compressed copy keeps 0.3 and more.
LIKELY_CORRELATION, CERTAIN_CORRELATION = 0.2, 0.4
# Without noise to compare (codecs take it out): a rendering fails somewhere, a copy nowhere. Correlation of fine detail in the
# worst twentieth of the textured patches: 0.5 for a rendering of 24 dB, 0.82 for ghosted truth, 0.98 for JPEG of quality 80.
WORST_SHARE, SUSPICIOUS_CORRELATION = 0.05, 0.97
PATCH_PX, TEXTURE_255, FEWEST_PATCHES = 16, 3.0, 20


def find_copied(name: str, view: ViewFrames) -> list[Finding]:
    """Compare bits, then noise (the fine change over time where nothing moves), then the patches that fit worst."""
    identical: list[bool] = []
    worst: list[float] = []
    noise: list[tuple[float, float]] = []
    for start in _pair_starts(view.frames):
        pair = list(view.pairs([start, start + 1] if len(view.frames) > 1 else [start]))
        identical += [np.array_equal(ours, theirs) for ours, theirs in pair]
        worst.append(worst_patches(*pair[0]))
        if len(pair) == 2:
            noise.append(_noise_correlation([ours for ours, _ in pair], [theirs for _, theirs in pair]))
    if all(identical):
        return [_finding(name, "certain", "frames are the captured ones, bit by bit", {"identical_share": 1.0})]
    shared, noise_255 = np.min(noise, axis=0) if noise else (0.0, 0.0)
    values = {"noise_correlation": float(shared), "noise_255": float(noise_255), "worst_patches": min(worst)}
    if noise_255 >= LEAST_NOISE_255 and shared > LIKELY_CORRELATION:
        measured = f"the sensor noise of the truth ({noise_255:.1f} of 255) is in the rendering: correlation {shared:.2f}"
        return [_finding(name, verdict_of(shared > CERTAIN_CORRELATION), measured, values)]
    if min(worst) > SUSPICIOUS_CORRELATION:
        measured = (
            f"fine detail correlates {min(worst):.3f} even in the worst {WORST_SHARE:.0%} of the patches, which no rendering does"
        )
        return [_finding(name, "likely", measured, values)]
    return []


def worst_patches(rendered: Image8, truth: Image8) -> float:
    """Correlation of fine detail in the worst of the textured patches; 0 where too few have texture."""
    ours, theirs = (_patches(image) for image in (rendered, truth))
    textured = theirs.std(axis=1) > TEXTURE_255
    if np.count_nonzero(textured) < FEWEST_PATCHES:
        return 0.0
    ours, theirs = ours[textured], theirs[textured]
    energy = np.sqrt(np.square(ours).sum(axis=1) * np.square(theirs).sum(axis=1)) + 1e-6
    return float(np.quantile((ours * theirs).sum(axis=1) / energy, WORST_SHARE))


def _patches(image: Image8) -> Array32:
    """Fine detail of the mean of the channels in squares, each without its mean, (patches, pixels)."""
    grey = image.astype(np.float32).mean(axis=-1)
    detail = cv2.GaussianBlur(grey, (0, 0), 0.8) - cv2.GaussianBlur(grey, (0, 0), 3.0)
    rows, columns = (size // PATCH_PX for size in detail.shape)
    squares = detail[: rows * PATCH_PX, : columns * PATCH_PX].reshape(rows, PATCH_PX, columns, PATCH_PX).swapaxes(1, 2)
    flat = squares.reshape(-1, PATCH_PX**2)
    return np.asarray(flat - flat.mean(axis=1, keepdims=True), dtype=np.float32)


def _pair_starts(frames: range) -> list[int]:
    """First frames of some pairs of neighbours."""
    last = max(len(frames) - 2, 0)
    return sorted({frames[round(position)] for position in np.linspace(0, last, PAIRS)})


def _noise_correlation(rendered: list[Image8], truth: list[Image8]) -> tuple[float, float]:
    """Correlation of fine changes between two frames in the quiet half of the picture, and the noise of the truth there."""
    ours, theirs = (_fine(pair[1].astype(np.float32) - pair[0]) for pair in (rendered, truth))
    rows, columns = (size // CELL_PX for size in theirs.shape[:2])
    if min(rows, columns) < 2:
        return 0.0, 0.0
    energy = _cells(np.square(theirs), rows, columns)
    quiet = energy <= np.quantile(energy, QUIET_SHARE)
    mask = np.kron(quiet, np.ones((CELL_PX, CELL_PX), bool))
    ours, theirs = (image[: mask.shape[0], : mask.shape[1]][mask] for image in (ours, theirs))
    return correlation(ours, theirs), float(theirs.std() / np.sqrt(2))


def _fine(difference: Array32) -> Array32:
    """A change without its slow part, which lights and exposure put into every picture of an instant."""
    return np.asarray(difference - cv2.blur(difference, (5, 5)), dtype=np.float32)


def _cells(values: Array32, rows: int, columns: int) -> Array32:
    cropped = values[: rows * CELL_PX, : columns * CELL_PX].mean(axis=-1)
    return cropped.reshape(rows, CELL_PX, columns, CELL_PX).mean(axis=(1, 3))


def _finding(name: str, verdict: Verdict, measured: str, values: dict[str, float]) -> Finding:
    advice = "take the test view out of the method's inputs; are truth and render folders mixed up?"
    return Finding(name, "truth copied in", verdict, measured, values, advice)
