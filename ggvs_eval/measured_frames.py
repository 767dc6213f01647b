"""Frames as they are measured: as they are, resized, or prepared as another evaluator does."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.files.images import resize
from ggvs_eval.metric_choices import SsimName
from ggvs_eval.protocol import Measurement, WayName

BORDER = 10  # 1 / BORDER of the size is cut off at each side, rounded down


@dataclass(frozen=True)
class MeasuringWay:
    """Frame preparation of an evaluator of published values.

    Attributes:
        size: width and height to which both frames are resized bilinearly, in floats that stay
            unrounded; None keeps theirs.
        is_cut: whether a tenth of the size is cut off at every side, rounded down.
        ssim: the variant of SSIM that it computes.
        describe: what it does, for captions.
    """

    size: tuple[int, int] | None
    is_cut: bool
    ssim: SsimName
    describe: str

    def prepare(self, image: Image8) -> NDArray[Any]:
        """Prepare a frame, (H, W, 3) uint8; the result is float64 in [0, 1] if it is resized."""
        frame: NDArray[Any] = image
        if self.size:
            frame = cv2.resize(
                image.astype(np.float64) / 255, self.size, interpolation=cv2.INTER_LINEAR
            )
        return cut_border(frame) if self.is_cut else frame


# Reading: both hand float frames to scikit-image without a range, whose default for these was 2 up
# to version 0.19.
MVSNERF = MeasuringWay(
    size=(960, 640),
    is_cut=True,
    ssim="uniform7-range2",
    describe="as MVSNeRF's notebook: both frames resized to 960 x 640, a tenth cut off at every "
    "side, SSIM of range 2",
)
WAYS: Mapping[WayName, MeasuringWay | None] = {
    "as-is": None,
    "mvsnerf": MVSNERF,
    "enerf": MeasuringWay(
        size=None,
        is_cut=True,
        ssim="uniform7-range2",
        describe="as ENeRF's evaluator: a tenth cut off at every side, SSIM of range 2",
    ),
}


def measuring_way(measurement: Measurement) -> MeasuringWay | None:
    """Return the way of measuring that a protocol asks for.

    None where frames are measured as they are.
    """
    return WAYS[measurement.as_]


def measured_frame(image: Image8, measurement: Measurement) -> NDArray[Any]:
    """Return a frame as it is measured.

    Returns:
        (H, W, 3), uint8; float64 in [0, 1] where another evaluator's way resizes it.
    """
    image, way = resized_frame(image, measurement), measuring_way(measurement)
    return image if way is None else way.prepare(image)


def resized_frame(image: Image8, measurement: Measurement) -> Image8:
    """Return a frame at the size that a protocol states, in 8 bit."""
    if not measurement.width:
        return image
    return resize(image, measurement.width, measurement.height, measurement.resize_filter)


def measured_mask(mask: Image8, measurement: Measurement) -> Mask:
    """Return a mask, white where it counts, at the size and in the part in which frames are
    measured.
    """
    way = measuring_way(measurement)
    for size in ((measurement.width, measurement.height), way.size if way else None):
        if size and size[0]:
            mask = np.asarray(cv2.resize(mask, size, interpolation=cv2.INTER_NEAREST))
    return (cut_border(mask) if way and way.is_cut else mask) > 127


def cut_border(frame: NDArray[Any]) -> NDArray[Any]:
    """Return a frame without a tenth of its size at every side, rounded down."""
    rows, columns = frame.shape[0] // BORDER, frame.shape[1] // BORDER
    return frame[rows : frame.shape[0] - rows, columns : frame.shape[1] - columns]
