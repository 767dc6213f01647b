"""RAFT-Stereo as a whole: features, correlation, and a recurrent unit that walks along the row to
the match.

Names of modules are those of the published checkpoints.
"""

from collections.abc import Callable, Sequence

import torch
from torch import Tensor, nn

from ggvs_eval.raft_config import Norm, RaftShape
from ggvs_eval.raft_update import VOLUME_BYTES, UpdateBlock, upsample_convex, walk
from ggvs_eval.residual_block import ResidualBlock

SIZE_MULTIPLE = 32  # images are padded to it


class Trunk(nn.Module):
    """The three stages that both encoders begin with."""

    def __init__(self, config: RaftShape, norm: Norm) -> None:
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
        """Encode images (B, 3, H, W) in [-1, 1] as features (B, C, H / factor, W / factor)."""
        features: Tensor = self.relu1(self.norm1(self.conv1(images)))
        for stage in (self.layer1, self.layer2, self.layer3):
            features = stage(features)
        return features


class FeatureEncoder(Trunk):
    """Features of one image, to be correlated with the other's ('fnet')."""

    def __init__(self, config: RaftShape) -> None:
        super().__init__(config, "instance")
        self.conv2 = nn.Conv2d(config.trunk_widths[-1], config.feature_width, 1)

    def forward(self, images: Tensor) -> Tensor:
        """Encode images (B, 3, H, W) as features (B, feature_width, H / factor, W / factor)."""
        features: Tensor = self.conv2(self.trunk(images))
        return features


class ContextEncoder(Trunk):
    """Hidden state and context of up to three recurrent levels from the reference image ('cnet').

    All three levels exist regardless of the configuration, as in the checkpoints; what is not used
    is not computed.
    """

    def __init__(self, config: RaftShape) -> None:
        super().__init__(config, config.context_norm)
        norm, wide, width = config.context_norm, config.trunk_widths[-1], config.hidden_width
        self.n_levels = config.n_gru_layers
        self.layer4 = _stage(wide, wide, norm, 2)
        self.layer5 = _stage(wide, wide, norm, 2)
        self.outputs08 = nn.ModuleList(_head(wide, width, norm) for _ in ("hidden", "context"))
        self.outputs16 = nn.ModuleList(_head(wide, width, norm) for _ in ("hidden", "context"))
        self.outputs32 = nn.ModuleList(
            nn.Conv2d(wide, width, 3, padding=1) for _ in ("hidden", "context")
        )

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
    return nn.Sequential(
        ResidualBlock(width_in=width_in, width=width, normalise=normalise, stride=stride),
        ResidualBlock(width, width, normalise),
    )


def _head(width_in: int, width: int, norm: Norm) -> nn.Sequential:
    return nn.Sequential(
        ResidualBlock(width_in, width_in, normalisation(norm)),
        nn.Conv2d(width_in, width, 3, padding=1),
    )


def normalisation(norm: Norm) -> Callable[[int], nn.Module]:
    """Return the factory of a normalisation layer, which takes its number of channels."""
    return nn.BatchNorm2d if norm == "batch" else nn.InstanceNorm2d


class RaftStereo(nn.Module):
    """The network; parameters have the names of the published checkpoints.

    Args:
        volume_bytes: memory for the correlation volume, see `Correlation`.
    """

    def __init__(self, config: RaftShape, volume_bytes: int = VOLUME_BYTES) -> None:
        super().__init__()
        self.config = config
        self.volume_bytes = volume_bytes
        self.cnet = ContextEncoder(config)
        self.update_block = UpdateBlock(config)
        self.context_zqr_convs = nn.ModuleList(
            nn.Conv2d(config.hidden_width, 3 * config.hidden_width, 3, padding=1)
            for _ in range(config.n_gru_layers)
        )
        if config.shared_backbone:
            wide = config.trunk_widths[-1]
            self.conv2 = nn.Sequential(
                ResidualBlock(wide, wide, nn.InstanceNorm2d),
                nn.Conv2d(wide, config.feature_width, 3, padding=1),
            )
        else:
            self.fnet = FeatureEncoder(config)

    def forward(
        self, left: Tensor, right: Tensor, iterations: int, initial: Tensor | None = None
    ) -> tuple[list[Tensor], Tensor, tuple[Tensor, Tensor]]:
        """Return the flow after every iteration, and the features of both images, for training.

        Args:
            left: (B, 3, H, W), 0..255, H and W multiples of 32.
            initial: flow to start from, in cells, (B, 1, H / factor, W / factor); zero by default.

        Returns:
            Horizontal flow (negative disparity) in cells after each iteration, (B, 1, H / factor, W
            / factor) float32 each, the last one in pixels, (B, 1, H, W), and the features that were
            correlated, (B, C, H / factor, W / factor) each.
        """
        features = self.features(left, right)
        flows, weights = self.walk(*features, iterations, initial)
        return flows, upsample_convex(flows[-1], weights, self.config.factor), features[:2]

    @torch.inference_mode()
    def flow(
        self, left: Tensor, right: Tensor, iterations: int, initial: Tensor | None = None
    ) -> tuple[Tensor, Tensor]:
        """Return the last flow alone: in pixels, (B, 1, H, W), and in cells, (B, 1, H / factor, W /
        factor).

        Arguments as of `forward`; gradients are not kept and only the last flow is brought to full
        size.
        """
        flows, weights = self.walk(*self.features(left, right), iterations, initial)
        return upsample_convex(flows[-1], weights, self.config.factor), flows[-1]

    def features(
        self, left: Tensor, right: Tensor
    ) -> tuple[Tensor, Tensor, list[tuple[Tensor, Tensor]]]:
        """Return the features of both images, (B, C, h, w) each, and (hidden, context) of every
        level, finest first.
        """
        left, right = 2 * (left / 255) - 1, 2 * (right / 255) - 1
        if self.config.shared_backbone:
            trunk = self.cnet.trunk(torch.cat([left, right]))
            pairs = self.cnet.heads(trunk[: left.shape[0]])
            of_left, of_right = self.conv2(trunk).chunk(2)
        else:
            pairs = self.cnet.heads(self.cnet.trunk(left))
            of_left, of_right = self.fnet(torch.cat([left, right])).chunk(2)
        return (
            of_left,
            of_right,
            [(torch.tanh(hidden), torch.relu(context)) for hidden, context in pairs],
        )

    def walk(
        self,
        of_left: Tensor,
        of_right: Tensor,
        states: list[tuple[Tensor, Tensor]],
        iterations: int,
        initial: Tensor | None,
    ) -> tuple[list[Tensor], Tensor]:
        """Flow in cells after each iteration, and the weights that enlarge the last one to full
        size, see `raft_update.walk`.
        """
        return walk(
            self.update_block,
            self.context_zqr_convs,
            of_left,
            of_right,
            states,
            iterations,
            initial,
            self.volume_bytes,
        )
