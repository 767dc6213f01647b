"""The stereo half: RAFT-Stereo with one level, between features at an eighth of the size.

Names of modules are those of the published checkpoint. It also holds two units of coarser levels that are never run.
"""

import torch
from torch import Tensor, nn

from ggvs_eval.baselines.gps_gaussian.unet import residual_block
from ggvs_eval.raft_config import RaftOptions
from ggvs_eval.raft_update import UpdateBlock, upsample_convex, walk

HIDDEN = 96  # channels of the state
SHAPE = RaftOptions(n_downsample=3, n_gru_layers=1, hidden_width=HIDDEN, motion_features=128)


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
        """Flow after some iterations.

        Args:
            features: at an eighth of the size, (2, C, H / 8, W / 8): left image, right image.
            iterations: number of updates, at least 1.

        Returns:
            Horizontal flow in pixels, (2, 1, H, W): column of the match in the other image less the own column.
        """
        matched, hidden, context = self.cnet(features)
        block, states = self.update_module["update_block"], [(torch.tanh(hidden), torch.relu(context))]
        assert isinstance(block, UpdateBlock)
        flows, weights = walk(block, self.context_zqr_convs, matched, matched.flip(0), states, iterations)
        return upsample_convex(flows[-1], weights, SHAPE.factor)


class ContextEncoder(nn.Module):
    """From the features of an image: what is correlated, where the recurrent state starts, and its context ('cnet')."""

    def __init__(self, width: int) -> None:
        super().__init__()
        self.conv2 = nn.Sequential(residual_block(width, width), nn.Conv2d(width, 2 * width, 3, padding=1))
        self.outputs08 = nn.ModuleList(
            nn.Sequential(residual_block(width, width), nn.Conv2d(width, HIDDEN, 3, padding=1)) for _ in ("hidden", "context")
        )

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """(B, C, H, W) to features (B, 2 C, H, W), and state and context before their activations, (B, HIDDEN, H, W)."""
        hidden, context = (head(features) for head in self.outputs08)
        return self.conv2(features), hidden, context
