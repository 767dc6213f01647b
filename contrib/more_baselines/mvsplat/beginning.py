"""Initialisation of the compact network: a plane sweep with random features, whose Gaussians are the sources' pixels."""

import torch
from torch import Tensor, nn

from ggvs_eval.contrib.more_baselines.mvsplat.backbone import AttentionLayer, Backbone
from ggvs_eval.contrib.more_baselines.mvsplat.depth import OFFSET, QUATERNION, SCALES, DepthPredictor

FEATURE_GAIN = 10.0  # of the random features, so that their products outweigh those of positions
SHARPNESS = 0.6  # of the softmax over depths
FAINT = 0.01  # of what is to be learned beside it
SMALL_SCALE = -2.0  # before the sigmoid: standard deviations of half a pixel


@torch.no_grad()
def begin_as_plane_sweep(backbone: Backbone, predictor: DepthPredictor) -> None:
    """Set random weights so that the network does something sensible before it has learned.

    Features of a view are random sums of its convolutions without their mean, attention is silent, the softmax sees costs
    averaged over 5 x 5 cells, and a Gaussian is half a pixel large and lies at the depth that is expected.

    Reading:
        The authors begin with features and attention that others had trained to find depth. Nothing like it ships here, and the
        compact network has half an hour: begun at random, it spends that on what a plane sweep does at once.
    """
    last = backbone.backbone.conv2
    _fill(last, FEATURE_GAIN * (last.weight - last.weight.mean(dim=1, keepdim=True)))
    for layer in backbone.transformer.modules():
        if isinstance(layer, AttentionLayer):
            nn.init.zeros_(layer.last_norm.weight)
    _sweep(predictor)
    for head in (predictor.to_gaussians, predictor.to_disparity):
        _fill(head[2], FAINT * _weight(head[2]))
    shape = predictor.to_gaussians[2].state_dict()["bias"]  # the very tensor
    shape[OFFSET : OFFSET + SCALES] = SMALL_SCALE
    shape[OFFSET + SCALES + QUATERNION - 1] = 1  # the rotation that turns nothing


def _sweep(predictor: DepthPredictor) -> None:
    """Costs as they are, averaged twice over 3 x 3 cells: GELU(x) - GELU(-x) is x."""
    planes = torch.eye(predictor.candidates)
    both = torch.cat([planes, -planes])  # (2 D, D)
    costs, features = planes[..., None, None], torch.zeros_like(_weight(predictor.regressor_residual))[:, len(planes) :]
    _fill(predictor.corr_refine_net[4], FAINT * _weight(predictor.corr_refine_net[4]))
    _fill(predictor.regressor_residual, torch.cat([SHARPNESS * costs, features], dim=1))
    _fill(predictor.depth_head_lowres[0], _averaging(both))
    _fill(predictor.depth_head_lowres[2], _averaging(both.T))


def _averaging(mixing: Tensor) -> Tensor:
    """A 3 x 3 convolution that averages cells, and mixes channels by a matrix."""
    return mixing[..., None, None].expand(-1, -1, 3, 3) / 9


def _weight(convolution: nn.Module) -> Tensor:
    return convolution.state_dict()["weight"].clone()


def _fill(convolution: nn.Module, weight: Tensor) -> None:
    """Give a convolution its weight, and no bias."""
    convolution.load_state_dict({"weight": weight, "bias": torch.zeros(len(weight))})
