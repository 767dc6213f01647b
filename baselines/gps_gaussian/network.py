"""GPS-Gaussian as a whole: features of both images, stereo between them, Gaussians of every pixel; and its weights."""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal

import torch
from torch import Tensor, nn
from torch.serialization import safe_globals

from ggvs_eval.baselines.gps_gaussian.stereo import Stereo
from ggvs_eval.baselines.gps_gaussian.unet import GaussianMaps, GaussianRegressor, Pyramid, PyramidEncoder
from ggvs_eval.baselines.learned import FULL
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors

SIZE_MULTIPLE = 8  # sides of the images are multiples of it
ITERATIONS = 3  # of the published network, in training and after
OF = "GPS-Gaussian (GPS-GS_stage2_final.pth)"

# Until version 2.0 torch kept one of its own functions in the state of a OneCycleLR scheduler, as `getattr` of the class by name,
# and the authors' checkpoint holds such a state. What is read in place of both calls is nothing at all.
FORGOTTEN = ("builtins.getattr", "torch.optim.lr_scheduler.OneCycleLR")


@dataclass(frozen=True)
class GpsGaussianOptions:
    """Shape of the network, and how it is used.

    Attributes:
        widths: channels of the encoders at 1/2, 1/4 and 1/8 of the size.
        decoder_widths: channels of the decoder there.
        stereo: whether it finds depth itself; without, depth must be given.
        pairs: how many pairs are rendered together.
        rotations_in: what rotations refer to: the ``world``, or the rectified ``camera``, which makes the output independent of
            the choice of the world's axes.
        whole: whether rectified canvases hold the whole images, see `rectify`.
    """

    widths: tuple[int, int, int] = (32, 48, 96)
    decoder_widths: tuple[int, int, int] = (48, 64, 96)
    stereo: bool = True
    pairs: int = 1
    rotations_in: Literal["world", "camera"] = "world"
    whole: bool = False


CONFIGURATIONS = {
    "full": GpsGaussianOptions(),
    "compact": GpsGaussianOptions((16, 24, 48), (24, 32, 48), stereo=False, pairs=2, rotations_in="camera", whole=True),
}


class GpsGaussianNetwork(nn.Module):
    """The network; parameters bear the names of the published checkpoint."""

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        self.img_encoder = PyramidEncoder(3, config.widths)
        self.raft_stereo = Stereo(config.widths[-1]) if config.stereo else None
        self.gs_parm_regresser = GaussianRegressor(config.widths, config.decoder_widths)

    def features(self, images: Tensor) -> Pyramid:
        """Features of a rectified pair (2, 3, H, W) in [-1, 1], left image first, at 1/2, 1/4 and 1/8 of the size."""
        pyramid: Pyramid = self.img_encoder(images)
        return pyramid

    def flow(self, features: Pyramid, iterations: int = ITERATIONS) -> Tensor:
        """Column of each pixel's match in the other image less its own, pixels, (2, 1, H, W)."""
        if self.raft_stereo is None:
            raise WeightsError(
                f"GPS-Gaussian ({self.configuration}) finds no depth of its own; render gps-gaussian+given-depth, or give the "
                "authors' checkpoint by --weights gps-gaussian=FILE"
            )
        flow: Tensor = self.raft_stereo(features[2], iterations)
        return flow

    def gaussians(self, images: Tensor, inverse_depth: Tensor, features: Pyramid) -> GaussianMaps:
        """The Gaussian of every pixel; inverse depth is per metre, (2, 1, H, W), 0 = unknown."""
        maps: GaussianMaps = self.gs_parm_regresser(images, inverse_depth, features)
        return maps


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> GpsGaussianNetwork:
    """The network of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint (a dict with ``network`` beside ``total_steps``, ``optimizer`` and ``scheduler``), or
            safetensors whose names begin with ``network.``, or what our training wrote.

    Raises:
        WeightsError: absent, damaged, more than tensors and plain values inside, or tensors of another network.
    """
    configuration = configuration_of(path, CONFIGURATIONS, OF)
    with safe_globals([(_nothing, name) for name in FORGOTTEN]):
        tensors = read_tensors(path, *(() if configuration else ("network",)), of=OF)
    network = GpsGaussianNetwork(configuration or FULL)
    load_strict(tensors, network, path, OF)
    return network.eval().to(device)


def _nothing(*_: object) -> None:
    """Nothing, in place of a result that a checkpoint need not bring back."""
