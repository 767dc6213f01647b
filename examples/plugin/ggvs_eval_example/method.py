"""A method: the picture of the nearest source camera, as it is."""

import cv2
import numpy as np

from ggvs_eval.method import Rendering


class NearestView:
    """Source view of the camera nearest to the target."""

    def step(self, instant):
        """Synthesise one instant; neither the future nor the target's own image is there."""
        target = instant.target
        distances = [
            np.linalg.norm(source.camera.centre - target.centre) for source in instant.sources
        ]
        nearest = instant.sources[int(np.argmin(distances))]
        image = cv2.resize(nearest.image, target.size, interpolation=cv2.INTER_AREA)
        return Rendering(image.astype(np.float32) / 255)  # (H, W, 3), RGB in [0, 1]
