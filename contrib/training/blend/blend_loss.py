"""The loss of the blending network (Eqs. 6-7), and a perceptual term."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from ggvs_eval.baselines.fitted.optimiser import structural_loss
from ggvs_eval.contrib.training.blend.perceptual_loss import perceptual_loss
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online.blend_network import BlendOutputs, weighted_mean_tensor


@dataclass(frozen=True)
class BlendLossWeights:
    """Weights of the terms: the paper's four, and ours.

    Attributes:
        l1: mean absolute error of the colour.
        ssim: 1 - SSIM.
        depth: `depth_loss`.
        mask: `mask_loss`.
        perceptual: `perceptual_loss`; 0 for the paper's loss.
    """

    l1: float = 0.8
    ssim: float = 0.2
    depth: float = 0.1
    mask: float = 0.1
    perceptual: float = 0.1


def blend_loss(
    image: Tensor, outputs: BlendOutputs, batch: Mapping[str, Tensor], weights: BlendLossWeights, tsdf_guidance: bool
) -> tuple[Tensor, dict[str, float]]:
    """Eq. 7, and the perceptual term.

    Args:
        image: the synthesised view, (B, 3, H, W).
        batch: ``alphas`` (B, K, H, W) of the views and ``truth`` (B, 3, H, W) in [0, 1]; ``depths`` (B, K, H, W) and
            ``fused_depth`` (B, H, W) in the scene's own unit of length, 0 where unknown.
        tsdf_guidance: without it there is no fused depth to follow: the depth term is left out.

    Returns:
        The loss, and its terms for the log.
    """
    terms = {
        "l1": (image - batch["truth"]).abs().mean(),
        "ssim": structural_loss(image, batch["truth"]),
        "mask": mask_loss(outputs.background_weight, batch["alphas"]),
    }
    if weights.perceptual > 0:
        terms["perceptual"] = perceptual_loss(image, batch["truth"])
    if tsdf_guidance:
        terms["depth"] = depth_loss(batch["depths"], batch["fused_depth"], outputs.weights * batch["alphas"])
    loss = torch.stack([getattr(weights, name) * term for name, term in terms.items()]).sum()
    return loss, {f"{name}_loss": float(term.detach()) for name, term in terms.items()}


def depth_loss(depths: Tensor, fused_depth: Tensor, weights: Tensor) -> Tensor:
    """Measure how far the blended depth of the views lies from the fused one (Eq. 6).

    Args:
        depths: splatted depth of each view, (B, K, H, W), 0 where unknown.
        fused_depth: (B, H, W), 0 where unknown.
        weights: alpha_k w_k, (B, K, H, W).

    Reading:
        As printed the denominator lacks its sum over the views, and the sum over pixels is divided by H W K: kept, so the term
        weighs a K-th of what its factor says; K is the network's, views that a sample lacks included. Depth is measured in each
        scene's own unit (`reference_depth`), else the loss would depend on the scale of the world. Pixels count where the fused
        depth is known and a view has weight.
    """
    shown = weights * (depths > 0)
    blended = weighted_mean_tensor(depths[:, :, None], shown)[:, 0]
    counted = (fused_depth > 0) & (shown.sum(dim=1) > 1e-3)
    return ((blended - fused_depth).abs() * counted).mean() / depths.shape[1]


def mask_loss(background_weight: Tensor, alphas: Tensor) -> Tensor:
    """Measure how far the background's weight is from 1 where no view covers the pixel, and from 0 elsewhere.

    Args:
        background_weight: w_BG, (B, H, W).
        alphas: coverage, (B, K, H, W).
    """
    empty = (alphas.amax(dim=1) < COVERED_ALPHA).float()
    return (background_weight - empty).abs().mean()
