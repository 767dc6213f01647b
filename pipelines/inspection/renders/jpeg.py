"""The steps in which JPEG stores the coefficients of its blocks."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames, spread

INSTANTS = 3
BLOCK_PX = 8
CROP_PX = 1024
FREQUENCIES = tuple((u, v) for u in range(BLOCK_PX) for v in range(BLOCK_PX) if 0 < u + v < BLOCK_PX)
# Share of the frequencies that need not show a comb: at high quality the lowest have steps of one level, which rounding hides.
UNTOLD_SHARE = 0.6
STEPS = np.arange(2.0, 40.5, 0.5)
# Pictures that never were JPEG had 0.04 at most, quality 95 gives 0.39 and 90 gives 0.5. Quality 98 cannot be detected.
LIKELY_COMB, CERTAIN_COMB = 0.15, 0.35
FEWEST_BLOCKS = 40


def find_jpeg(name: str, view: ViewFrames) -> list[Finding]:
    """Look for coefficients of 8 x 8 blocks that are multiples of a step on JPEG's grid, and not on a grid half a block off."""
    combs = [comb_strength(view.rendered(index)) for index in spread(view.frames, INSTANTS)]
    strength = min(comb[0] for comb in combs)
    if strength < LIKELY_COMB:
        return []
    step = float(np.median([comb[1] for comb in combs]))
    measured = f"block coefficients come in steps (about {step:g} levels): comb {strength:.2f} on the 8 x 8 grid, 0 without JPEG"
    verdict = verdict_of(strength > CERTAIN_COMB)
    values = {"comb": strength, "step_255": step}
    return [Finding(name, "JPEG", verdict, measured, values, "write PNG: JPEG costs decibels, or hides noise and gains some")]


def comb_strength(image: Image8) -> tuple[float, float]:
    """Measure how clearly block coefficients are quantised, 0 to 1, and the median step; 0 where too few are large enough."""
    crop = image[:CROP_PX, :CROP_PX].astype(np.float32)
    luma = crop @ np.array([0.299, 0.587, 0.114], np.float32) - 128
    on, off = (_coefficients(luma[start:, start:]) for start in (0, BLOCK_PX // 2))
    combs = [_comb(on[:, u, v], off[:, u, v]) for u, v in FREQUENCIES]
    told = [one for one in combs if one is not None]
    if not told:
        return 0.0, 0.0
    strength = float(np.quantile([value for value, _ in told], UNTOLD_SHARE))
    return max(strength, 0.0), float(np.median([step for value, step in told if value >= strength]))


def _coefficients(luma: Array32) -> NDArray[np.float64]:
    """Orthonormal discrete cosine transform of all whole blocks, (blocks, 8, 8)."""
    rows, columns = (size // BLOCK_PX for size in luma.shape)
    blocks = luma[: rows * BLOCK_PX, : columns * BLOCK_PX].reshape(rows, BLOCK_PX, columns, BLOCK_PX).swapaxes(1, 2)
    index = np.arange(BLOCK_PX)
    basis = np.cos(np.pi * (2 * index[None] + 1) * index[:, None] / (2 * BLOCK_PX)) * np.sqrt(2 / BLOCK_PX)
    basis[0] /= np.sqrt(2)
    return np.asarray(np.einsum("ux,nxy,vy->nuv", basis, blocks.reshape(-1, BLOCK_PX, BLOCK_PX), basis, optimize=True))


def _comb(on: NDArray[np.float64], off: NDArray[np.float64]) -> tuple[float, float] | None:
    """Measure how much better the best step fits on the grid than off it, less its gain the other way round by chance."""
    differences: list[float] = []
    for step in STEPS:
        # Coefficients that would be rounded to zero fit any large step.
        used_on, used_off = (values[np.abs(values) > 0.5 * step] for values in (on, off))
        if min(len(used_on), len(used_off)) < FEWEST_BLOCKS:
            break
        fits = [float(np.cos(2 * np.pi * used / step).mean()) for used in (used_on, used_off)]
        differences.append(fits[0] - fits[1])
    if not differences:
        return None
    best = int(np.argmax(differences))
    return differences[best] - max(-min(differences), 0.0), float(STEPS[best])
