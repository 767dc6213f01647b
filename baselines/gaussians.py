"""Source views as pixel-sized Gaussians, the common ground of every method that splats."""

from ggvs_eval.arrays import Map
from ggvs_eval.geometry.splat import PixelGaussians
from ggvs_eval.method import Instant, SourceView

NEAR_M = 0.2  # Gaussians closer than this to the target camera are culled, as the reference rasteriser does


def pixel_gaussians(source: SourceView, extra: Map | None = None) -> PixelGaussians:
    """One Gaussian per source pixel with known depth; its features are the colour and, if given, one more channel.

    Args:
        source: the view, image (H, W, 3) uint8.
        extra: another value per pixel, (H, W), float32.
    """
    return PixelGaussians(camera=source.camera, depth=source.depth, features=source.image, extra=extra)


def near_plane(instant: Instant) -> float:
    """Near plane in world units."""
    return NEAR_M * instant.units_per_metre
