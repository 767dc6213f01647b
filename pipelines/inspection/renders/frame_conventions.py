"""Numbers under other conventions: over all views and each alone, of PSNR, of L1 and root mean squared error, and of LPIPS."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.measured_frames import MVSNERF, cut_border
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames

ALL_VIEWS = "all views"
MaskReader = Callable[[int], NDArray[np.bool_]]
FrameMeasure = Callable[[Image8, Image8], float]
BT601 = np.array([0.299, 0.587, 0.114])
BT709 = np.array([0.2126, 0.7152, 0.0722])
Planes = NDArray[np.float64]
Preparation = Callable[[Image8, Image8], tuple[Planes, Planes]]
CEILING_DB = 100.0


@dataclass(frozen=True)
class Recomputed:
    """A convention and its values.

    Attributes:
        values: ``all views`` or the name of a view -> number.
        is_ours: whether it is this tool's convention.
    """

    name: str
    values: Mapping[str, float]
    is_ours: bool = False


def view_pairs(view: ViewFrames) -> Iterator[tuple[Image8, Image8]]:
    """Rendered and true frames in order, one pair in memory."""
    for pair in view.pairs(list(view.frames)):
        check_pair(*pair)
        yield pair


def frame_means(views: Mapping[str, ViewFrames], measures: Mapping[str, FrameMeasure], ours: str) -> list[Recomputed]:
    """Measures of single frames, mean over the frames of a view, then over the views."""
    names = list(measures)
    tables = {view: [[measures[name](*pair) for name in names] for pair in view_pairs(frames)] for view, frames in views.items()}
    return [
        Recomputed(
            name, mean_over_views({view: np.mean([row[i] for row in rows]) for view, rows in tables.items()}), name == ours
        )
        for i, name in enumerate(names)
    ]


def mean_over_views(by_view: Mapping[str, float | np.floating]) -> dict[str, float]:
    """Return the values of single views, and their mean."""
    return {ALL_VIEWS: float(np.mean(list(by_view.values())))} | {view: float(value) for view, value in by_view.items()}


def changes(view: ViewFrames, between: Callable[[Image8, Image8], Image8]) -> Iterable[tuple[Image8, Image8]]:
    """Yield the change from each frame to the next, rendered and true."""
    before: tuple[Image8, Image8] | None = None
    for rendered, truth in view_pairs(view):
        if before is not None:
            yield between(before[0], rendered), between(before[1], truth)
        before = rendered, truth


def _rgb(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    return rendered.astype(np.float64), truth.astype(np.float64)


def _luma(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    return rendered @ BT601, truth @ BT601


def _video_luma(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the Luma in 16..235, as super-resolution measures it."""
    return 16 + rendered @ BT601 * 219 / 255, 16 + truth @ BT601 * 219 / 255


def cropped(rendered: Image8, truth: Image8) -> tuple[Image8, Image8]:
    """Return both frames without a tenth of their size at every side, rounded down as ENeRF and MVSNeRF do."""
    return cut_border(rendered), cut_border(truth)


def grey(image: Image8) -> Image8:
    """Return the Luma rounded to 8 bit, (H, W), as OpenCV and Pillow convert."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def halved(rendered: Image8, truth: Image8) -> tuple[Image8, Image8]:
    """Return both frames at half their size, box averages of 8 bit."""
    return _half(rendered), _half(truth)


def as_mvsnerf(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return both frames as MVSNeRF's notebook measures LLFF, in levels of 255: at 960 x 640, without a border."""
    first, second = (255 * MVSNERF.prepare(image) for image in (rendered, truth))
    return first, second


def at_llff_size(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return both frames at the size at which MVSNeRF evaluates LLFF, resized as its notebook does, in levels of 255."""
    whole = replace(MVSNERF, is_cut=False)
    return 255 * whole.prepare(rendered), 255 * whole.prepare(truth)


def half_truth(rendered: Image8, truth: Image8) -> tuple[Image8, Image8]:
    """Return the frame as rendered, and a truth that was kept at half size and enlarged again, linearly."""
    size = truth.shape[1], truth.shape[0]
    # OpenCV does not round what it interpolates in 8 bit.
    enlarged = cv2.resize(_half(truth).astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return rendered, np.rint(enlarged).astype(np.uint8)


def _half(image: Image8) -> Image8:
    size = image.shape[1] // 2, image.shape[0] // 2
    return np.asarray(cv2.resize(image, size, interpolation=cv2.INTER_AREA), dtype=np.uint8)


def _summed(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the levels whose mean squared error over channels is the sum over the channels of the given ones."""
    return rendered * np.sqrt(3.0), truth * np.sqrt(3.0)


def _colour_corrected(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the rendering after the affine colour map of this frame that fits best, clipped."""
    design = np.concatenate([rendered.reshape(-1, 3), np.full((truth.size // 3, 1), 255)], axis=1).astype(np.float64)
    target = truth.reshape(-1, 3).astype(np.float64)
    fitted, *_ = np.linalg.lstsq(design.T @ design, design.T @ target, rcond=1e-12)
    return np.clip(design @ fitted, 0, 255), target


PREPARATIONS: Mapping[str, Preparation] = {
    "RGB": _rgb,
    "luma (BT.601) in 0..255": _luma,
    "luma (BT.601) in 16..235, peak 255": _video_luma,
    "grey of 8 bit": lambda rendered, truth: _rgb(grey(rendered), grey(truth)),
    "RGB, squared errors summed over channels": _summed,
    "RGB, both at half size": lambda rendered, truth: _rgb(*halved(rendered, truth)),
    "RGB, truth of half size enlarged": lambda rendered, truth: _rgb(*half_truth(rendered, truth)),
    "RGB without a border of 10 %": lambda rendered, truth: _rgb(*cropped(rendered, truth)),
    "RGB, both at 960 x 640, without a border of 10 % (MVSNeRF on LLFF)": as_mvsnerf,
    "RGB after the best affine colour map": _colour_corrected,
}
OUR_PSNR = "RGB, mean of the frames' PSNR"


def psnr_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """PSNR over several kinds of pixels, averaged before or after the logarithm."""
    from skimage.metrics import mean_squared_error

    errors: dict[str, dict[str, list[float]]] = {name: {} for name in PREPARATIONS}
    for view, frames in views.items():
        table = [[mean_squared_error(*prepare(*pair)) for prepare in PREPARATIONS.values()] for pair in view_pairs(frames)]
        for i, name in enumerate(PREPARATIONS):
            errors[name][view] = [row[i] for row in table]
    if masks:
        errors |= _masked_errors(views, masks)
    return [row for name, by_view in errors.items() for row in _averaged(name, by_view)]


def _averaged(name: str, errors: Mapping[str, list[float]]) -> list[Recomputed]:
    """Return the mean of PSNRs, PSNR of the mean squared error, and the latter per view."""
    per_frame = mean_over_views({view: np.mean(decibels(np.array(values))) for view, values in errors.items()})
    per_view = mean_over_views({view: float(decibels(np.mean(values))) for view, values in errors.items()})
    pooled = {ALL_VIEWS: float(decibels(np.mean([value for values in errors.values() for value in values])))}
    rows = [Recomputed(f"{name}, mean of the frames' PSNR", per_frame, f"{name}, mean of the frames' PSNR" == OUR_PSNR)]
    if len(errors) > 1:
        rows.append(Recomputed(f"{name}, PSNR of each view's mean squared error", per_view))
    single = {view: value for view, value in per_view.items() if view != ALL_VIEWS} if len(errors) == 1 else {}
    return [*rows, Recomputed(f"{name}, PSNR of the mean squared error", pooled | single)]


def decibels(squared_error_255: NDArray[np.float64] | np.floating | float) -> NDArray[np.float64]:
    """PSNR on the scale 0..255, at most 100 dB."""
    return np.minimum(-10 * np.log10(np.maximum(squared_error_255, 1e-12) / 255**2), CEILING_DB)


def _masked_errors(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> dict[str, dict[str, list[float]]]:
    """Return the squared errors of the pixels inside the masks, and of whole frames that are black outside."""
    inside: dict[str, list[float]] = {}
    blackened: dict[str, list[float]] = {}
    for view in (view for view in views if view in masks):
        rows = []
        for index in views[view].frames:
            mask = masks[view](index)
            squared = np.square(views[view].rendered(index).astype(np.float64) - views[view].truth(index))[mask]
            rows.append((float(squared.mean()) if mask.any() else 0.0, float(squared.sum()) / (3 * mask.size)))
        inside[view], blackened[view] = ([row[i] for row in rows] for i in (0, 1))
    if not inside:
        return {}
    return {"pixels inside the mask": inside, "frames black outside the mask": blackened}


OUR_L1 = "mean over pixels and channels"


def error_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the mean absolute error and root mean squared error, in levels and in 0..1."""
    return [row for one in [*_absolute_errors(views), *_root_squared_errors(views)] for row in _on_both_scales(one)]


def _on_both_scales(row: Recomputed) -> list[Recomputed]:
    scaled = {over: value / 255 for over, value in row.values.items()}
    return [replace(row, name=f"{row.name}, 0..255"), Recomputed(f"{row.name}, 0..1", scaled)]


def _absolute_errors(views: Mapping[str, ViewFrames]) -> list[Recomputed]:

    def absolute(rendered: Image8, truth: Image8) -> float:
        return float(np.abs(rendered.astype(np.float64) - truth).mean())

    measures: dict[str, FrameMeasure] = {
        OUR_L1: absolute,
        "sum over channels, mean over pixels": lambda *pair: 3 * absolute(*pair),
        "without a border of 10 %": lambda *pair: absolute(*cropped(*pair)),
        "grey of 8 bit": lambda rendered, truth: absolute(grey(rendered), grey(truth)),
        "both at half size": lambda *pair: absolute(*halved(*pair)),
        "truth of half size enlarged": lambda *pair: absolute(*half_truth(*pair)),
    }
    return frame_means(views, measures, OUR_L1)


def _root_squared_errors(views: Mapping[str, ViewFrames]) -> list[Recomputed]:
    """Return the root before and after the mean over frames, and views."""
    squared: dict[str, FrameMeasure] = {"": lambda *pair: float(np.square(np.subtract(*_rgb(*pair))).mean())}
    squared["grey of 8 bit, "] = lambda rendered, truth: squared[""](grey(rendered), grey(truth))
    tables = {
        view: np.array([[measure(*pair) for measure in squared.values()] for pair in view_pairs(frames)])
        for view, frames in views.items()
    }
    rows: list[Recomputed] = []
    for i, kind in enumerate(squared):
        frames = mean_over_views({view: np.sqrt(table[:, i]).mean() for view, table in tables.items()})
        each = {view: float(np.sqrt(table[:, i].mean())) for view, table in tables.items()}
        pooled = {ALL_VIEWS: float(np.sqrt(np.concatenate([table[:, i] for table in tables.values()]).mean()))}
        rows.append(Recomputed(f"{kind}mean of the frames' root mean squared error (RMSE)", frames))
        rows.append(Recomputed(f"{kind}root of the mean squared error of all frames (RMSE)", pooled | each))
    return rows


OUR_LPIPS = "VGG, inputs in [-1, 1]"


def lpips_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """LPIPS v0.1 on either network, also with inputs left in [0, 1], which it was not trained on."""
    from ggvs_eval.metrics.image.lpips import lpips

    def unscaled(image: Image8) -> NDArray[np.float32]:
        return np.asarray(
            (image.astype(np.float32) / 255 + 1) / 2, np.float32
        )  # `lpips` maps this to [0, 1] where it expects [-1, 1]

    measures: dict[str, FrameMeasure] = {
        OUR_LPIPS: lambda rendered, truth: lpips(rendered, truth, "vgg"),
        "AlexNet, inputs in [-1, 1]": lambda rendered, truth: lpips(rendered, truth, "alex"),
        "VGG, inputs in [0, 1]": lambda rendered, truth: lpips(unscaled(rendered), unscaled(truth), "vgg"),
        "VGG, inputs in [-1, 1], both at half size": lambda *pair: lpips(*halved(*pair), "vgg"),
        "AlexNet, inputs in [0, 1]": lambda rendered, truth: lpips(unscaled(rendered), unscaled(truth), "alex"),
    }
    return frame_means(views, measures, OUR_LPIPS)
