"""Pictures that were enlarged from fewer pixels: interpolation repeats itself, and nothing fine is left."""

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.pipelines.inspection.finding import Finding, verdict_of
from ggvs_eval.pipelines.inspection.renders.view_frames import ViewFrames, spread

INSTANTS = 3
# Period of the traces, px, and the factors that leave them; a rational factor p/q repeats after p pixels.
PERIODS_PX = {2.0: "2", 3.0: "3 or 1.5", 4.0: "4 or 1.33", 2.5: "2.5 or 1.67", 5.0: "5 or 1.25"}
# Renders had 2.6 at most; linear interpolation gives 3.7 to 50, cubic by 2 leaves no period and looks like blur.
LIKELY_PEAK, CERTAIN_PEAK = 4.5, 9.0
# Energy above the smaller picture's finest frequencies relative to the truth's; honest blur also lowers it, without a period.
LARGEST_FINE_SHARE = 0.35
# Repeated pixels have edges of their own, but also peaks of 90 and more.
PLAIN_PEAK = 40.0


def find_upscaling(name: str, view: ViewFrames) -> list[Finding]:
    """Look for periods in the curvature along rows and columns, as interpolation leaves them, where fine detail is missing."""
    peaks: list[dict[float, float]] = []
    shares: list[float] = []
    for rendered, truth in view.pairs(spread(view.frames, INSTANTS)):
        peaks.append(period_peaks(rendered))
        shares.append(fine_energy(rendered) / max(fine_energy(truth), 1e-9))
    strength = {period: min(peak[period] for peak in peaks) for period in PERIODS_PX}
    period = max(strength, key=lambda key: strength[key])
    share = float(np.median(shares))
    if strength[period] < LIKELY_PEAK or (share > LARGEST_FINE_SHARE and strength[period] < PLAIN_PEAK):
        return []
    verdict = verdict_of(strength[period] > CERTAIN_PEAK)
    measured = (
        f"interpolated by {PERIODS_PX[period]}: period of {period:g} px {strength[period]:.0f} times the usual, "
        f"{share:.0%} of the finest detail is left"
    )
    values = {"period_px": period, "peak": strength[period], "fine_share": share}
    advice = "rendered at a smaller size and enlarged? render at the full size"
    return [Finding(name, "up-scaled", verdict, measured, values, advice)]


def period_peaks(image: Image8) -> dict[float, float]:
    """For each period the weaker of its peaks along both axes, relative to the spectrum around it."""
    grey = image.astype(np.float32).mean(axis=-1)
    both = [_axis_peaks(plane) for plane in (grey, grey.T)]
    return {period: min(peaks[period] for peaks in both) for period in PERIODS_PX}


def fine_energy(image: Image8) -> float:
    """Mean squared second difference along both axes, mostly of the finest frequencies."""
    grey = image.astype(np.float32).mean(axis=-1)
    return float(np.mean([np.square(np.diff(grey, 2, axis=axis)).mean() for axis in (0, 1)]))


def _axis_peaks(plane: NDArray[np.float32]) -> dict[float, float]:
    """Peaks in the spectrum of the mean slope or curvature of each column, relative to the usual of that spectrum.

    Curvature has the period of linear and cubic interpolation, but for a factor of 2, which only the slope shows.
    """
    both = [_spectrum_peaks(np.abs(np.diff(plane, order, axis=1)).mean(axis=0)) for order in (1, 2)]
    return {period: max(peaks[period] for peaks in both) for period in PERIODS_PX}


def _spectrum_peaks(profile: NDArray[np.float32]) -> dict[float, float]:
    level = np.log(profile + 0.05)
    # Only what changes within a few pixels; the picture itself changes slowly.
    fine = level - np.convolve(np.pad(level, 4, mode="edge"), np.ones(9) / 9, mode="valid")
    windowed = fine * np.hanning(len(fine))
    positions = np.arange(len(fine))
    usual = float(np.median(np.abs(np.fft.rfft(windowed))[len(fine) // 8 :])) + 1e-9
    return {period: float(abs((windowed * np.exp(-2j * np.pi * positions / period)).sum())) / usual for period in PERIODS_PX}
