"""What RAFT-Stereo sees of the images: features to correlate, and the context that its recurrent units start from.

Names of modules are those of the published checkpoints.
"""

from collections.abc import Callable, Sequence

from torch import Tensor, nn

from ggvs_eval.pipelines.offline.stereo.raft_config import Norm, RaftOptions
from ggvs_eval.residual_block import ResidualBlock


class Trunk(nn.Module):
    """The three stages that both encoders begin with."""

    def __init__(self, config: RaftOptions, norm: Norm) -> None:
        super().__init__()
        first, second, third = config.strides
        narrow, middle, wide = config.trunk_widths
        self.conv1 = nn.Conv2d(3, narrow, 7, first, padding=3)
        self.norm1 = normalisation(norm)(narrow)
        self.relu1 = nn.ReLU()
        self.layer1 = _stage(narrow, narrow, norm, 1)
        self.layer2 = _stage(narrow, middle, norm, second)
        self.layer3 = _stage(middle, wide, norm, third)

    def trunk(self, images: Tensor) -> Tensor:
        """Images (B, 3, H, W) in [-1, 1] to features (B, C, H / factor, W / factor)."""
        features: Tensor = self.relu1(self.norm1(self.conv1(images)))
        for stage in (self.layer1, self.layer2, self.layer3):
            features = stage(features)
        return features


class FeatureEncoder(Trunk):
    """Features of one image, to be correlated with the other's ('fnet')."""

    def __init__(self, config: RaftOptions) -> None:
        super().__init__(config, "instance")
        self.conv2 = nn.Conv2d(config.trunk_widths[-1], config.feature_width, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Images (B, 3, H, W) to features (B, feature_width, H / factor, W / factor)."""
        features: Tensor = self.conv2(self.trunk(images))
        return features


class ContextEncoder(Trunk):
    """Hidden state and context of up to three recurrent levels from the reference image ('cnet').

    All three levels exist whatever the configuration, as in the checkpoints; what is not used is not computed.
    """

    def __init__(self, config: RaftOptions) -> None:
        super().__init__(config, config.context_norm)
        norm, wide, width = config.context_norm, config.trunk_widths[-1], config.hidden_width
        self.n_levels = config.n_gru_layers
        self.layer4 = _stage(wide, wide, norm, 2)
        self.layer5 = _stage(wide, wide, norm, 2)
        self.outputs08 = nn.ModuleList(_head(wide, width, norm) for _ in ("hidden", "context"))
        self.outputs16 = nn.ModuleList(_head(wide, width, norm) for _ in ("hidden", "context"))
        self.outputs32 = nn.ModuleList(nn.Conv2d(wide, width, 3, padding=1) for _ in ("hidden", "context"))

    def heads(self, features: Tensor) -> list[tuple[Tensor, Tensor]]:
        """Trunk features to (hidden, context) before their activations, finest level first."""
        levels: list[tuple[Sequence[nn.Module] | nn.ModuleList, nn.Module | None]] = [
            (self.outputs08, None),
            (self.outputs16, self.layer4),
            (self.outputs32, self.layer5),
        ]
        pairs = []
        for outputs, stage in levels[: self.n_levels]:
            features = features if stage is None else stage(features)
            hidden, context = (output(features) for output in outputs)
            pairs.append((hidden, context))
        return pairs


def _stage(width_in: int, width: int, norm: Norm, stride: int) -> nn.Sequential:
    normalise = normalisation(norm)
    return nn.Sequential(ResidualBlock(width_in, width, normalise, stride), ResidualBlock(width, width, normalise))


def _head(width_in: int, width: int, norm: Norm) -> nn.Sequential:
    return nn.Sequential(ResidualBlock(width_in, width_in, normalisation(norm)), nn.Conv2d(width_in, width, 3, padding=1))


def normalisation(norm: Norm) -> Callable[[int], nn.Module]:
    """What makes the normalisation of so many channels."""
    return nn.BatchNorm2d if norm == "batch" else nn.InstanceNorm2d
