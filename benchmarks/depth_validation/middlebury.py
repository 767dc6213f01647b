"""Pairwise matchers on a real rectified pair with measured disparity: Motorcycle of Middlebury
2014, 741 x 500.

Every pixel of known disparity counts, those hidden from the right image too. A network's answer
counts where it is rejected, too; other matchers' gaps are filled as the pipeline fills them: with
the smaller disparity, the background's, of the nearest kept pixels left and right, else above and
below.
"""

import zipfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.depth_validation.figures import Figures, Measure, figures_of, quoted_figures
from ggvs_eval.arrays import Image8, Map
from ggvs_eval.errors import DepthError
from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.offline.stereo.fusion import fill_background
from ggvs_eval.pipelines.offline.stereo.pairwise import StereoMatcher
from ggvs_eval.pipelines.offline.stereo.raft_matcher import RaftMatcher
from ggvs_eval.progress import track

FOLDER = "stereo_motorcycle"
DISPARITY_RANGE_PX = (0, 80)  # the scene's own, 7 to 60, is not given to a matcher
LEARNED = "raft"
MEASURES = (
    Measure("epe_px", "px", higher_is_better=False, target=1.5, target_of=LEARNED),
    Measure("bad_2_percent", "%", higher_is_better=False),
    Measure("bad_3_percent", "%", higher_is_better=False, target=8.0, target_of=LEARNED),
    Measure("epe_kept_px", "px", higher_is_better=False),
    Measure("density_percent", "%", higher_is_better=True),
)
# What others reached on this pair, all valid pixels.
QUOTED = {
    "KITTI-trained PSMNet": {"epe_px": 1.81, "bad_3_percent": 8.6},
    "quoted SGBM": {"epe_px": 4.14, "bad_3_percent": 17.3},
}


@dataclass(frozen=True, eq=False)
class RectifiedTruth:
    """A rectified pair and what is known of it.

    Attributes:
        left: RGB, (H, W, 3).
        right: RGB, (H, W, 3).
        disparity: of the left image, pixels, 0 = unknown, (H, W).
    """

    left: Image8
    right: Image8
    disparity: Map


def read_motorcycle(folder: Path) -> RectifiedTruth:
    """Read the pair: motorcycle_left.png, motorcycle_right.png and motorcycle_disp.npz.

    Raises:
        CaptureError: an image is absent or damaged.
        DepthError: the disparity is absent, damaged or of another size.
    """
    left, right = (read_image(folder / f"motorcycle_{side}.png") for side in ("left", "right"))
    path = folder / "motorcycle_disp.npz"
    try:
        with np.load(path, allow_pickle=False) as arrays:
            disparity = arrays[arrays.files[0]].astype(np.float32)
    except (OSError, ValueError, IndexError, EOFError, zipfile.BadZipFile) as error:
        raise DepthError(
            f"{path}: wanted the measured disparity, got none ({error}); copy the file again"
        ) from error
    if not left.shape[:2] == right.shape[:2] == disparity.shape:
        sizes = f"{left.shape[:2]}, {right.shape[:2]} and {disparity.shape}"
        raise DepthError(
            f"{path}: wanted images and disparity of one size, got {sizes}; copy the folder again"
        )
    return RectifiedTruth(left, right, np.where(np.isfinite(disparity), disparity, np.float32(0)))


def score_disparity(disparity: Map, truth: Map, whole: Map | None = None) -> dict[str, float]:
    """Return the measures of one disparity map.

    Args:
        disparity: (H, W), pixels, 0 = rejected.
        truth: (H, W), pixels, 0 = unknown.
        whole: the same with an answer for every pixel, (H, W); `disparity`, filled, by default.

    Returns:
        End-point error and shares of pixels wrong by more than 2 and 3 px of the whole, the
        end-point error of the kept pixels alone (NaN where none is kept), and the share of pixels
        kept, all over the pixels of known disparity.

    Raises:
        DepthError: shapes differ, or no disparity is known.
    """
    has_truth = truth > 0
    if disparity.shape != truth.shape or not has_truth.any():
        sizes = (
            f"{disparity.shape} against {truth.shape} with {np.count_nonzero(has_truth)} known "
            "pixels"
        )
        raise DepthError(
            f"disparity errors: wanted two maps of one size and a known pixel, got {sizes}"
        )
    errors = np.abs((fill_disparity(disparity) if whole is None else whole) - truth)[has_truth]
    kept = disparity[has_truth] > 0
    return {
        "epe_px": float(errors.mean()),
        "bad_2_percent": float(100 * (errors > 2).mean()),
        "bad_3_percent": float(100 * (errors > 3).mean()),
        "epe_kept_px": float(errors[kept].mean()) if kept.any() else float("nan"),
        "density_percent": float(100 * kept.mean()),
    }


def fill_disparity(disparity: Map) -> Map:
    """Rejected pixels from the background next to them, by the pipeline's own rule, which speaks of
    depth; (H, W).
    """
    inverse = np.divide(1, disparity, out=np.zeros_like(disparity), where=disparity > 0)
    filled, _ = fill_background(inverse, np.zeros_like(inverse), filled_confidence=1.0)
    background = np.divide(1, filled, out=np.zeros_like(disparity), where=filled > 0)
    return np.where(disparity > 0, disparity, background)


def _evaluated(matcher: StereoMatcher, pair: RectifiedTruth) -> dict[str, float]:
    """Return the measures of one matcher; a network has an answer where it rejects it."""
    kept, _ = matcher.match(pair.left, pair.right, *DISPARITY_RANGE_PX)
    if not isinstance(matcher, RaftMatcher):
        return score_disparity(kept, pair.disparity)
    answer = matcher.disparity(pair.left, pair.right, *DISPARITY_RANGE_PX)
    return score_disparity(
        kept, pair.disparity, np.where(kept > 0, kept, np.maximum(answer, np.float32(0)))
    )


def evaluate_motorcycle(
    folder: Path, matchers: Mapping[str, StereoMatcher]
) -> tuple[dict[str, dict[str, float]], Figures]:
    """Return every matcher on the pair.

    Args:
        folder: holds the pair.
        matchers: by name.

    Returns:
        The measures of each matcher, and their figures.
    """
    pair = read_motorcycle(folder)
    rows = {
        name: _evaluated(matcher, pair)
        for name, matcher in track(matchers.items(), "motorcycle", len(matchers))
    }
    return rows, figures_of("motorcycle", MEASURES, rows) | quoted_figures(
        "motorcycle", MEASURES, rows, QUOTED
    )
