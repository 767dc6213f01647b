"""What enlarges small maps, in a page of numpy and OpenCV."""

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map


def recur_twin(now: Map, past: Map, cells: Map) -> Map:
    """What the kernel `recur` computes: the weight of the past and the light, enlarged, mix two
    pictures.
    """
    size = now.shape[1::-1]
    weight, *light = (cv2.resize(each, size, interpolation=cv2.INTER_LINEAR) for each in cells)
    return np.asarray(now + weight[..., None] * (past - now) - np.stack(light, axis=-1), np.float32)


def nearest_two(size: int, small_size: int) -> tuple[Map, Map]:
    """The nearest small pixel of each pixel along an axis, and the next one, (size,) each."""
    place = (np.arange(size) + 0.5) * (small_size / size) - 0.5
    nearest = np.rint(place).astype(np.int32)
    beside = nearest + np.where(place < nearest, -1, 1)
    return np.clip(nearest, 0, small_size - 1), np.clip(beside, 0, small_size - 1)


def alike_twin(values: Map, small_image: Image8, image: Image8) -> Map:
    """The value of that of the four nearest small pixels whose colour is most like a pixel's own,
    as `enlarge` chooses it.
    """
    rows, columns = (
        nearest_two(*sizes) for sizes in zip(image.shape[:2], small_image.shape[:2], strict=True)
    )
    chosen, best = np.zeros(image.shape[:2], np.float32), np.full(image.shape[:2], 256, np.int16)
    for row, column in np.ndindex(2, 2):
        cells = np.ix_(rows[row], columns[column])
        difference = cv2.cvtColor(cv2.absdiff(image, small_image[cells]), cv2.COLOR_RGB2GRAY)
        closer = difference < best
        chosen, best = np.where(closer, values[cells], chosen), np.where(closer, difference, best)
    return chosen
