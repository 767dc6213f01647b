"""Photometric fit of a surface to the images around it: a step that improves it, and how many partners confirm it."""

from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.pipelines.offline.plane_sweep.views import PartnerView, Projection, find_hidden

CONFIRMING = 0.3  # a partner takes part where its correlation is at least this
FLAT = np.float32(0.1)  # confidence without texture, a third of what counts as sure
MOST_STEP = 0.7  # planes
DAMPING = 4.0  # (grey values / pixel)^2; holds the surface where the images have no gradient along the parallax


class SurfaceFit:
    """A surface held against a reference image and the partners' images.

    Args:
        grey: the reference's grey image, (H, W).
        hidden_px: see `find_hidden`.
    """

    def __init__(
        self,
        grey: Map,
        views: Sequence[PartnerView],
        turned: Sequence[Map],
        n_partners: int,
        *,
        noise: float,
        window_px: int,
        hidden_px: float,
    ) -> None:
        self.grey, self.views, self.turned, self.n_partners = grey, tuple(views), tuple(turned), n_partners
        self.noise, self.window_px, self.hidden_px = np.float32(noise), window_px, hidden_px
        self._mean = self._blur(grey)
        self._variance = self._blur(grey * grey) - self._mean**2

    def refine(self, inverse_depth: Map, step: float) -> Map:
        """One Gauss-Newton step towards the smallest difference of the windows, gains and offsets aside.

        Args:
            inverse_depth: the surface, (H, W), 1 / world units.
            step: from plane to plane; the surface moves by less than one.
        """
        slope, curvature = np.zeros_like(inverse_depth), np.zeros_like(inverse_depth)
        for view, image in zip(self.views, self.turned, strict=True):
            places = view.project(inverse_depth)
            samples = self._look_up(image, places)
            score, gain = self._correlate(samples)
            weight = self._weight(view, inverse_depth, places, score)
            change = self._look_up(cv2.Sobel(image, cv2.CV_32F, 1, 0, scale=1 / 8), places) * places.column_slope
            change += self._look_up(cv2.Sobel(image, cv2.CV_32F, 0, 1, scale=1 / 8), places) * places.row_slope
            moved = gain * (self._covariance(self.grey, change) - gain * self._covariance(samples, change))
            speed = places.column_slope**2 + places.row_slope**2
            slope += weight * moved
            curvature += weight * (gain**2 * self._covariance(change, change) + np.float32(DAMPING) * speed)
        update = np.divide(slope, curvature, out=np.zeros_like(slope), where=curvature > 0)
        return inverse_depth + np.clip(update, -MOST_STEP * step, MOST_STEP * step).astype(np.float32)

    def confidence(self, inverse_depth: Map) -> Map:
        """Measure how far all partners confirm the surface, (H, W) in [0, 1]; those that do not see it count 0.

        A partner that sees it confirms it by the correlation of its window, and a little without any: where there is no texture
        the surface comes from its surroundings, and is better than what would be guessed in its place.
        """
        total = np.zeros_like(inverse_depth)
        for view, image in zip(self.views, self.turned, strict=True):
            places = view.project(inverse_depth)
            score, _ = self._correlate(self._look_up(image, places))
            visibility = self._sees(view, inverse_depth, places)
            total += np.where(visibility, FLAT + (1 - FLAT) * _confirmation(score), np.float32(0))
        return total / np.float32(self.n_partners)

    def _weight(self, view: PartnerView, inverse_depth: Map, places: Projection, score: Map) -> Map:
        """The partner's correlation where it confirms the surface, else 0."""
        return np.where(self._sees(view, inverse_depth, places), _confirmation(score), np.float32(0))

    def _sees(self, view: PartnerView, inverse_depth: Map, places: Projection) -> NDArray[np.bool_]:
        return view.sees(places) & ~find_hidden(view, inverse_depth, self.hidden_px)

    def _correlate(self, samples: Map) -> tuple[Map, Map]:
        """Normalised cross-correlation with the reference, and the gain that takes `samples` to it; (H, W) each."""
        mean = self._blur(samples)
        variance = np.maximum(self._blur(samples * samples) - mean * mean, 0) + self.noise
        covariance = self._blur(samples * self.grey) - mean * self._mean
        score = covariance / np.sqrt(variance * (np.maximum(self._variance, 0) + self.noise))
        return score, np.clip(covariance / variance, 0.5, 2)

    def _covariance(self, first: Map, second: Map) -> Map:
        return self._blur(first * second) - self._blur(first) * self._blur(second)

    def _look_up(self, image: Map, places: Projection) -> Map:
        return cv2.remap(image, places.column, places.row, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)

    def _blur(self, values: Map) -> Map:
        return cv2.blur(values, (self.window_px, self.window_px), borderType=cv2.BORDER_REFLECT)


def _confirmation(score: Map) -> Map:
    """A correlation where it is high enough to confirm anything, else 0."""
    return np.where(score > CONFIRMING, np.minimum(score, np.float32(1)), np.float32(0))
