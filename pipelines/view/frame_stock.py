"""Frames and depth of a rig at the sizes at which a live view reads them, kept in memory up to a limit."""

from functools import lru_cache

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.depth.rig_depth import DeviceDepth, RigDepth
from ggvs_eval.pipelines.play.playback import Playback

MEMORY_BYTES = 1 << 30
BYTES_PER_PIXEL = 3 + 4 + 4  # colour, depth, confidence


class FrameStock:
    """Cache of what the cameras of a playback see, at most at so many pixels; least recently used frames are dropped first.

    Where depth is live it is found at that size, when it is asked for.

    Args:
        pixels: per image, at most; images are made smaller, never larger.

    Attributes:
        cameras: the rig at that size.
        live: see `Playback.live`.
    """

    def __init__(self, playback: Playback, pixels: int, memory: int = MEMORY_BYTES) -> None:
        self._playback = playback
        self.cameras = tuple(fitted(camera, pixels) for camera in playback.capture.cameras)
        self._sizes = {camera.name: camera.size for camera in self.cameras}
        largest = max(width * height for width, height in self._sizes.values())
        count = max(memory // (largest * BYTES_PER_PIXEL), len(self.cameras))
        self.image, self.read = lru_cache(count)(self._image), lru_cache(count)(self._read)
        self.live = playback.live
        self._finder = None if playback.live is None else RigDepth(self.cameras, playback.live)

    def _image(self, name: str, instant: int) -> Image8:
        """The frame of one camera at one instant, (H, W, 3)."""
        image, size = self._playback.capture.frame(name, instant), self._sizes[name]
        return image if size == image.shape[1::-1] else cv2.resize(image, size, interpolation=cv2.INTER_AREA).astype(np.uint8)

    def _read(self, name: str, instant: int) -> tuple[Image8, DepthMap]:
        """The frame and the depth of one camera at one instant, (H, W, 3) and (H, W)."""
        image, size = self.image(name, instant), self._sizes[name]
        if self._finder is not None:
            images = {each: self.image(each, instant) for each in self._finder.needed([name])}
            found = self._finder.estimate([name], images)[name]
            return image, found.download() if isinstance(found, DeviceDepth) else found
        depth_map = self._playback.store.read(self._playback.depth_keys[name], instant)
        if size == depth_map.depth.shape[1::-1]:
            return image, depth_map
        # Depths of two surfaces must not be mixed: a mean would lie on neither.
        depth, confidence = (
            cv2.resize(each, size, interpolation=cv2.INTER_NEAREST_EXACT) for each in (depth_map.depth, depth_map.confidence)
        )
        return image, DepthMap(depth, confidence)


def fitted(camera: Camera, pixels: int) -> Camera:
    """The camera at its own size, or at the largest one of its shape with no more than so many pixels.

    Examples:
        >>> import numpy as np
        >>> camera = Camera("cam00", np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]), np.eye(4), 8, 6, near=1.0, far=9.0)
        >>> fitted(camera, 12).size, fitted(camera, 100).size
        ((4, 3), (8, 6))
    """
    share = min((pixels / (camera.width * camera.height)) ** 0.5, 1.0)
    return camera.resized(max(int(camera.width * share), 1), max(int(camera.height * share), 1))
