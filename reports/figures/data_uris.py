"""Pictures as text that a page carries."""

import base64

import cv2

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import resize

WEBP_QUALITY = 70
MAP_QUALITY = 50  # of colour scales over a picture, such as errors
LOSSLESS = 101  # OpenCV's word for WebP without loss


def webp_bytes(image: Image8, quality: int = WEBP_QUALITY) -> bytes:
    """Compress an RGB image for looking at, not for measuring."""
    _, encoded = cv2.imencode(
        ".webp", cv2.cvtColor(image, cv2.COLOR_RGB2BGR), [cv2.IMWRITE_WEBP_QUALITY, quality]
    )
    return encoded.tobytes()


def webp_uri(image: Image8, quality: int = WEBP_QUALITY) -> str:
    """Return an RGB image as the address of a WebP picture."""
    return "data:image/webp;base64," + base64.b64encode(webp_bytes(image, quality)).decode("ascii")


def shrink(image: Image8, width: int) -> Image8:
    """Reduce an image to a width by box averaging; smaller ones stay as they are."""
    if image.shape[1] <= width:
        return image
    height = max(1, round(image.shape[0] * width / image.shape[1]))
    return resize(image, width, height, "area")
