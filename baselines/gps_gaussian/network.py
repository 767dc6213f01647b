"""GPS-Gaussian as a whole: features of both images, stereo between them, Gaussians of every pixel.

And its weights.

Names of modules are those of the published checkpoint. It also holds two units of coarser levels
that are never run.

Names of modules are those of the published checkpoint.
"""

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Literal, NamedTuple

import torch
from torch import Tensor, nn
from torch.nn import functional
from torch.serialization import safe_globals

from ggvs_eval.baselines.learned import FULL
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors
from ggvs_eval.raft_config import RaftShape
from ggvs_eval.raft_update import UpdateBlock, upsample_convex, walk
from ggvs_eval.residual_block import ResidualBlock

HIDDEN = 96  # channels of the state
SHAPE = RaftShape(n_downsample=3, n_gru_layers=1, hidden_width=HIDDEN, motion_features=128)
CHANNELS_PER_GROUP = 8  # of the residual blocks' group normalisation
STEM_WIDTH, STEM_GROUPS = 32, 8
HEAD_WIDTH = 32
MAX_SCALE_M = 0.01  # no Gaussian has a larger standard deviation
Pyramid = tuple[Tensor, Tensor, Tensor]  # features at 1/2, 1/4 and 1/8 of the size
SIZE_MULTIPLE = 8  # sides of the images are multiples of it
ITERATIONS = 3  # of the published network, in training and after
OF = "GPS-Gaussian (GPS-GS_stage2_final.pth)"
# Until version 2.0 torch kept one of its functions in the state of a OneCycleLR scheduler, as
# `getattr` of the class by name, and the authors' checkpoint holds such a state. What is read in
# place of both calls is nothing at all.
FORGOTTEN = ("builtins.getattr", "torch.optim.lr_scheduler.OneCycleLR")


class Stereo(nn.Module):
    """Flow of both images of a rectified pair, each to the other ('raft_stereo').

    Args:
        width: channels of the features at an eighth of the size.
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.cnet = ContextEncoder(width)
        self.context_zqr_convs = nn.ModuleList([nn.Conv2d(HIDDEN, 3 * HIDDEN, 3, padding=1)])
        self.update_module = nn.ModuleDict({"update_block": UpdateBlock(SHAPE)})

    def forward(self, features: Tensor, iterations: int) -> Tensor:
        """Return the flow after some iterations.

        Args:
            features: at an eighth of the size, (2, C, H / 8, W / 8): left image, right image.
            iterations: number of updates, at least 1.

        Returns:
            Horizontal flow in pixels, (2, 1, H, W): column of the match in the other image less the
            own column.
        """
        matched, hidden, context = self.cnet(features)
        block, states = (
            self.update_module["update_block"],
            [(torch.tanh(hidden), torch.relu(context))],
        )
        assert isinstance(block, UpdateBlock)
        flows, weights = walk(
            block, self.context_zqr_convs, matched, matched.flip(0), states, iterations
        )
        return upsample_convex(flows[-1], weights, SHAPE.factor)


class ContextEncoder(nn.Module):
    """From the features of an image: what is correlated, where the recurrent state starts, and its
    context ('cnet').
    """

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv2 = nn.Sequential(
            residual_block(width, width), nn.Conv2d(width, 2 * width, 3, padding=1)
        )
        self.outputs08 = nn.ModuleList(
            nn.Sequential(residual_block(width, width), nn.Conv2d(width, HIDDEN, 3, padding=1))
            for _ in ("hidden", "context")
        )

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, C, H, W) to features (B, 2 C, H, W), and state and context before their activations,
        (B, HIDDEN, H, W).
        """
        hidden, context = (head(features) for head in self.outputs08)
        return self.conv2(features), hidden, context


class PyramidEncoder(nn.Module):
    """A 5x5 convolution that halves, then three stages of two residual blocks.

    The last two halve again.

    Args:
        channels: of the input: 3 for images, 1 for inverse depth.
    """

    def __init__(self, channels: int, widths: tuple[int, int, int]) -> None:
        super().__init__()
        narrow, middle, wide = widths
        self.in_ds = nn.Sequential(
            nn.Conv2d(channels, STEM_WIDTH, 5, stride=2, padding=2),
            nn.GroupNorm(STEM_GROUPS, STEM_WIDTH),
            nn.ReLU(),
        )
        self.res1 = two_blocks(STEM_WIDTH, narrow)
        self.res2 = two_blocks(narrow, middle, stride=2)
        self.res3 = two_blocks(middle, wide, stride=2)

    def forward(self, maps: Tensor) -> Pyramid:
        """(B, C, H, W), H and W multiples of 8, to features at 1/2, 1/4 and 1/8 of that size."""
        half = self.res1(self.in_ds(maps))
        quarter = self.res2(half)
        return half, quarter, self.res3(quarter)


def two_blocks(width_in: int, width: int, stride: int = 1) -> nn.Sequential:
    """Return two residual blocks, the first of which changes width and size."""
    return nn.Sequential(residual_block(width_in, width, stride), residual_block(width, width))


def residual_block(width_in: int, width: int, stride: int = 1) -> ResidualBlock:
    """Return a residual block with group normalisation."""
    return ResidualBlock(width_in=width_in, width=width, normalise=_normalisation, stride=stride)


def _normalisation(width: int) -> nn.Module:
    return nn.GroupNorm(width // CHANNELS_PER_GROUP, width)


class GaussianMaps(NamedTuple):
    """Shape of the Gaussian of each pixel.

    Attributes:
        rotation: unit quaternions w, x, y, z, (B, 4, H, W).
        scale_m: standard deviations along the three axes, metres, (B, 3, H, W).
        opacity: (B, 1, H, W), in [0, 1].
    """

    rotation: Tensor
    scale_m: Tensor
    opacity: Tensor


class GaussianRegressor(nn.Module):
    """A U-Net over features of image and depth ('gs_parm_regresser').

    Args:
        decoder_widths: channels of the decoder at 1/2, 1/4 and 1/8 of the size.
    """

    def __init__(
        self,
        encoder_widths: tuple[int, int, int] = (32, 48, 96),
        decoder_widths: tuple[int, int, int] = (48, 64, 96),
    ) -> None:
        super().__init__()
        half, quarter, eighth = encoder_widths
        fine, middle, coarse = decoder_widths
        self.depth_encoder = PyramidEncoder(1, encoder_widths)
        self.decoder3 = two_blocks(2 * eighth, coarse)
        self.decoder2 = two_blocks(2 * quarter + coarse, middle)
        self.decoder1 = two_blocks(2 * half + middle, fine)
        self.out_conv = nn.Conv2d(fine + 3 + 1, HEAD_WIDTH, 3, padding=1)
        self.rot_head = _head(4)
        self.scale_head = _head(3)
        self.opacity_head = _head(1)

    def forward(
        self, images: Tensor, inverse_depth: Tensor, image_features: Pyramid
    ) -> GaussianMaps:
        """Return the Gaussians of some views.

        Args:
            images: (B, 3, H, W) in [-1, 1], H and W multiples of 8.
            inverse_depth: per metre, (B, 1, H, W), 0 = unknown.
            image_features: features of the images at 1/2, 1/4 and 1/8 of their size.
        """
        half, quarter, eighth = (
            torch.cat(pair, dim=1)
            for pair in zip(image_features, self.depth_encoder(inverse_depth), strict=True)
        )
        decoded = _double(self.decoder3(eighth))
        decoded = _double(self.decoder2(torch.cat([decoded, quarter], dim=1)))
        decoded = _double(self.decoder1(torch.cat([decoded, half], dim=1)))
        features = functional.relu(
            self.out_conv(torch.cat([decoded, images, inverse_depth], dim=1))
        )
        return GaussianMaps(
            functional.normalize(self.rot_head(features), dim=1),
            functional.softplus(self.scale_head(features), beta=100).clamp(max=MAX_SCALE_M),
            torch.sigmoid(self.opacity_head(features)),
        )


def _head(channels: int) -> nn.Sequential:
    return nn.Sequential(
        nn.Conv2d(HEAD_WIDTH, HEAD_WIDTH, 3, padding=1),
        nn.ReLU(),
        nn.Conv2d(HEAD_WIDTH, channels, 1),
    )


def _double(features: Tensor) -> Tensor:
    return functional.interpolate(features, scale_factor=2, mode="bilinear", align_corners=False)


@dataclass(frozen=True)
class GpsGaussianShape:
    """Shape of the network, and how it is used.

    Attributes:
        widths: channels of the encoders at 1/2, 1/4 and 1/8 of the size.
        decoder_widths: channels of the decoder there.
        stereo: whether it finds depth itself; without, depth must be given.
        pairs: how many pairs are rendered together.
        rotations_in: what rotations refer to: the ``world``, or the rectified ``camera``, which
            makes the output independent of the choice of the world's axes.
        entire: whether rectified canvases hold the whole images, see `rectify`.
    """

    widths: tuple[int, int, int] = (32, 48, 96)
    decoder_widths: tuple[int, int, int] = (48, 64, 96)
    stereo: bool = True
    pairs: int = 1
    rotations_in: Literal["world", "camera"] = "world"
    entire: bool = False


CONFIGURATIONS = {
    "full": GpsGaussianShape(),
    "compact": GpsGaussianShape(
        (16, 24, 48), (24, 32, 48), stereo=False, pairs=2, rotations_in="camera", entire=True
    ),
}


class GpsGaussianNetwork(nn.Module):
    """The network; parameters have the names of the published checkpoint."""

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        self.img_encoder = PyramidEncoder(3, config.widths)
        self.raft_stereo = Stereo(config.widths[-1]) if config.stereo else None
        self.gs_parm_regresser = GaussianRegressor(config.widths, config.decoder_widths)

    def features(self, images: Tensor) -> Pyramid:
        """Return the features of a rectified pair (2, 3, H, W) in [-1, 1], left image first, at
        1/2, 1/4 and 1/8 of the size.
        """
        pyramid: Pyramid = self.img_encoder(images)
        return pyramid

    def flow(self, features: Pyramid, iterations: int = ITERATIONS) -> Tensor:
        """Return the column of each pixel's match in the other image less its own, pixels, (2, 1,
        H, W).
        """
        if self.raft_stereo is None:
            raise WeightsError(
                f"GPS-Gaussian ({self.configuration}) finds no depth; render "
                "gps-gaussian+given-depth, or give the authors' checkpoint by --weights "
                "gps-gaussian=FILE"
            )
        flow: Tensor = self.raft_stereo(features[2], iterations)
        return flow

    def gaussians(self, images: Tensor, inverse_depth: Tensor, features: Pyramid) -> GaussianMaps:
        """Return the Gaussian of every pixel.

        Inverse depth is per metre, (2, 1, H, W), 0 = unknown.
        """
        maps: GaussianMaps = self.gs_parm_regresser(images, inverse_depth, features)
        return maps


@lru_cache(maxsize=2)
def load_network(path: Path, device: torch.device | str = "cpu") -> GpsGaussianNetwork:
    """Return the network of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint (a dict with ``network``, ``total_steps``, ``optimizer`` and
            ``scheduler``), or safetensors whose names begin with ``network.``, or the output of
            `ggvs-eval train`.

    Raises:
        WeightsError: absent, damaged, more than tensors and plain values inside, or tensors of
            another network.
    """
    configuration = configuration_of(path, CONFIGURATIONS, OF)
    with safe_globals([(_nothing, name) for name in FORGOTTEN]):
        tensors = read_tensors(path, *(() if configuration else ("network",)), model=OF)
    network = GpsGaussianNetwork(configuration or FULL)
    load_strict(tensors, network, path, OF)
    return network.eval().to(device)


def _nothing(*_: object) -> None:
    """Nothing, in place of a result that a checkpoint does not need."""
