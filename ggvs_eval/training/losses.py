"""Terms of losses that several networks learn by."""

from torch import Tensor


def structural_loss(image: Tensor, truth: Tensor) -> Tensor:
    """1 - SSIM, with the window and constants of the metric `ggvs_eval.metrics.image.ssim`.

    Args:
        image: (B, 3, H, W), at least 11 x 11.
    """
    from kornia.metrics import ssim

    return 1 - ssim(image, truth, window_size=11, max_val=1.0, eps=0.0, padding="valid").mean()
