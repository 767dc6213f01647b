"""Every convention is recognised by a value computed independently of it; a wrong value is
recognised by none.
"""

from fractions import Fraction
from functools import cache

import cv2
import numpy as np
import pytest
from scipy import ndimage
from skimage import data

from ggvs_eval.contrib.explain.conventions import ALL_VIEWS, Recomputed
from ggvs_eval.contrib.explain.explain import (
    FAMILIES,
    Convention,
    chance,
    explain,
    explanation_table,
    metric_family,
    printed,
    read_masks,
    tolerance,
)
from ggvs_eval.contrib.explain.ssim_conventions import frame_measures
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels, write_image
from ggvs_eval.metrics.image.fetch_lpips import NETS
from ggvs_eval.metrics.image.lpips_network import weights_path
from ggvs_eval.metrics.image.ms_ssim import ms_ssim
from ggvs_eval.metrics.time.strred import luma, pool, strred
from ggvs_eval.metrics.time.tcc import tcc
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import Measurement

SHAPE, N_FRAMES = (72, 96), 5
VIEWS = ("cam00", "cam01", "cam02")


def make_frames(view: int) -> tuple[np.ndarray, np.ndarray]:
    """Rendered and true frames of one view: a window that wanders over a photograph; the rendering
    is soft, grainy, reddish.
    """
    rng = np.random.default_rng(view)
    truth, rendered = [], []
    for t in range(N_FRAMES):
        row, column = 60 + 50 * view + 2 * t, 80 + 3 * t
        image = np.ascontiguousarray(
            data.astronaut()[row : row + SHAPE[0], column : column + SHAPE[1]]
        )
        soft = cv2.GaussianBlur(image, (0, 0), 0.8 + 0.2 * view) * (1.04, 1.0, 0.97)
        truth.append(image)
        rendered.append(round_levels(soft + rng.normal(0, 3 + t, image.shape)))
    return np.stack(rendered), np.stack(truth)


FRAMES = [make_frames(view) for view in range(len(VIEWS))]


def views_of(names: tuple[str, ...] = VIEWS) -> dict[str, ViewFrames]:
    return {
        name: ViewFrames(lambda t, r=rendered: r[t], lambda t, c=truth: c[t], range(N_FRAMES))
        for name, (rendered, truth) in zip(VIEWS, FRAMES, strict=True)
        if name in names
    }


@cache
def recomputed(family: str, names: tuple[str, ...]) -> list[Recomputed]:
    return FAMILIES[family](views_of(names), {})


def explained(
    metric: str, value: float, digits: int = 5, names: tuple[str, ...] = VIEWS
) -> set[str]:
    """Names of the conventions that give a value over all views; each convention is computed once
    for all values.
    """
    found = explain_again(metric, f"{value:.{digits}f}", names)
    return {one.name for one in found if one.matches and one.views == ALL_VIEWS}


def explain_again(metric: str, quoted: str, names: tuple[str, ...] = VIEWS) -> list[Convention]:
    rows = recomputed(metric_family(metric), names)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Registry, "__getitem__", lambda _families, _name: lambda _views, _masks: rows)
        return explain(metric, quoted, views_of(names))


def mean_over_frames(measure) -> float:
    """Mean of a measure of two frames over all frames of all views."""
    return float(
        np.mean(
            [
                measure(r, c)
                for rendered, truth in FRAMES
                for r, c in zip(rendered, truth, strict=True)
            ]
        )
    )


def squared(rendered, truth) -> float:
    return float(((rendered.astype(float) - truth) ** 2).mean())


def decibels(squared_error) -> float:
    return float(10 * np.log10(255**2 / squared_error))


def grey(image, weights=(0.299, 0.587, 0.114)) -> np.ndarray:
    return image.astype(float) @ np.array(weights)


def inner(image) -> np.ndarray:
    rows, columns = int(0.1 * SHAPE[0]), int(0.1 * SHAPE[1])
    return image[rows:-rows, columns:-columns]


def grey_of_8_bit(image) -> np.ndarray:
    return np.floor(grey(image) + 0.5)


def half(image) -> np.ndarray:
    """Means of 2 x 2 pixels, rounded as they are written."""
    return np.floor(image.reshape(SHAPE[0] // 2, 2, SHAPE[1] // 2, 2, 3).mean(axis=(1, 3)) + 0.5)


def enlarged(image) -> np.ndarray:
    """Twice the size, linear between pixel centres, rounded."""
    import torch

    planes = torch.from_numpy(image).permute(2, 0, 1)[None]
    return np.rint(
        torch.nn.functional.interpolate(planes, scale_factor=2, mode="bilinear")[0]
        .permute(1, 2, 0)
        .numpy()
    )


def yuv_420(image) -> list[np.ndarray]:
    """Planes of BT.709 in 16..235, rounded; chroma is the rounded mean of 2 x 2."""
    y = grey(image, (0.2126, 0.7152, 0.0722))
    chroma = [
        np.rint(128 + 224 / 255 * (image[..., n] - y) / d) for n, d in ((2, 1.8556), (0, 1.5748))
    ]
    quarters = [
        plane.reshape(SHAPE[0] // 2, 2, SHAPE[1] // 2, 2).mean(axis=(1, 3)) for plane in chroma
    ]
    return [np.rint(16 + 219 / 255 * y), *map(np.rint, quarters)]


def psnr_of_some(some: slice) -> float:
    pairs = [
        pair for rendered, truth in FRAMES for pair in zip(rendered[some], truth[some], strict=True)
    ]
    return float(np.mean([decibels(squared(*pair)) for pair in pairs]))


PSNR_OF_FRAMES = {
    "RGB, mean of the frames' PSNR": lambda r, c: decibels(squared(r, c)),
    "luma (BT.601) in 0..255, mean of the frames' PSNR": lambda r, c: decibels(
        squared(grey(r), grey(c))
    ),
    "luma (BT.601) in 16..235, peak 255, mean of the frames' PSNR": lambda r, c: decibels(
        squared(grey(r), grey(c)) * (219 / 255) ** 2
    ),
    "RGB without a border of 10 %, mean of the frames' PSNR": lambda r, c: decibels(
        squared(inner(r), inner(c))
    ),
    "RGB, squared errors summed over channels, mean of the frames' PSNR": lambda r, c: decibels(
        3 * squared(r, c)
    ),
    "RGB, both at half size, mean of the frames' PSNR": lambda r, c: decibels(
        squared(half(r), half(c))
    ),
    "grey of 8 bit, mean of the frames' PSNR": lambda r, c: decibels(
        squared(grey_of_8_bit(r), grey_of_8_bit(c))
    ),
    "RGB, range 2 of images in 0..1, mean of the frames' PSNR": lambda r, c: decibels(
        squared(r, c) / 4
    ),
    "RGB, range of the true frame, mean of the frames' PSNR": lambda r, c: decibels(
        squared(r, c) / (np.ptp(c) / 255) ** 2
    ),
    "RGB, PSNR of each channel, then the mean (3DGS's log)": lambda r, c: np.mean(
        [decibels(squared(r[..., n], c[..., n])) for n in range(3)]
    ),
    "RGB, 8-bit differences and squares that wrap around, mean of the frames' PSNR": lambda r, c: (
        decibels(((r - c) ** 2).mean())
    ),
    "RGB, 8-bit differences (truth minus rendered) that wrap around, mean of the frames' "
    "PSNR": lambda r, c: decibels(np.mean((c - r).astype(float) ** 2)),
    "RGB, mean of the frames' PSNR, 10 log10 of peak over RMSE (half of it)": lambda r, c: (
        10 * np.log10(255 / np.sqrt(squared(r, c)))
    ),
    "RGB, without a border of 4 px, mean of the frames' PSNR": lambda r, c: decibels(
        squared(r[4:-4, 4:-4], c[4:-4, 4:-4])
    ),
    "YUV 4:2:0 of 8 bit (BT.709, 16..235), (6 Y + U + V) / 8": lambda r, c: np.average(
        [decibels(squared(*planes)) for planes in zip(yuv_420(r), yuv_420(c), strict=True)],
        weights=(6, 1, 1),
    ),
}
PSNR = {
    name: lambda measure=measure: mean_over_frames(measure)
    for name, measure in PSNR_OF_FRAMES.items()
} | {
    "RGB, PSNR of the mean squared error": lambda: decibels(mean_over_frames(squared)),
    "RGB, PSNR of each view's mean squared error": lambda: np.mean(
        [decibels(squared(r, c)) for r, c in FRAMES]
    ),
    "RGB, truth of half size enlarged, PSNR of the mean squared error": lambda: decibels(
        mean_over_frames(lambda r, c: squared(r, enlarged(half(c))))
    ),
    "RGB, mean of the frames' PSNR, without the first frame": lambda: psnr_of_some(slice(1, None)),
    "RGB, mean of the frames' PSNR, the last 2 frames": lambda: psnr_of_some(slice(-2, None)),
    "RGB, mean of the frames' PSNR, every second frame": lambda: psnr_of_some(slice(None, None, 2)),
}


@pytest.mark.parametrize("name", PSNR)
def test_conventions_of_psnr(name):
    """PSNR of frames, of the mean error, of luma, of summed errors, at half size and without the
    border are told apart.
    """
    # Where libraries round halves and fixed-point weights is their own.
    names = explained("psnr", PSNR[name](), 2 if "grey" in name else 4 if "half" in name else 5)

    assert name in names
    # Of this photograph both matrices of YUV give the same within single precision.
    assert {other for other in names if "BT.601, 16" not in other} == {name}


def test_a_number_next_to_the_tools_own_is_rounding():
    """Floats before they were written differ by so little; that another convention is as near is
    chance, and said so.
    """
    own = mean_over_frames(PSNR_OF_FRAMES["RGB, mean of the frames' PSNR"])
    quoted = f"{own + 0.004:.4f}"
    told = " ".join(explanation_table("psnr", quoted, explain_again("psnr", quoted)).split())
    assert (
        f"PSNR {quoted} is this tool's {own:.6g} up to 0.004, which rounding to 8 bit explains"
        in told
    )


def test_colour_corrected_psnr_is_ours():
    """The colour-corrected convention equals the metric of that name."""
    from ggvs_eval.metrics.image.corrected import psnr_colour_corrected

    value = mean_over_frames(psnr_colour_corrected)
    assert explained("psnr", value, 3) == {
        "RGB after the best affine colour map, mean of the frames' PSNR"
    }


def ssim_map(x, y, blur, peak=1.0, factor=1.0) -> np.ndarray:
    """Wang's formula on images in 0..1 with any window."""
    mean_x, mean_y = blur(x), blur(y)
    covariance = factor * (blur(x * y) - mean_x * mean_y)
    variances = factor * (blur(x * x) - mean_x**2 + blur(y * y) - mean_y**2)
    a, b = (0.01 * peak) ** 2, (0.03 * peak) ** 2
    return (
        (2 * mean_x * mean_y + a)
        / (mean_x**2 + mean_y**2 + a)
        * (2 * covariance + b)
        / (variances + b)
    )


def gaussian(image, mode="reflect") -> np.ndarray:
    taps = np.exp(-0.5 * (np.arange(-5, 6) / 1.5) ** 2)
    for axis in (0, 1):
        image = ndimage.correlate1d(image, taps / taps.sum(), axis=axis, mode=mode)
    return image


def box(image) -> np.ndarray:
    return ndimage.uniform_filter(image, 7, axes=(0, 1))


def box_11(image) -> np.ndarray:
    return ndimage.uniform_filter(image, 11, axes=(0, 1))


def ssim_of(blur, margin, peak=1.0, factor=1.0, prepare=lambda image: image / 255):
    cut = slice(margin, -margin or None)
    return lambda: mean_over_frames(
        lambda r, c: ssim_map(prepare(r), prepare(c), blur, peak, factor)[cut, cut].mean()
    )


def kornia_ssim(rendered, truth, side=11) -> float:
    import torch
    from kornia.metrics import ssim

    first, second = (
        torch.from_numpy(image / 255).permute(2, 0, 1)[None] for image in (rendered, truth)
    )
    return float(ssim(first, second, window_size=side).mean())


def of_ffmpeg(name, key, rendered, truth, pixels="gbrp") -> float:
    """Value that a filter of FFmpeg gives one frame."""
    import av

    graph, frames = av.filter.Graph(), []
    for image in (rendered, truth):
        frames.append(av.VideoFrame.from_ndarray(image, format="rgb24").reformat(format=pixels))
        frames[-1].pts, frames[-1].time_base = 0, Fraction(1, 25)
    sources = [
        graph.add_buffer(width=SHAPE[1], height=SHAPE[0], format=pixels, time_base=Fraction(1, 25))
        for _ in frames
    ]
    compare, sink = graph.add(name), graph.add("buffersink")
    for place, source in enumerate(sources):
        source.link_to(compare, 0, place)
    compare.link_to(sink)
    graph.configure()
    for source, frame in zip(sources, frames, strict=True):
        source.push(frame)
        source.push(None)
    return float(sink.pull().metadata[f"lavfi.{name}.{key}"])


SAMPLE = 49 / 48
SSIM = {
    "Gaussian 11 x 11, valid positions, range 1": ssim_of(gaussian, 5),
    "Gaussian 11 x 11, valid positions, range 2": ssim_of(gaussian, 5, peak=2),
    "Gaussian 11 x 11, sample covariance, range 1": ssim_of(gaussian, 5, factor=121 / 120),
    "Gaussian 11 x 11, zero-padded, range 1 (3DGS)": ssim_of(
        lambda image: gaussian(image, "constant"), 0
    ),
    "Gaussian 11 x 11, reflect-padded, range 1 (kornia)": lambda: mean_over_frames(kornia_ssim),
    "Gaussian 3 x 3, reflect-padded, range 1 (kornia)": lambda: mean_over_frames(
        lambda r, c: kornia_ssim(r, c, 3)
    ),
    "blocks of 8 x 8 in whole numbers (ffmpeg), RGB": lambda: mean_over_frames(
        lambda r, c: of_ffmpeg("ssim", "All", r, c)
    ),
    "blocks of 8 x 8 in whole numbers (ffmpeg), yuv420p of FFmpeg (BT.601)": lambda: (
        mean_over_frames(lambda r, c: of_ffmpeg("ssim", "All", r, c, "yuv420p"))
    ),
    "Gaussian 11 x 11, valid positions, range 1, luma": ssim_of(
        gaussian, 5, prepare=lambda image: grey(image) / 255
    ),
    "uniform 7 x 7, range 1 (scikit-image on uint8)": ssim_of(box, 3, factor=SAMPLE),
    "uniform 7 x 7, range 2 (scikit-image on float, no range given; EasyVolcap)": ssim_of(
        box, 3, 2, SAMPLE
    ),
    "uniform 7 x 7, population covariance, range 1": ssim_of(box, 3),
    "uniform 7 x 7, range 1, luma": ssim_of(box, 3, 1, SAMPLE, lambda image: grey(image) / 255),
    "uniform 11 x 11, range 1 (scikit-image, win_size 11)": ssim_of(box_11, 5, factor=121 / 120),
    "uniform 11 x 11, population covariance, range 1": ssim_of(box_11, 5),
    "Gaussian 11 x 11, valid positions, range 1, both at half size": ssim_of(
        gaussian, 5, prepare=lambda image: half(image) / 255
    ),
    "uniform 7 x 7, range 1, both at half size": ssim_of(
        box, 3, 1, SAMPLE, lambda image: half(image) / 255
    ),
    "Gaussian 11 x 11, valid positions, range 1, grey of 8 bit": ssim_of(
        gaussian, 5, prepare=lambda image: grey_of_8_bit(image) / 255
    ),
    "uniform 7 x 7, range 1, without a border of 10 % (ENeRF, later code)": ssim_of(
        box, 3, 1, SAMPLE, lambda image: inner(image) / 255
    ),
    "uniform 7 x 7, range 2, without a border of 10 % (ENeRF as published)": ssim_of(
        box, 3, 2, SAMPLE, lambda image: inner(image) / 255
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SSIM)
def test_conventions_of_ssim(name):
    """Windows, borders, data ranges, covariances and luma are told apart."""
    names = explained("ssim", SSIM[name](), 5 if "8 bit" in name else 6)

    assert name in names
    # The photograph fills its range but for a few levels, which only the range of the true frame
    # can be confused with.
    assert {other for other in names if "true frame" not in other} == {name}


def test_enerfs_and_mvsnerfs_ssim_is_that_of_float_pictures_without_a_range():
    """Their evaluators hand float pictures to scikit-image, whose default range of these was 2; a
    tenth is cut, rounded down.
    """
    from skimage.metrics import structural_similarity

    rendered, truth = large_pair((187, 339))  # of which a tenth is 18.7 and 33.9
    large = [cv2.resize(image.astype(np.float64), (960, 640)) for image in (rendered, truth)]
    for frames, rows, columns, name in (
        (large, 64, 96, "MVSNeRF on LLFF"),
        ((rendered, truth), 18, 33, "ENeRF as published"),
    ):
        first, second = (image[rows:-rows, columns:-columns] / 255 for image in frames)
        known = structural_similarity(first, second, channel_axis=2, data_range=2.0)
        (found,) = [
            measure(rendered, truth)
            for key, measure in frame_measures().items()
            if f"({name})" in key
        ]
        assert found == pytest.approx(known, abs=1e-5)


@pytest.mark.slow
def test_ssim_after_box_averages_is_that_of_matlab_and_piq():
    """From 384 pixels on, frames are averaged over N x N pixels in floats first; smaller ones have
    no such convention.
    """
    import torch
    from skimage.metrics import structural_similarity

    rendered, truth = large_pair((400, 420))
    planes = [torch.from_numpy(image / 255).permute(2, 0, 1)[None] for image in (rendered, truth)]
    halves = [
        torch.nn.functional.avg_pool2d(each, 2)[0].permute(1, 2, 0).numpy() for each in planes
    ]
    settings = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False}
    value = structural_similarity(*halves, data_range=1, channel_axis=2, **settings)
    view = {"cam00": ViewFrames(lambda t: rendered, lambda t: truth, range(1))}
    (name,) = (one.name for one in explain("ssim", f"{value:.6f}", view) if one.matches)

    assert (
        name
        == "Gaussian 11 x 11, valid positions, range 1, after box averages (MATLAB's ssim.m, piq)"
    )
    assert not any(
        "box averages" in one.name for one in explain("ssim", "0.9", views_of(VIEWS[:1]))
    )


@pytest.mark.parametrize("where", ["picture", "folder", "frames", "box"])
def test_masks_are_read_from_pictures_folders_and_boxes(where, tmp_path):
    """One picture for all, one per view or per frame, and a box give the same mask; another size is
    refused.
    """
    view, mask = views_of(VIEWS[:1]), np.zeros((*SHAPE, 3), np.uint8)
    mask[20:50, 30:70] = 255
    for name in (
        "mask.png",
        "views/cam00.png",
        *(f"frames/cam00/{t:04d}.png" for t in range(N_FRAMES)),
    ):
        write_image(tmp_path / name, mask)
    place = {
        "picture": tmp_path / "mask.png",
        "folder": tmp_path / "views",
        "frames": tmp_path / "frames",
        "box": "30,20,70,50",
    }
    read = read_masks(str(place[where]), view, Measurement())["cam00"]

    assert all(np.array_equal(read(t), mask[..., 0] > 0) for t in range(N_FRAMES))
    write_image(tmp_path / "small.png", mask[:40])
    with pytest.raises(
        MetricError, match="wanted a mask of 96 x 72 with white where pixels count, got 96 x 40"
    ):
        read_masks(str(tmp_path / "small.png"), view, Measurement())


@pytest.mark.slow
@pytest.mark.parametrize(("divisor", "formula"), [(1, "1 - SSIM"), (2, "DSSIM = (1 - SSIM) / 2")])
def test_dissimilarity_is_recognised(divisor, formula):
    """What an SSIM with data range 2 lacks to 1, whole or half, is told from similarities."""
    value = (1 - ssim_of(box, 3, 2, SAMPLE)()) / divisor
    (name,) = explained("ssim", value, 6)

    assert name.startswith(f"{formula}, uniform 7 x 7, range 2")


def large_pair(shape=(187, 333)) -> tuple[np.ndarray, np.ndarray]:
    """A soft, noisy, reddish photograph and the photograph; sizes are odd at several scales."""
    truth = np.ascontiguousarray(data.astronaut()[60 : 60 + shape[0], 80 : 80 + shape[1]])
    soft = cv2.GaussianBlur(truth, (0, 0), 1.2) * (1.04, 1, 0.97)
    noise = np.random.default_rng(0).normal(0, 5, truth.shape)
    return round_levels(soft + noise), truth


def test_multi_scale_ssim_is_that_of_its_library():
    """MS-SSIM agrees with pytorch-msssim 1.0.0, ``ms_ssim(rendered, truth, data_range=1)`` in
    double precision.

    The library keeps its window in single precision.
    """
    rendered, truth = large_pair()
    view = {"cam00": ViewFrames(lambda t: rendered, lambda t: truth, range(1))}
    (name,) = (one.name for one in explain("ms-ssim", "0.96505", view) if one.matches)

    assert name == "MS-SSIM, five scales, Gaussian 11 x 11 (pytorch-msssim)"
    assert ms_ssim(rendered, truth) == pytest.approx(0.9650459094818808, abs=2e-6)
    assert ms_ssim(truth, truth) == 1


def test_multi_scale_ssim_of_torchmetrics_is_another_number():
    """MS-SSIM of TorchMetrics 1.9, ``data_range=1.0`` in double precision, as K-Planes and RF-DeRF
    compute it; said so.
    """
    rendered, truth = large_pair()
    view = {"cam00": ViewFrames(lambda t: rendered, lambda t: truth, range(1))}
    conventions = explain("ms-ssim", "0.96461", view)
    (name,) = (one.name for one in conventions if one.matches)

    assert (
        name == "MS-SSIM, five scales, Gaussian 11 x 11, coarsest border reflected (torchmetrics)"
    )
    assert "(K-Planes and RF-DeRF measure so)" in " ".join(
        explanation_table("ms-ssim", "0.96461", conventions).split()
    )


def absolute(rendered, truth) -> float:
    return float(np.abs(rendered.astype(float) - truth).mean())


L1 = {
    "mean over pixels and channels, 0..255": lambda: mean_over_frames(absolute),
    "mean over pixels and channels, 0..1": lambda: mean_over_frames(absolute) / 255,
    "sum over channels, mean over pixels, 0..255": lambda: 3 * mean_over_frames(absolute),
    "sum over channels, mean over pixels, 0..1": lambda: 3 * mean_over_frames(absolute) / 255,
    "grey of 8 bit, 0..1": lambda: (
        mean_over_frames(lambda r, c: absolute(grey_of_8_bit(r), grey_of_8_bit(c))) / 255
    ),
    "both at half size, 0..255": lambda: mean_over_frames(lambda r, c: absolute(half(r), half(c))),
    "mean of the frames' root mean squared error (RMSE), 0..255": lambda: mean_over_frames(
        lambda r, c: squared(r, c) ** 0.5
    ),
    "root of the mean squared error of all frames (RMSE), 0..1": lambda: (
        mean_over_frames(squared) ** 0.5 / 255
    ),
    "without a border of 10 %, 0..255": lambda: mean_over_frames(
        lambda r, c: absolute(inner(r), inner(c))
    ),
}


@pytest.mark.parametrize("name", L1)
def test_conventions_of_l1(name):
    """Units, channel sums, grey, half size, the border and the root mean squared error are told
    apart, under either name.
    """
    digits = 3 if "half" in name else 4 if "8 bit" in name else 6

    assert explained("l1", L1[name](), digits) == explained("rmse", L1[name](), digits) == {name}


def change_similarity(prepare, blur=gaussian, margin=5, peak=1.0, factor=1.0) -> float:
    """Mean SSIM of neighbouring frames' changes, pictures of change made by `prepare(first,
    second)` in 0..1.
    """
    cut = slice(margin, -margin or None)
    pairs = [
        (prepare(r[t], r[t + 1]), prepare(c[t], c[t + 1]))
        for r, c in FRAMES
        for t in range(N_FRAMES - 1)
    ]
    return float(np.mean([ssim_map(x, y, blur, peak, factor)[cut, cut].mean() for x, y in pairs]))


def change(first, second) -> np.ndarray:
    return np.abs(second.astype(float) - first) / 255


TCC = {
    "Gaussian 11 x 11, zero-padded, range 1": lambda: change_similarity(
        change, lambda i: gaussian(i, "constant"), 0
    ),
    "Gaussian 11 x 11, valid positions, range 2": lambda: change_similarity(change, peak=2),
    "uniform 7 x 7, range 1": lambda: change_similarity(change, box, 3, 1, SAMPLE),
    "uniform 7 x 7, range 2": lambda: change_similarity(change, box, 3, 2, SAMPLE),
    "mean of the channels' changes": lambda: change_similarity(
        lambda a, b: change(a, b).mean(axis=-1)
    ),
    "differences of 8 bit that wrap around": lambda: change_similarity(lambda a, b: (b - a) / 255),
}


@pytest.mark.parametrize("name", TCC)
def test_conventions_of_tcc(name):
    """SSIMs of changes, changes of grey, and wrapped differences are told apart."""
    assert explained("tcc", TCC[name]()) == {name}


def test_ties_are_all_listed():
    """Where no channel is below zero, cutting off there changes nothing, and both conventions are
    named.
    """
    value = float(np.mean([tcc(rendered, truth) for rendered, truth in FRAMES]))
    names = explained("tcc", value)

    assert names == {
        "Gaussian 11 x 11, valid positions, range 1, each channel cut off at 0",
        "Gaussian 11 x 11, valid positions, range 1, not cut off",
    }
    assert "2 conventions" in explanation_table(
        "tcc", f"{value:.5f}", explain("tcc", f"{value:.5f}", views_of())
    )


def sted_of(
    pairing="disjoint", weights=None, scale=1.0, pooled=lambda result: result.strred
) -> float:
    planes = [
        [
            [(luma(f) if weights is None else grey(f, weights)) * scale for f in side]
            for side in pair
        ]
        for pair in FRAMES
    ]
    return float(np.mean([pooled(strred(rendered, truth, pairing)) for rendered, truth in planes]))


STED = {
    "disjoint pairs, mean x mean, luma BT.601, 0..255": lambda: sted_of(),
    "consecutive pairs, mean x mean, luma BT.601, 0..255": lambda: sted_of("consecutive"),
    "consecutive pairs, mean of products, luma BT.601, 0..255": lambda: sted_of(
        "consecutive", pooled=lambda result: np.mean(result.pairs[:, 0] * result.pairs[:, 1])
    ),
    "disjoint pairs, single number (ssn), mean x mean, luma BT.601, 0..255": lambda: sted_of(
        pooled=lambda result: pool(result.pairs).strred_ssn
    ),
    "disjoint pairs, mean x mean, luma BT.709, 0..255": lambda: sted_of(
        weights=(0.2126, 0.7152, 0.0722)
    ),
    "disjoint pairs, mean x mean, luma BT.601, 0..1": lambda: sted_of(scale=1 / 255),
}


@pytest.mark.parametrize("name", STED)
def test_conventions_of_sted(name):
    """Pairing, pooling, output, luma and scale are told apart."""
    assert explained("sted", STED[name](), 7 if "0..1" in name else 4) == {name}


ERRORS = np.array([[absolute(r, c) for r, c in zip(*frames, strict=True)] for frames in FRAMES])
SPREADS = {
    ("sdt", "mean over the views of each one's spread over time, ddof 1, L1 in 0..255"): ERRORS.std(
        axis=1, ddof=1
    ).mean(),
    ("sdt", "mean over the views of each one's spread over time, ddof 0, L1 in 0..255"): ERRORS.std(
        axis=1
    ).mean(),
    ("sdt", "spread over time of the mean over the views, ddof 1, L1 in 0..255"): ERRORS.mean(
        axis=0
    ).std(ddof=1),
    ("sdt", "spread of all frames of all views together, ddof 0, L1 in 0..1"): ERRORS.std() / 255,
    ("sdv", "mean over time of the spread over the views, ddof 1, L1 in 0..255"): ERRORS.std(
        axis=0, ddof=1
    ).mean(),
    ("sdv", "mean over time of the spread over the views, ddof 0, L1 in 0..255"): ERRORS.std(
        axis=0
    ).mean(),
    ("sdv", "spread over the views of the mean over time, ddof 1, L1 in 0..255"): ERRORS.mean(
        axis=1
    ).std(ddof=1),
}


@pytest.mark.parametrize(("metric", "name"), SPREADS)
def test_conventions_of_the_spreads(metric, name):
    """Divisor, order of mean and spread, and unit of SDT and SDV are told apart."""
    assert explained(metric, float(SPREADS[metric, name]), 7) == {name}


@pytest.mark.slow
@pytest.mark.skipif(
    not all(weights_path(net).is_file() for net in NETS), reason="no LPIPS weights here"
)
def test_conventions_of_lpips():
    """Networks and input ranges are told apart; feeding [0, 1] equals halving the contrast about
    mid-grey in [-1, 1].
    """
    from ggvs_eval.metrics.image.lpips import lpips

    rendered, truth = (frames[0] for frames in FRAMES[0])
    view = {"cam00": ViewFrames(lambda t: rendered, lambda t: truth, range(1))}
    unscaled = [(image.astype(np.float32) + 255) / 510 for image in (rendered, truth)]
    values = {
        "VGG, inputs in [-1, 1]": lpips(rendered, truth, "vgg"),
        "AlexNet, inputs in [0, 1]": lpips(*unscaled, "alex"),
    }

    for name, value in values.items():
        assert [one.name for one in explain("lpips", f"{value:.5f}", view) if one.matches] == [name]


def test_a_value_of_one_view_names_the_view():
    """A quoted value that one view alone gives is explained by that view."""
    value = np.mean([decibels(squared(r, c)) for r, c in zip(*FRAMES[1], strict=True)])
    matching = [one for one in explain("PSNR", f"{value:.4f}", views_of()) if one.matches]
    # whose range is all of 0..255 here
    (found,) = (one for one in matching if "true frame" not in one.name)

    assert (found.views, found.name, found.is_ours) == (
        "cam01",
        "RGB, mean of the frames' PSNR",
        True,
    )


def test_a_wrong_value_is_explained_by_nothing():
    """A value that no convention gives is none of ours; how many were tried, and how near a match
    has to be, is told.
    """
    value = PSNR["RGB, mean of the frames' PSNR"]() + 7.77
    tried = explain("psnr", f"{value:.3f}", views_of())
    everywhere = sum(one.views == ALL_VIEWS for one in tried)
    text = explanation_table("psnr", f"{value:.3f}", tried)
    sentence = " ".join(text.partition("\n\n")[0].split())

    assert not any(one.matches for one in tried)
    assert sentence.startswith(
        f"no known convention gives PSNR {value:.3f}: {everywhere} conventions over all views, and "
        f"{len(tried)}"
    )
    assert sentence.endswith("each is off by more than 0.00067")
    rows = [line for line in text.splitlines()[4:] if ALL_VIEWS in line.partition("tried;")[0]]
    assert len(rows) in (5, 6)  # ours as well
    assert text.endswith(f"\n\n{everywhere} conventions tried; --all shows them")
    assert (
        explanation_table("psnr", f"{value:.3f}", tried, shows_all=True).count(ALL_VIEWS)
        >= everywhere
    )
    assert max(map(len, text.splitlines())) <= 130


@pytest.mark.slow
def test_the_chance_of_a_match_is_the_share_of_random_numbers_that_match():
    """Of numbers drawn near the quoted one as many match something as is told; digits make a match
    rare.
    """
    values = [one.value for one in explain("psnr", "30", views_of())]
    rng, quoted = np.random.default_rng(0), f"{values[0]:.2f}"
    drawn = float(quoted) * rng.uniform(0.95, 1.05, 4000)
    meeting = np.mean(
        [any(abs(value - one) <= tolerance(quoted, value) for value in values) for one in drawn]
    )

    assert chance(quoted, values) == pytest.approx(meeting, abs=0.03)
    assert chance(f"{values[0]:.1f}", values) > 2 * chance(quoted, values)
    assert chance(f"{values[0]:.5f}", values) < 0.01


def test_a_match_that_chance_would_give_as_well_is_none():
    """One digit is met by many conventions, and said to be no evidence; ours is still
    called ours.
    """
    ours = [Convention("first way", ALL_VIEWS, 30.0, True, True)]
    others = [Convention(f"way {i}", ALL_VIEWS, 28.52 + 0.1 * i, i == 14, False) for i in range(30)]
    row = [Convention("first way", ALL_VIEWS, 35.0, False, True), *others]

    assert explanation_table("psnr", "29.9", row).startswith(
        "only chance matches for PSNR 29.9: way 14"
    )
    assert explanation_table("psnr", "30.0", [*ours, *others[:14], *others[15:]]).startswith(
        "PSNR 30.0 is first way, the convention of this tool"
    )


OURS = {
    "ssim": "Gaussian 11 x 11",
    "dssim": "DSSIM = (1 - SSIM) / 2",
    "l1": "mean over pixels and channels",
    "rmse": None,
}


@pytest.mark.slow
@pytest.mark.parametrize("metric", OURS)
def test_only_the_convention_of_the_metric_in_question_is_ours(metric):
    """A dissimilarity is not this tool's SSIM, nor the reverse; of a metric that it lacks none is
    its own.
    """
    marked = {one.name.partition(",")[0] for one in explain_again(metric, "0.9") if one.is_ours}

    assert marked == {OURS[metric]} - {None}


@pytest.mark.slow
def test_masked_conventions():
    """With masks, PSNR inside the mask is told from frames that are black outside of it, which
    inflates.
    """
    rendered, truth = FRAMES[0]
    mask = np.zeros(SHAPE, bool)
    mask[20:50, 30:70] = True
    masks = {"cam00": lambda index: mask}
    inside = np.mean(
        [decibels(squared(r[mask], c[mask])) for r, c in zip(rendered, truth, strict=True)]
    )
    black = np.mean(
        [
            decibels(squared(r * mask[..., None], c * mask[..., None]))
            for r, c in zip(rendered, truth, strict=True)
        ]
    )

    def names(value: float) -> list[str]:
        return [
            one.name
            for one in explain("psnr", f"{value:.4f}", views_of(VIEWS[:1]), masks)
            if one.matches
        ]

    assert names(inside) == ["pixels inside the mask, mean of the frames' PSNR"]
    assert names(black) == ["frames black outside the mask, mean of the frames' PSNR"]
    scores = [
        ssim_map(r / 255, c / 255, gaussian)[mask].mean()
        for r, c in zip(rendered, truth, strict=True)
    ]
    found = explain("ssim", f"{np.mean(scores):.6f}", views_of(VIEWS[:1]), masks)
    assert [one.name for one in found if one.matches] == [
        "Gaussian 11 x 11, valid positions, range 1, windows inside the mask",
        # the mask is far from the border
        "Gaussian 11 x 11, zero-padded, range 1 (3DGS), windows inside the mask",
    ]
    assert {"black", "white", "rectangle"} <= {word for one in found for word in one.name.split()}


@pytest.mark.parametrize(
    ("quoted", "value", "tolerance"),
    [
        ("31.170", 31.17, 5e-4),
        ("0.94", 0.94, 5e-3),
        ("27", 27, 0.5),
        ("1.2e-3", 1.2e-3, 5e-5),
        ("31,52 dB", 31.52, 5e-3),
        ("93.6%", 0.936, 5e-4),
    ],
)
def test_printed_digits_set_the_tolerance(quoted, value, tolerance):
    """Half of the last printed digit is the tolerance; trailing zeros count."""
    assert printed(quoted) == (pytest.approx(value), pytest.approx(tolerance, rel=1e-5))


@pytest.mark.parametrize(
    ("metric", "quoted", "names", "message"),
    [
        ("niqe", "3.1", VIEWS, "wanted a metric with known conventions, got 'niqe'"),
        ("psnr", "high", VIEWS, "wanted a number"),
        ("psnr", "inf", VIEWS, "wanted a finite number"),
        ("psnr", "1e-999", VIEWS, "wanted a finite number"),
        ("psnr", "1,234.5", VIEWS, "wanted a number"),
        ("psnr", "30", (), "wanted at least one view"),
        ("sdv", "0.1", VIEWS[:1], "needs 2"),
    ],
)
def test_what_cannot_be_explained_is_refused(metric, quoted, names, message):
    """Unknown metrics, words for numbers, no views, and spreads of one are refused in one line."""
    with pytest.raises(MetricError, match=message):
        explain(metric, quoted, views_of(names))


def test_the_table_marks_matches_and_ours():
    """The matching convention stands first with a sign, and ours is marked wherever it stands."""
    conventions = [
        Convention("first way", ALL_VIEWS, 1.0, False, True),
        Convention("second way", ALL_VIEWS, 2.0, True, False),
        Convention("second way", "cam00", 3.0, False, False),
    ]
    text = explanation_table("psnr", "2.000", conventions)
    body = text.splitlines()[4:]

    assert text.startswith("PSNR 2.000 is second way")
    assert [("=" in line, "this tool" in line) for line in body] == [(True, False), (False, True)]
