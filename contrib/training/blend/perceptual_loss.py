"""Perceptual term of the blending network's loss: LPIPS on AlexNet, as far as the truth is free of noise."""

import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.errors import TrainingError
from ggvs_eval.metric_choices import LpipsNet
from ggvs_eval.metrics.image.lpips_network import LAYERS, MIN_SIDE_PX, load_weights, network_input_of, tapped_layers

NET: LpipsNet = "alex"  # a tenth of VGG's time, and not the network that tables score by
NOISE_255 = 3.0  # standard deviation of the truth's noise at which the term counts half
NORMAL_MEDIAN = 0.6745  # of the absolute value of a standard normal variable


def perceptual_loss(image: Tensor, truth: Tensor) -> Tensor:
    """LPIPS v0.1 between rendered and captured crops, less where the truth is noisy.

    Args:
        image: (B, 3, H, W), at least 31 x 31.
        truth: same shape, in [0, 1].

    Reading:
        Not in the paper, whose L1 and SSIM blur what they cannot place: trained on captures with noise and motion blur beside
        clean ones, the network became softer in clean rooms (LPIPS 0.083 to 0.090). LPIPS asks for the truth's fine detail back,
        but of a noisy truth it asks for noise, which costs PSNR and can only be guessed; hence the weight.
    """
    weights = load_weights(NET, str(truth.device))
    with torch.no_grad():
        wanted = tapped_layers(network_input_of(truth), LAYERS[NET], weights)
    found = tapped_layers(network_input_of(image.clamp(0, 1)), LAYERS[NET], weights)
    distances = torch.zeros(len(truth), device=truth.device)
    for layer, (ours, theirs) in enumerate(zip(found, wanted, strict=True)):
        squared = (functional.normalize(ours, eps=1e-10) - functional.normalize(theirs, eps=1e-10)).square()
        distances = distances + torch.einsum("nchw,c->n", squared, weights[f"head{layer}.weight"]) / squared[0, 0].numel()
    return (distances / (1 + (noise_255(truth) / NOISE_255) ** 2)).mean()


def require_perceptual(width: int, height: int) -> None:
    """Refuse crops or weights the term cannot be computed with, before any work.

    Args:
        width: of the crops, pixels.
    """
    if min(width, height) < MIN_SIDE_PX[NET]:
        raise TrainingError(
            f"the perceptual term wants crops of at least {MIN_SIDE_PX[NET]} pixels a side, got {width} x {height}; "
            "learn from larger ones, or without it (perceptual=0)"
        )
    load_weights(NET)


def noise_255(images: Tensor) -> Tensor:
    """Estimate the noise of images (B, 3, H, W) in [0, 1]: standard deviation of a channel, (B,), in levels of 255.

    By the median of a filter that planes and straight edges pass without a trace (Immerkær, Fast noise variance estimation,
    1996), of the mean of the channels, whose noise is taken to be independent.
    """
    kernel = torch.tensor([[1.0, -2, 1], [-2, 4, -2], [1, -2, 1]], device=images.device)[None, None]
    filtered = functional.conv2d(images.mean(dim=1, keepdim=True), kernel).abs().flatten(1)
    return filtered.median(dim=1).values * (255 * 3**0.5 / (6 * NORMAL_MEDIAN))
