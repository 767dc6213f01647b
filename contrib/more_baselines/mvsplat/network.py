"""MVSplat as a whole: features, depth, Gaussians; its configurations and its weights."""

from dataclasses import dataclass
from functools import lru_cache
from math import lcm
from pathlib import Path

import torch
from torch import nn

from ggvs_eval.baselines.learned import FULL
from ggvs_eval.contrib.more_baselines.mvsplat.backbone import SCALE, Backbone
from ggvs_eval.contrib.more_baselines.mvsplat.beginning import begin_as_plane_sweep
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

OF = "MVSplat (re10k.ckpt)"
PREFIX = "encoder."  # of its names in the authors' checkpoint


@dataclass(frozen=True)
class MvsplatShape:
    """Shape of the network, and how its output is read.

    Attributes:
        stages: channels of the convolutional stages.
        window: cells along the side of an attention's window; None for windows of half the map, which grow with the image.
        candidates: planes of a cost volume.
        cost_width: channels of the cost volume's U-Net.
        refinement_width: channels of the U-Net at full resolution.
        published: whether Gaussians are read as the authors' code does, see `ggvs_eval.contrib.more_baselines.mvsplat.gaussians`.
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
    "compact": MvsplatShape((32, 48, 64), 64, 3, 8, 48, 48, 24, degree=1, published=False),
}


class MvsplatNetwork(nn.Module):
    """The network; parameters bear the names of the published checkpoint, without ``encoder.``."""

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        self.backbone = Backbone(config.stages, config.width, config.layers)
        self.depth_predictor = DepthPredictor(
            config.width, config.candidates, config.cost_width, config.refinement_width, config.shape_channels
        )
        if not config.published:
            begin_as_plane_sweep(self.backbone, self.depth_predictor)

    def forward(self, views: Views) -> PixelMaps:
        """Parameters of the Gaussian of every pixel of every view, at least two."""
        together, alone = self.backbone(views.images, self.config.window)
        pixels: PixelMaps = self.depth_predictor(together, alone, views)
        return pixels


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> MvsplatNetwork:
    """The network of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint (a dict with ``state_dict``, whose names begin with ``encoder.``), or safetensors of those
            names, or what our training wrote.

    Raises:
        WeightsError: absent, damaged, more than tensors and plain values inside, or tensors of another network.
    """
    configuration = configuration_of(path, CONFIGURATIONS, OF)
    bare = configuration is not None or path.suffix == ".safetensors"
    tensors = read_tensors(path, *(() if bare else ("state_dict",)), of=OF)
    network = MvsplatNetwork(configuration or FULL)
    load_strict({name.removeprefix(PREFIX): tensor for name, tensor in tensors.items()}, network, path, OF)
    return network.eval().to(device)
