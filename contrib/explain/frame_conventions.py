"""Numbers under other conventions: over all views and each alone, of PSNR, of L1 and root mean squared error, and of LPIPS."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

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
Levels = NDArray[Any]  # of 8 bit or not
Preparation = Callable[[Image8, Image8], tuple[Levels, Levels]]
CEILING_DB = 100.0
# Parts of a clip that values are quoted of; those that a short clip cannot tell apart are measured once.
PARTS = {
    "without the first frame": slice(1, None),
    "without the last frame": slice(-1),
    "the first frame alone": slice(1),
    "the last frame alone": slice(-1, None),
    **{f"the first {n} frames": slice(n) for n in (10, 50, 60, 100, 150)},
    **{
        f"every {word} frame": slice(None, None, step)
        for step, word in ((2, "second"), (5, "fifth"), (8, "eighth"), (10, "tenth"))
    },
    "every second frame, from the second": slice(1, None, 2),
}


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


def frame_means(
    views: Mapping[str, ViewFrames], measures: Mapping[str, FrameMeasure], ours: str, in_parts: Iterable[str] | None = None
) -> list[Recomputed]:
    """Measures of single frames, mean over the frames of a view, then over the views.

    Args:
        in_parts: measures that are taken of parts of the clip too, see `PARTS`; this tool's own by default.
    """
    names = list(measures)
    tables = {
        view: np.array([[measures[name](*pair) for name in names] for pair in view_pairs(frames)])
        for view, frames in views.items()
    }
    return mean_rows(names, tables, ours, [ours] if in_parts is None else in_parts)


def mean_rows(
    names: list[str], tables: Mapping[str, NDArray[np.float64]], ours: str, in_parts: Iterable[str]
) -> list[Recomputed]:
    """Mean values of tables (frames, names), one per view, of all frames and of parts of them."""

    def means(name: str, part: slice) -> dict[str, float]:
        return mean_over_views({view: np.mean(table[part, names.index(name)]) for view, table in tables.items()})

    rows = [Recomputed(name, means(name, slice(None)), name == ours) for name in names]
    seen = {tuple(range(len(table)) for table in tables.values())}
    for title, part in PARTS.items():
        frames = tuple(range(len(table))[part] for table in tables.values())
        if all(frames) and frames not in seen:
            seen.add(frames)
            rows += [Recomputed(f"{name}, {title}", means(name, part)) for name in in_parts if name in names]
    return rows


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


def _rgb(rendered: Levels, truth: Levels) -> tuple[Planes, Planes]:
    return rendered.astype(np.float64), truth.astype(np.float64)


def _luma(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    return rendered @ BT601, truth @ BT601


def _video_luma(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the Luma in 16..235, as super-resolution measures it."""
    return 16 + rendered @ BT601 * 219 / 255, 16 + truth @ BT601 * 219 / 255


def cropped(rendered: Image8, truth: Image8) -> tuple[Image8, Image8]:
    """Return both frames without a tenth of their size at every side, rounded down as ENeRF and MVSNeRF do."""
    return cut_border(rendered), cut_border(truth)


def _without_border(rendered: Image8, truth: Image8, *, border_px: int = 0, share: float = 0.0) -> tuple[Image8, Image8]:
    """Return both frames without some pixels, or a share of their size rounded down, at every side."""
    rows, columns = (int(share * size) or border_px for size in truth.shape[:2])
    if 2 * max(rows, columns) >= min(truth.shape[:2]):
        return rendered, truth
    inner = slice(rows, truth.shape[0] - rows), slice(columns, truth.shape[1] - columns)
    return rendered[inner], truth[inner]


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


def _framed(prepare: Preparation, rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    return _rgb(*prepare(rendered, truth))


def _summed(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the levels whose mean squared error over channels is the sum over the channels of the given ones."""
    return rendered * np.sqrt(3.0), truth * np.sqrt(3.0)


def _stretched(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the levels whose range of 255 is that of the true frame's, as torchmetrics takes it without a range."""
    factor = 255 / max(int(truth.max()) - int(truth.min()), 1)
    return np.multiply(rendered, factor, dtype=np.float64), np.multiply(truth, factor, dtype=np.float64)


def _colour_corrected(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the rendering after the affine colour map of this frame that fits best, clipped."""
    design = np.concatenate([rendered.reshape(-1, 3), np.full((truth.size // 3, 1), 255)], axis=1).astype(np.float64)
    target = truth.reshape(-1, 3).astype(np.float64)
    fitted, *_ = np.linalg.lstsq(design.T @ design, design.T @ target, rcond=1e-12)
    return np.clip(design @ fitted, 0, 255), target


# Frames of another size or part, which PSNR, SSIM and L1 are taken of as well.
FRAMINGS: Mapping[str, Preparation] = {
    "both at half size": halved,
    "truth of half size enlarged": half_truth,
    "both at 960 x 640": at_llff_size,
    "without a border of 5 %": partial(_without_border, share=0.05),
    **{f"without a border of {n} px": partial(_without_border, border_px=n) for n in (4, 8, 16)},
}
PREPARATIONS: Mapping[str, Preparation] = {
    "RGB": _rgb,
    "luma (BT.601) in 0..255": _luma,
    "luma (BT.601) in 16..235, peak 255": _video_luma,
    "luma (BT.601) in 16..235, peak 255, without a border of 4 px": lambda *pair: _video_luma(
        *_without_border(*pair, border_px=4)
    ),
    "grey of 8 bit": lambda rendered, truth: _rgb(grey(rendered), grey(truth)),
    "RGB, squared errors summed over channels": _summed,
    "RGB, range 2 of images in 0..1": lambda rendered, truth: (rendered / 2, truth / 2),
    "RGB, range of the true frame": _stretched,
    **{f"RGB, {name}": partial(_framed, prepare) for name, prepare in FRAMINGS.items()},
    "RGB without a border of 10 %": lambda rendered, truth: _rgb(*cropped(rendered, truth)),
    "RGB, both at 960 x 640, without a border of 10 % (MVSNeRF on LLFF)": as_mvsnerf,
    "RGB after the best affine colour map": _colour_corrected,
}
OUR_PSNR = "RGB, mean of the frames' PSNR"


def psnr_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """PSNR over several kinds of pixels, averaged before or after the logarithm."""
    from skimage.metrics import mean_squared_error

    errors: dict[str, dict[str, list[float]]] = {name: {} for name in (*PREPARATIONS, *VIDEO_SAMPLES)}
    of_frames: dict[str, NDArray[np.float64]] = {}
    for view, frames in views.items():
        rows, weighted = [], []
        for rendered, truth in view_pairs(frames):
            planes = {form: _plane_errors(convert(rendered), convert(truth)) for form, convert in VIDEO_FORMS.items()}
            rows.append([mean_squared_error(*prepare(rendered, truth)) for prepare in PREPARATIONS.values()])
            rows[-1] += [np.average(planes[form], weights=weights) for form, weights in VIDEO_SAMPLES.values()]
            channels = decibels(np.square(np.subtract(*_rgb(rendered, truth))).mean(axis=(0, 1)))
            weighted.append(
                [
                    rows[-1][0],
                    channels.mean(),
                    *(np.average(decibels(np.array(each)), weights=(6, 1, 1)) for each in planes.values()),
                ]
            )
        for name, values in zip(errors, zip(*rows, strict=True), strict=True):
            errors[name][view] = list(values)
        of_frames[view] = np.array(weighted)
        of_frames[view][:, 0] = decibels(of_frames[view][:, 0])
    if masks:
        errors |= _masked_errors(views, masks)
    names = [
        OUR_PSNR,
        "RGB, PSNR of each channel, then the mean (3DGS's log)",
        *(f"{form}, (6 Y + U + V) / 8" for form in VIDEO_FORMS),
    ]
    others = [row for row in mean_rows(names, of_frames, OUR_PSNR, [OUR_PSNR]) if row.name != OUR_PSNR]
    return [row for name, by_view in errors.items() for row in _averaged(name, by_view)] + others


def ycbcr(image: Image8, matrix: NDArray[np.float64], has_headroom: bool = True) -> Planes:
    """YCbCr of a frame in levels that are not rounded, (H, W, 3); luma in 16..235 with headroom, else 0..255."""
    y = image @ matrix
    scale, offset, chroma = (219 / 255, 16, 224 / 255) if has_headroom else (1.0, 0, 1.0)
    blue, red = (128 + chroma * (image[..., c] - y) / (2 * (1 - matrix[c])) for c in (2, 0))
    return np.stack([offset + scale * y, blue, red], axis=-1)


def _video_420(image: Image8, matrix: NDArray[np.float64], has_headroom: bool) -> list[Planes]:
    """Planes of 8-bit 4:2:0: chroma averaged over 2 x 2 of its rounded values."""
    y, *chroma = np.moveaxis(np.rint(ycbcr(image, matrix, has_headroom)).clip(0, 255), -1, 0)
    return [y, *(np.rint(cv2.resize(c, (c.shape[1] // 2, c.shape[0] // 2), interpolation=cv2.INTER_AREA)) for c in chroma)]


def _swscale_420(image: Image8) -> list[Planes]:
    """Planes of yuv420p as FFmpeg converts pictures to it by default: BT.601, 16..235, bicubic chroma."""
    from av import VideoFrame

    even = np.ascontiguousarray(image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2])
    height, width = even.shape[:2]
    samples = VideoFrame.from_ndarray(even, format="rgb24").reformat(format="yuv420p").to_ndarray().astype(np.float64)
    return [samples[:height], *samples[height:].reshape(2, height // 2, width // 2)]


def _plane_errors(rendered: list[Planes], truth: list[Planes]) -> list[float]:
    return [float(np.square(first - second).mean()) for first, second in zip(rendered, truth, strict=True)]


# 8-bit video of 4:2:0: Y, U and V, as (6 Y + U + V) / 8 of their PSNR or from the squared errors of all samples.
VIDEO_FORMS: Mapping[str, Callable[[Image8], list[Planes]]] = {
    **{
        f"YUV 4:2:0 of 8 bit ({name}, {levels})": partial(_video_420, matrix=matrix, has_headroom=headroom)
        for name, matrix in (("BT.709", BT709), ("BT.601", BT601))
        for levels, headroom in (("16..235", True), ("0..255", False))
    },
    "yuv420p of FFmpeg (BT.601)": _swscale_420,
}
VIDEO_SAMPLES = {
    f"{form}, {name}": (form, weights)
    for form in VIDEO_FORMS
    for name, weights in (("Y alone", (1, 0, 0)), ("all samples (ffmpeg's average)", (4, 1, 1)))
    if name != "Y alone" or "0..255" not in form  # which is a grey of 8 bit
}


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
    """Return the squared errors of the pixels inside the masks, and of frames that are changed by them."""
    errors: dict[str, dict[str, list[float]]] = {name: {} for name in ("pixels inside the mask", *MASKINGS)}
    for view in (view for view in views if view in masks):
        rows = []
        for index in views[view].frames:
            rendered, truth, mask = views[view].rendered(index), views[view].truth(index), masks[view](index)
            pairs = [(rendered[mask], truth[mask]) if mask.any() else (truth, truth)]
            pairs += [(change(rendered, mask), change(truth, mask)) for change in MASKINGS.values()]
            rows.append([float(np.square(np.subtract(*_rgb(*pair))).mean()) for pair in pairs])
        for name, values in zip(errors, zip(*rows, strict=True), strict=True):
            errors[name][view] = list(values)
    del errors["frames white outside the mask"]  # whose errors are those of black ones
    if errors["pixels inside the mask"] == errors["the rectangle around the mask"]:
        del errors["the rectangle around the mask"]
    return errors if next(iter(errors.values())) else {}


def masked_rows(
    views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader], measures: Mapping[str, FrameMeasure]
) -> list[Recomputed]:
    """Measures of frames that are changed by masks; none unless every view has them."""
    if not all(view in masks for view in views):
        return []
    tables = {
        view: np.array(
            [
                [
                    measure(change(frames.rendered(t), mask), change(frames.truth(t), mask))
                    for change, measure in ((change, measure) for measure in measures.values() for change in MASKINGS.values())
                ]
                for t, mask in ((t, masks[view](t)) for t in frames.frames)
            ]
        )
        for view, frames in views.items()
    }
    return mean_rows([f"{name}, {title}" for name in measures for title in MASKINGS], tables, "", ())


def _filled(image: Image8, mask: NDArray[np.bool_], level: int) -> Image8:
    return np.where(mask[..., None], image, np.uint8(level))


def _rectangle(image: Image8, mask: NDArray[np.bool_]) -> Image8:
    """Return the part of a frame around the white of its mask; the frame if there is none."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return image[y : y + height, x : x + width] if width else image


MASKINGS: Mapping[str, Callable[[Image8, NDArray[np.bool_]], Image8]] = {
    "frames black outside the mask": partial(_filled, level=0),
    "frames white outside the mask": partial(_filled, level=255),
    "the rectangle around the mask": _rectangle,
}


OUR_L1 = "mean over pixels and channels"


def error_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the mean absolute error and root mean squared error, in levels and in 0..1."""
    rows = [*_absolute_errors(views), *_root_squared_errors(views), *masked_rows(views, masks, {OUR_L1: _absolute})]
    return [row for one in rows for row in _on_both_scales(one)]


def rmse_conventions(views: Mapping[str, ViewFrames], masks: Mapping[str, MaskReader]) -> list[Recomputed]:
    """Return the same; none is this tool's, which measures no RMSE."""
    return [replace(row, is_ours=False) for row in error_conventions(views, masks)]


def _on_both_scales(row: Recomputed) -> list[Recomputed]:
    scaled = {over: value / 255 for over, value in row.values.items()}
    return [replace(row, name=f"{row.name}, 0..255"), Recomputed(f"{row.name}, 0..1", scaled)]


def _absolute(rendered: NDArray[Any], truth: NDArray[Any]) -> float:
    return float(np.abs(rendered.astype(np.float64) - truth).mean())


def _absolute_errors(views: Mapping[str, ViewFrames]) -> list[Recomputed]:
    measures: dict[str, FrameMeasure] = {
        OUR_L1: _absolute,
        "sum over channels, mean over pixels": lambda *pair: 3 * _absolute(*pair),
        "without a border of 10 %": lambda *pair: _absolute(*cropped(*pair)),
        "grey of 8 bit": lambda rendered, truth: _absolute(grey(rendered), grey(truth)),
        **{name: partial(_prepared, _absolute, prepare) for name, prepare in FRAMINGS.items()},
    }
    return frame_means(views, measures, OUR_L1)


def _prepared(measure: FrameMeasure, prepare: Preparation, rendered: Image8, truth: Image8) -> float:
    return measure(*prepare(rendered, truth))


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
    return frame_means(views, measures, OUR_LPIPS, list(measures)[:2]) + masked_rows(
        views, masks, dict(list(measures.items())[:2])
    )
