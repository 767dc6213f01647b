"""How the compact network begins: as a plane sweep with random features, whose Gaussians are the sources' pixels."""

import torch
from torch import Tensor, nn

from ggvs_eval.baselines.mvsplat.backbone import Backbone
from ggvs_eval.baselines.mvsplat.depth import OFFSET, QUATERNION, SCALES, DepthPredictor

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
    _contrast(backbone.backbone.conv2)
    for layer in backbone.transformer.layers:
        nn.init.zeros_(layer.self_attn.norm1.weight)
        nn.init.zeros_(layer.cross_attn_ffn.norm2.weight)
    _sweep(predictor)
    for head in (predictor.to_gaussians, predictor.to_disparity):
        _faint(head[2])
    shape = predictor.to_gaussians[2].bias
    shape[OFFSET : OFFSET + SCALES] = SMALL_SCALE
    shape[OFFSET + SCALES + QUATERNION - 1] = 1  # the rotation that turns nothing


def _contrast(last: nn.Conv2d) -> None:
    """Sums that do not see what all channels have in common, as rectified ones have."""
    last.weight.copy_(FEATURE_GAIN * (last.weight - last.weight.mean(dim=1, keepdim=True)))
    nn.init.zeros_(last.bias)


def _sweep(predictor: DepthPredictor) -> None:
    """Costs as they are, averaged twice over 3 x 3 cells: GELU(x) - GELU(-x) is x."""
    planes = torch.eye(predictor.candidates)
    _faint(predictor.corr_refine_net[4])
    nn.init.zeros_(predictor.regressor_residual.weight)
    nn.init.zeros_(predictor.regressor_residual.bias)
    predictor.regressor_residual.weight[:, : predictor.candidates, 0, 0] = SHARPNESS * planes
    first, second = predictor.depth_head_lowres[0], predictor.depth_head_lowres[2]
    both = torch.cat([planes, -planes])  # (2 D, D)
    first.weight.copy_(_averaging(both))
    second.weight.copy_(_averaging(both.T))
    nn.init.zeros_(first.bias)
    nn.init.zeros_(second.bias)


def _averaging(mixing: Tensor) -> Tensor:
    """A 3 x 3 convolution that averages cells, and mixes channels by a matrix."""
    return mixing[..., None, None].expand(-1, -1, 3, 3) / 9


def _faint(convolution: nn.Conv2d) -> None:
    convolution.weight.mul_(FAINT)
    nn.init.zeros_(convolution.bias)
