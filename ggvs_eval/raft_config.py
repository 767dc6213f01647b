"""Shapes of RAFT-Stereo: three published ones, so that their checkpoints load, and the compact one
that ships.
"""

from dataclasses import dataclass
from typing import Literal

Norm = Literal["batch", "instance"]
CORR_LEVELS = 4  # sizes of the correlation pyramid
CORR_RADIUS = 4  # cells looked up on either side, per level


@dataclass(frozen=True)
class RaftShape:
    """Shape of the network; the defaults are the authors' default.

    Attributes:
        shared_backbone: one trunk computes features of both images and the context.
        n_downsample: disparity is estimated at 1 / 2**n_downsample of the image's size.
        n_gru_layers: number of recurrent levels, each at half the size of the one before.
        slow_fast_gru: the coarse levels are updated more often than the fine one.
        context_norm: normalisation of the context encoder.
        hidden_width: channels of each recurrent state and of its context.
        trunk_widths: channels of the encoders' three stages.
        feature_width: channels of what is correlated.
        motion_width: channels of the motion encoder's first layers.
        motion_features: channels that it gives; those of the state where None.
        head_width: channels inside the heads for flow and upsampling weights.
        early_stride: the trunk halves the image as early as it can; the authors halve as late as
            they can, which costs four times as much.
    """

    shared_backbone: bool = False
    n_downsample: int = 2
    n_gru_layers: int = 3
    slow_fast_gru: bool = False
    context_norm: Norm = "batch"
    hidden_width: int = 128
    trunk_widths: tuple[int, int, int] = (64, 96, 128)
    feature_width: int = 256
    motion_width: int = 64
    motion_features: int | None = None
    head_width: int = 256
    early_stride: bool = False

    @property
    def factor(self) -> int:
        """Image pixels per cell of the disparity grid, along each axis."""
        return int(2**self.n_downsample)

    @property
    def strides(self) -> tuple[int, int, int]:
        """Strides of the trunk's first convolution, second and third stage."""
        first, second, third = (
            1 + (self.n_downsample > step)
            for step in ((0, 1, 2) if self.early_stride else (2, 1, 0))
        )
        return first, second, third


COMPACT = RaftShape(
    shared_backbone=True,
    n_gru_layers=2,
    context_norm="instance",
    hidden_width=64,
    trunk_widths=(32, 48, 64),
    feature_width=128,
    motion_width=48,
    head_width=128,
    early_stride=True,
)

# raftstereo-middlebury, -eth3d and -sceneflow share one configuration.
PUBLISHED: dict[str, RaftShape] = {
    "default": RaftShape(),
    "realtime": RaftShape(shared_backbone=True, n_downsample=3, n_gru_layers=2, slow_fast_gru=True),
    "rvc": RaftShape(context_norm="instance"),
}
