"""The photometric loss of fits: 0.8 L1 + 0.2 (1 - SSIM), its gradient in closed form on a CPU."""

from typing import Any

import cv2
import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

STRUCTURE = 0.2  # its share in the loss
WINDOW, SIGMA_PX = 11, 1.5
MARGIN = WINDOW // 2
C1, C2 = 0.01**2, 0.03**2


def photometric_loss(image: Tensor, truth: Tensor, share: float = STRUCTURE) -> Tensor:
    """The mean absolute difference, mixed with 1 - SSIM.

    Args:
        image: rendered, (H, W, 3), at least 11 x 11.
        truth: captured, same shape, in [0, 1].
        share: of 1 - SSIM.

    Reading:
        SSIM is that of the metric (11 x 11 Gaussian window, whole windows only), where the published codes pad with zeros.
    """
    difference = (image - truth).abs().mean()
    if not share:
        return difference
    if image.device.type == "cpu":
        structure = 1 - _MeanSsim.apply(image, truth)
    else:
        structure = structural_loss(image.permute(2, 0, 1)[None], truth.permute(2, 0, 1)[None])
    return (1 - share) * difference + share * structure


def structural_loss(image: Tensor, truth: Tensor) -> Tensor:
    """1 - SSIM, with the window and constants of the metric `ggvs_eval.metrics.image.ssim`.

    Args:
        image: (B, 3, H, W), at least 11 x 11.
    """
    from kornia.metrics import ssim

    return 1 - ssim(image, truth, window_size=11, max_val=1.0, eps=0.0, padding="valid").mean()


class _MeanSsim(torch.autograd.Function):
    """Mean SSIM of two images with its derivative by the first: five times as fast as through torch's convolutions.

    With x, y the images, G the window's blur and mx = G x, my = G y, exx = G x^2, eyy = G y^2, exy = G xy:
    S = (2 mx my + C1) (2 (exy - mx my) + C2) / ((mx^2 + my^2 + C1) (exx - mx^2 + eyy - my^2 + C2)).
    """

    @staticmethod
    def forward(ctx: Any, image: Tensor, truth: Tensor) -> Tensor:
        """Return the mean, and keep its derivative."""
        x, y = image.detach().numpy(), truth.numpy()
        mx, my, exy = _blurred(x), _blurred(y), _blurred(x * y)
        squares = _blurred(x * x + y * y)
        means = mx * mx + my * my
        a1, a2 = 2 * mx * my + C1, 2 * (exy - mx * my) + C2
        b1, b2 = means + C1, squares - means + C2
        ssim = a1 * a2 / (b1 * b2)
        inside = (slice(MARGIN, -MARGIN),) * 2
        share = np.zeros_like(ssim)
        share[inside] = 1 / ssim[inside].size
        by_mean = share * (2 * my * (a2 - a1) / (b1 * b2) - 2 * mx * ssim * (1 / b1 - 1 / b2))
        by_square, by_product = share * (-ssim / b2), share * (2 * a1 / (b1 * b2))
        gradient = _blurred(by_mean) + 2 * x * _blurred(by_square) + y * _blurred(by_product)
        ctx.save_for_backward(torch.from_numpy(gradient))
        return torch.tensor(ssim[inside].mean(dtype=np.float64), dtype=torch.float32)

    @staticmethod
    def backward(ctx: Any, upstream: Tensor) -> tuple[Tensor, None]:
        """Return the derivative times what comes from above."""
        (gradient,) = ctx.saved_tensors
        return upstream * gradient, None


def _blurred(image: NDArray[np.floating]) -> NDArray[np.floating]:
    return cv2.GaussianBlur(np.ascontiguousarray(image), (WINDOW, WINDOW), SIGMA_PX, borderType=cv2.BORDER_CONSTANT)
