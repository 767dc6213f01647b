"""The blending network: what its outputs mean, and the composition of Eqs. 4-5 that gradients flow through."""

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from ggvs_eval.pipelines.online.network_inputs import channel_count
from ggvs_eval.pipelines.online.unet import UNet

BEYOND_VIEWS = 4  # outputs beside one per view: weight of the background and its colour


@dataclass(frozen=True)
class BlendConfig:
    """Shape of a blending network.

    Attributes:
        views: K; a network takes this number of source views, no other.
        tsdf_guidance: whether it sees the fused depth (False: ablation 'No TSDF Guidance').
        width: channels of the U-Net's first level. With 32 the network is as large as the paper's timings allow; 16 is four times
            as fast.
    """

    views: int = 4
    tsdf_guidance: bool = True
    width: int = 32

    @property
    def inputs(self) -> int:
        """Channels of the input."""
        return channel_count(self.views, self.tsdf_guidance)

    @property
    def outputs(self) -> int:
        """Channels of the output."""
        return self.views + BEYOND_VIEWS


class BlendNetwork(nn.Module):
    """The U-Net between the input channels and the outputs that `read_outputs` understands."""

    def __init__(self, config: BlendConfig) -> None:
        super().__init__()
        self.config = config
        self.unet = UNet(config.inputs, config.outputs, config.width)

    def forward(self, channels: Tensor) -> Tensor:
        """Input channels (B, 9 K + 1, H, W) to raw outputs (B, K + 4, H, W)."""
        return self.unet(channels)


@dataclass(frozen=True, eq=False)
class BlendOutputs:
    """What the network decides for every pixel.

    Attributes:
        weights: w_k, (B, K, H, W), positive, sum 1 over the views.
        background_weight: w_BG, (B, H, W), in [0, 1].
        background: I_BG, (B, 3, H, W), in [0, 1].
    """

    weights: Tensor
    background_weight: Tensor
    background: Tensor


def read_outputs(raw: Tensor) -> BlendOutputs:
    """Raw outputs (B, K + 4, H, W) as weights and background, float32.

    Reading:
        The paper names no activations: a softmax over the views, whose ratios alone matter, and sigmoids.
    """
    values = raw.float()
    views = values.shape[1] - BEYOND_VIEWS
    return BlendOutputs(
        weights=torch.softmax(values[:, :views], dim=1),
        background_weight=torch.sigmoid(values[:, views]),
        background=torch.sigmoid(values[:, views + 1 :]),
    )


def compose_tensors(outputs: BlendOutputs, colours: Tensor, alphas: Tensor) -> Tensor:
    """Eqs. 4-5 as `blending.compose` has them, for a batch.

    Args:
        outputs: of the network.
        colours: splatted views, (B, K, 3, H, W).
        alphas: their coverage, (B, K, H, W).

    Returns:
        Images, (B, 3, H, W).
    """
    foreground = weighted_mean_tensor(colours, outputs.weights * alphas)
    return foreground + outputs.background_weight[:, None] * (outputs.background - foreground)


def weighted_mean_tensor(values: Tensor, weights: Tensor) -> Tensor:
    """Mean over the views, 0 where no view has weight.

    Args:
        values: (B, K, C, H, W).
        weights: (B, K, H, W).
    """
    total = weights.sum(dim=1, keepdim=True) + 1e-6  # (B, 1, H, W)
    return (weights[:, :, None] * values).sum(dim=1) / total
