"""The perceptual term of the blending network's loss."""

import numpy as np
import pytest
import torch

from ggvs_eval.contrib.training.blend_task import (
    NOISE_255,
    noise_255,
    perceptual_loss,
    require_perceptual,
)
from ggvs_eval.errors import TrainingError
from ggvs_eval.metrics.image.lpips import lpips
from ggvs_eval.metrics.image.lpips_network import _torch_weights, weights_path
from helpers.refusals import refused

needs_weights = pytest.mark.skipif(
    not weights_path("alex").is_file(), reason="the weights of LPIPS are not fetched"
)


def bytes_of(height: int, width: int, seed: int) -> np.ndarray:
    """A smooth random picture, (H, W, 3), uint8."""
    coarse = np.random.default_rng(seed).random((6, 8, 3)).astype(np.float32)
    smooth = torch.nn.functional.interpolate(
        torch.from_numpy(coarse).permute(2, 0, 1)[None], (height, width), mode="bicubic"
    )
    return (smooth[0].permute(1, 2, 0).clamp(0, 1) * 255).round().byte().numpy()


def batch(*images: np.ndarray) -> torch.Tensor:
    return torch.stack([torch.from_numpy(image).permute(2, 0, 1).float() / 255 for image in images])


@needs_weights
def test_it_is_the_metric_where_the_truth_has_no_noise():
    """The mean of the metric's values, LPIPS on AlexNet, each less by what the truth's
    noise takes.
    """
    ours, theirs = (
        [bytes_of(64, 80, seed) for seed in (0, 1)],
        [bytes_of(64, 80, seed) for seed in (2, 3)],
    )
    weights = 1 / (1 + (noise_255(batch(*theirs)).numpy() / NOISE_255) ** 2)
    assert (weights > 0.95).all()
    expected = np.mean(
        [weight * lpips(*pair, "alex") for weight, *pair in zip(weights, ours, theirs, strict=True)]
    )
    assert float(perceptual_loss(batch(*ours), batch(*theirs))) == pytest.approx(expected, rel=1e-4)


@pytest.mark.slow
@needs_weights
def test_gradients_lead_to_the_truth():
    """Steps against the gradient bring a blurred picture nearer to its truth, and a perfect one has
    nothing to learn.
    """
    truth = batch(bytes_of(64, 80, 0))
    image = torch.nn.functional.avg_pool2d(truth, 5, 1, 2, count_include_pad=False).requires_grad_()
    losses = []
    for _ in range(4):
        loss = perceptual_loss(image, truth)
        (gradient,) = torch.autograd.grad(loss, image)
        losses.append(float(loss.detach()))
        image = (image - 0.0003 * gradient / gradient.abs().mean()).detach().requires_grad_()
    assert losses == sorted(losses, reverse=True)
    assert losses[-1] < 0.95 * losses[0]
    assert float(perceptual_loss(truth, truth)) == 0


@pytest.mark.slow
@needs_weights
def test_weights_first_read_while_scoring_serve_a_training():
    """Whoever reads the weights first, in inference mode even, a loss can be learned by
    afterwards.
    """
    _torch_weights.cache_clear()
    with torch.inference_mode():
        lpips(bytes_of(64, 80, 0), bytes_of(64, 80, 1), "alex")
    image = batch(bytes_of(64, 80, 0)).requires_grad_()
    perceptual_loss(image, batch(bytes_of(64, 80, 1))).backward()
    assert float(image.grad.abs().sum()) > 0


@pytest.mark.parametrize("sigma", [2.0, 8.0])
def test_noise_is_measured(sigma):
    """The standard deviation of planted noise within a tenth, over structure that bends slowly."""
    picture = batch(bytes_of(240, 320, 0)) * 0.5 + 0.25
    noise = torch.randn(picture.shape, generator=torch.Generator().manual_seed(1)) * sigma / 255
    assert float(noise_255(picture + noise)) == pytest.approx(sigma, rel=0.1)
    assert float(noise_255(picture)) < 0.5


def test_crops_too_small_are_refused():
    """AlexNet's last layer has no pixel below 31: said before anything is rendered."""
    with refused(TrainingError, "31 pixels", "64 x 24"):
        require_perceptual(64, 24)
