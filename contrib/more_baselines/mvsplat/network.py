"""MVSplat as a whole: features, depth, Gaussians.

Its configurations, its weights, and what the compact network begins with.
"""

from dataclasses import dataclass
from functools import lru_cache
from math import lcm
from pathlib import Path

import torch
from torch import Tensor, nn

from ggvs_eval.contrib.more_baselines.mvsplat.backbone import SCALE, AttentionLayer, Backbone
from ggvs_eval.contrib.more_baselines.mvsplat.depth import (
    OFFSET,
    QUATERNION,
    REFINEMENT_LEVELS,
    SCALES,
    DepthPredictor,
    PixelMaps,
)
from ggvs_eval.contrib.more_baselines.mvsplat.views import Views
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

FEATURE_GAIN = 10.0  # of the random features, so that their products outweigh those of positions
SHARPNESS = 0.6  # of the softmax over depths
FAINT = 0.01  # relative to what else is to be learned
SMALL_SCALE = -2.0  # before the sigmoid: standard deviations of half a pixel


@torch.no_grad()
def begin_as_plane_sweep(backbone: Backbone, predictor: DepthPredictor) -> None:
    """Set random weights so that the network does something sensible before it has learned.

    Features of a view are random sums of its convolutions without their mean, attention is silent,
    the softmax sees costs averaged over 5 x 5 cells, and a Gaussian is half a pixel large and is at
    the depth that is expected.

    Reading:
        The authors begin with features and attention that others had trained to find depth. Nothing
        like it ships here, and the compact network has half an hour: begun at random, it spends
        that on what a plane sweep does at once.
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
    signed_planes = torch.cat([planes, -planes])  # (2 D, D)
    costs, features = (
        planes[..., None, None],
        torch.zeros_like(_weight(predictor.regressor_residual))[:, len(planes) :],
    )
    _fill(predictor.corr_refine_net[4], FAINT * _weight(predictor.corr_refine_net[4]))
    _fill(predictor.regressor_residual, torch.cat([SHARPNESS * costs, features], dim=1))
    _fill(predictor.depth_head_lowres[0], _averaging(signed_planes))
    _fill(predictor.depth_head_lowres[2], _averaging(signed_planes.T))


def _averaging(mixing: Tensor) -> Tensor:
    """Return a 3 x 3 convolution that averages cells, and mixes channels by a matrix."""
    return mixing[..., None, None].expand(-1, -1, 3, 3) / 9


def _weight(convolution: nn.Module) -> Tensor:
    return convolution.state_dict()["weight"].clone()


def _fill(convolution: nn.Module, weight: Tensor) -> None:
    """Give a convolution its weight, and no bias."""
    convolution.load_state_dict({"weight": weight, "bias": torch.zeros(len(weight))})


OF = "MVSplat (re10k.ckpt)"
PREFIX = "encoder."  # of its names in the authors' checkpoint


@dataclass(frozen=True)
class MvsplatShape:
    """Shape of the network, and how its output is read.

    Attributes:
        stages: channels of the convolutional stages.
        window: cells along the side of an attention's window; None for windows of half the map,
            which grow with the image.
        candidates: planes of a cost volume.
        cost_width: channels of the cost volume's U-Net.
        refinement_width: channels of the U-Net at full resolution.
        published: whether Gaussians are read as the authors' code does, see
            `ggvs_eval.contrib.more_baselines.mvsplat.gaussians`.
    """

    stages: tuple[int, int, int] = (64, 96, 128)
    width: int = 128
    layers: int = 6
    window: int | None = None
    candidates: int = 128
    cost_width: int = 128
    refinement_width: int = 32
    degree: int = 4
    published: bool = True

    @property
    def size_multiple(self) -> int:
        """Sides of images are multiples of it, pixels."""
        return lcm(2 ** (REFINEMENT_LEVELS - 1), SCALE * (self.window or 2))

    @property
    def shape_channels(self) -> int:
        """Channels that shape and colour a Gaussian."""
        return OFFSET + SCALES + QUATERNION + 3 * (self.degree + 1) ** 2


CONFIGURATIONS = {
    "full": MvsplatShape(),
    "compact": MvsplatShape(
        stages=(32, 48, 64),
        width=64,
        layers=3,
        window=8,
        candidates=48,
        cost_width=48,
        refinement_width=24,
        degree=1,
        published=False,
    ),
}


class MvsplatNetwork(nn.Module):
    """The network; parameters have the names of the published checkpoint, without ``encoder.``."""

    def __init__(self, configuration: str = "full") -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        self.backbone = Backbone(config.stages, config.width, config.layers)
        self.depth_predictor = DepthPredictor(
            width=config.width,
            candidates=config.candidates,
            cost_width=config.cost_width,
            refinement_width=config.refinement_width,
            shape_channels=config.shape_channels,
        )
        if not config.published:
            begin_as_plane_sweep(self.backbone, self.depth_predictor)

    def forward(self, views: Views) -> PixelMaps:
        """Return the parameters of the Gaussian of every pixel of every view, at least two."""
        together, alone = self.backbone(views.images, self.config.window)
        pixels: PixelMaps = self.depth_predictor(together, alone, views)
        return pixels


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> MvsplatNetwork:
    """Return the network of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint (a dict with ``state_dict``, whose names begin with
            ``encoder.``), or safetensors of those names, or the output of `ggvs-eval train`.

    Raises:
        WeightsError: absent, damaged, more than tensors and plain values inside, or tensors of
            another network.
    """
    configuration = configuration_of(path, CONFIGURATIONS, OF)
    bare = configuration is not None or path.suffix == ".safetensors"
    tensors = read_tensors(path, *(() if bare else ("state_dict",)), model=OF)
    network = MvsplatNetwork(configuration or "full")
    load_strict(
        {name.removeprefix(PREFIX): tensor for name, tensor in tensors.items()}, network, path, OF
    )
    return network.eval().to(device)
