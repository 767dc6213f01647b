"""What evaluators make of frames before they measure them: colours, sizes, borders, masks,
video.
"""

from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.explain.conventions import Levels, Preparation
from ggvs_eval.files.images import resize, round_levels
from ggvs_eval.measured_frames import MVSNERF, cut_border

Planes = NDArray[np.float64]
BT601 = np.array([0.299, 0.587, 0.114])
BT709 = np.array([0.2126, 0.7152, 0.0722])


def both(change: Callable[..., Levels]) -> Preparation:
    """Change the rendered and the true frame alike."""
    return lambda rendered, truth, *mask: (change(rendered, *mask), change(truth, *mask))


def luma(image: Image8) -> Planes:
    """Luma in 0..255, (H, W)."""
    return image @ BT601


def video_luma(image: Image8) -> Planes:
    """Luma in 16..235, as super-resolution measures it."""
    return 16 + image @ BT601 * 219 / 255


def grey(image: Image8) -> Image8:
    """Luma rounded to 8 bit, (H, W), as OpenCV and Pillow convert."""
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_RGB2GRAY), dtype=np.uint8)


def without_border(image: Image8, border_px: int = 0, share: float = 0.0) -> Image8:
    """Return a frame without some pixels, or a share of its size rounded down, at every side."""
    rows, columns = (int(share * size) or border_px for size in image.shape[:2])
    if 2 * max(rows, columns) >= min(image.shape[:2]):
        return image
    return image[rows : image.shape[0] - rows, columns : image.shape[1] - columns]


def half(image: Image8) -> Image8:
    """Return a frame at half its size, box averages of 8 bit."""
    return resize(image, image.shape[1] // 2, image.shape[0] // 2, "area")


def as_mvsnerf(image: Image8) -> Levels:
    """Return a frame as MVSNeRF's notebook measures LLFF, in levels of 255: at 960 x 640, without a
    border.
    """
    return 255 * MVSNERF.prepare(image)


def at_llff_size(image: Image8) -> Levels:
    """Return a frame at the size at which MVSNeRF evaluates LLFF, resized as its notebook does, in
    levels of 255.
    """
    return 255 * replace(MVSNERF, is_cut=False).prepare(image)


def half_truth(rendered: Image8, truth: Image8) -> tuple[Image8, Image8]:
    """Return the frame as rendered, and a truth that was kept at half size and enlarged again,
    linearly.
    """
    size = truth.shape[1], truth.shape[0]
    # OpenCV does not round what it interpolates in 8 bit.
    enlarged = cv2.resize(half(truth).astype(np.float32), size, interpolation=cv2.INTER_LINEAR)
    return rendered, round_levels(enlarged)


def stretched(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the levels whose range of 255 is that of the true frame's, as torchmetrics takes it
    without a range.
    """
    factor = 255 / max(int(truth.max()) - int(truth.min()), 1)
    return np.multiply(rendered, factor, dtype=np.float64), np.multiply(
        truth, factor, dtype=np.float64
    )


def colour_corrected(rendered: Image8, truth: Image8) -> tuple[Planes, Planes]:
    """Return the rendering after the affine colour map of this frame that fits best, clipped."""
    design = np.concatenate(
        [rendered.reshape(-1, 3), np.full((truth.size // 3, 1), 255)], axis=1
    ).astype(np.float64)
    target = truth.reshape(-1, 3).astype(np.float64)
    fitted, *_ = np.linalg.lstsq(design.T @ design, design.T @ target, rcond=1e-12)
    return np.clip(design @ fitted, 0, 255), target


GREY: Mapping[str, Preparation] = {"grey of 8 bit": both(grey)}
CROPPED = both(cut_border)  # a tenth at every side, rounded down as ENeRF and MVSNeRF do
HALVED = both(half)
MVSNERF_ON_LLFF = both(as_mvsnerf)
# Frames of another size or part, which PSNR, SSIM and L1 are taken of as well.
FRAMINGS: Mapping[str, Preparation] = {
    "both at half size": HALVED,
    "truth of half size enlarged": half_truth,
    "both at 960 x 640": both(at_llff_size),
    "without a border of 5 %": both(partial(without_border, share=0.05)),
    **{
        f"without a border of {n} px": both(partial(without_border, border_px=n))
        for n in (4, 8, 16)
    },
}


def ycbcr(image: Image8, matrix: NDArray[np.float64], has_headroom: bool = True) -> Planes:
    """YCbCr of a frame in levels that are not rounded, (H, W, 3).

    Luma in 16..235 with headroom, else 0..255.
    """
    y = image @ matrix
    scale, offset, chroma = (219 / 255, 16, 224 / 255) if has_headroom else (1.0, 0, 1.0)
    blue, red = (128 + chroma * (image[..., c] - y) / (2 * (1 - matrix[c])) for c in (2, 0))
    return np.stack([offset + scale * y, blue, red], axis=-1)


def _video_420(image: Image8, matrix: NDArray[np.float64], has_headroom: bool) -> list[Planes]:
    """Planes of 8-bit 4:2:0: chroma averaged over 2 x 2 of its rounded values."""
    y, *chroma = np.moveaxis(np.rint(ycbcr(image, matrix, has_headroom)).clip(0, 255), -1, 0)
    return [
        y,
        *(
            np.rint(cv2.resize(c, (c.shape[1] // 2, c.shape[0] // 2), interpolation=cv2.INTER_AREA))
            for c in chroma
        ),
    ]


def _swscale_420(image: Image8) -> list[Planes]:
    """Planes of yuv420p as FFmpeg converts pictures to it by default: BT.601, 16..235, bicubic
    chroma.
    """
    from av import VideoFrame

    even = np.ascontiguousarray(image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2])
    height, width = even.shape[:2]
    samples = (
        VideoFrame.from_ndarray(even, format="rgb24")
        .reformat(format="yuv420p")
        .to_ndarray()
        .astype(np.float64)
    )
    return [samples[:height], *samples[height:].reshape(2, height // 2, width // 2)]


# Y, U and V of 8-bit video of 4:2:0.
VIDEO_FORMS: Mapping[str, Callable[[Image8], list[Planes]]] = {
    **{
        f"YUV 4:2:0 of 8 bit ({name}, {levels})": partial(
            _video_420, matrix=matrix, has_headroom=headroom
        )
        for name, matrix in (("BT.709", BT709), ("BT.601", BT601))
        for levels, headroom in (("16..235", True), ("0..255", False))
    },
    "yuv420p of FFmpeg (BT.601)": _swscale_420,
}


def _filled(image: Image8, mask: NDArray[np.bool_], level: int) -> Image8:
    return np.where(mask[..., None], image, np.uint8(level))


def _rectangle(image: Image8, mask: NDArray[np.bool_]) -> Image8:
    """Return the part of a frame around the white of its mask; the frame if there is none."""
    x, y, width, height = cv2.boundingRect(mask.astype(np.uint8))
    return image[y : y + height, x : x + width] if width else image


MASKINGS: Mapping[str, Preparation] = {
    "frames black outside the mask": both(partial(_filled, level=0)),
    "frames white outside the mask": both(partial(_filled, level=255)),
    "the rectangle around the mask": both(_rectangle),
}


def inside(rendered: Image8, truth: Image8, mask: NDArray[np.bool_]) -> tuple[Levels, Levels]:
    """Return the pixels inside a mask, (N, 3); equal ones if there are none."""
    return (rendered[mask], truth[mask]) if mask.any() else (truth, truth)
