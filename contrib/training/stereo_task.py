"""Training task of the compact RAFT-Stereo: pairs of procedural rooms, started from zero or from
semi-global matching.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import cv2
import numpy as np
import torch
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.arrays import Map
from ggvs_eval.contrib.training.stereo_pairs import StereoSample, stereo_sample
from ggvs_eval.contrib.training.task import Schedule
from ggvs_eval.pipelines.offline.stereo.raft_matcher import start_from_matching
from ggvs_eval.pipelines.offline.stereo.raft_stereo import RaftStereo
from ggvs_eval.raft_config import COMPACT, RaftShape


def sequence_loss(
    flows: Sequence[Tensor],
    last: Tensor,
    truth: Tensor,
    decay: float = 0.9,
    largest_px: float = 700.0,
) -> Tensor:
    """Return the mean absolute error of every iteration's flow, later ones weighing more
    (RAFT-Stereo, section 3.4).

    Args:
        flows: after each of n iterations, in cells, (B, 1, h, w).
        last: the last one at full size, in pixels, (B, 1, H, W).
        truth: (B, 1, H, W), pixels.
        decay: weight of iteration i is decay**(15 / (n - 1) * (n - 1 - i)): the first one counts
            the same for any n.

    Reading:
        The authors enlarge every iteration to full size; earlier ones count at their cells here, at
        a third less time a step.
    """
    factor = last.shape[-1] // flows[0].shape[-1]
    step, n = decay ** (15 / max(1, len(flows) - 1)), len(flows)
    at_cells = truth[..., ::factor, ::factor]
    errors = [factor * flow - at_cells for flow in flows[:-1]]
    weighted = [
        step ** (n - 1 - i) * _mean_absolute(error, at_cells, largest_px)
        for i, error in enumerate(errors)
    ]
    return torch.stack([*weighted, _mean_absolute(last - truth, truth, largest_px)]).sum()


def _mean_absolute(error: Tensor, truth: Tensor, largest_px: float) -> Tensor:
    return error.abs()[truth.abs() < largest_px].mean()


def matching_loss(
    left: Tensor, right: Tensor, disparity: Tensor, visible: Tensor, factor: int
) -> Tensor:
    """Cross entropy of the match that correlation alone would choose on the row, over cells whose
    match is seen.

    RAFT-Stereo trains its features through the recurrent unit alone, which takes many more steps
    than are available here.

    Args:
        left: features, (B, C, h, w), float32.
        disparity: exact, (B, H, W), pixels.
        visible: which matches the right image shows, (B, H, W).
        factor: pixels per cell; features of a cell are centred on its first pixel.
    """
    logits = torch.einsum("bchw,bchv->bhwv", left, right) * left.shape[1] ** -0.5
    coarse = disparity[:, ::factor, ::factor] / factor
    width = coarse.shape[-1]
    column = torch.arange(width, device=left.device) - coarse  # (B, h, w)
    below = column.floor()
    share = column - below
    counted = visible[:, ::factor, ::factor] & (below >= 0) & (below < width - 1)
    index = below.clamp(0, width - 2).long()[..., None]
    chances = functional.log_softmax(logits, dim=-1)
    chance = (1 - share) * chances.gather(-1, index)[..., 0] + share * chances.gather(
        -1, index + 1
    )[..., 0]
    return -(chance * counted).sum() / counted.sum().clamp(min=1)


VALIDATION_SEED = 2**40  # and above; training seeds stay below
# of weights that have learned already
FINE_TUNING = Schedule(learning_rate=1.5e-4, warm_up=30, cool_down=0.5)


@dataclass(frozen=True)
class StereoTask:
    """The training of RAFT-Stereo.

    Attributes:
        seed: of the weights and the pairs.
        width: of the crops, pixels, a multiple of 32.
        started: share of the pairs that start from semi-global matching; as many again as remain,
            halved, start from nothing and from a displaced truth, as a previous frame's disparity
            would be.
        matching_weight: of the loss on the features themselves.
        schedule: see `Schedule`.
    """

    config: RaftShape = COMPACT
    seed: int = 0
    width: int = 384
    height: int = 256
    batch_size: int = 2
    iterations: int = 4
    started: float = 0.6
    matching_weight: float = 0.2
    validation_pairs: int = 12
    schedule: Schedule = field(default_factory=Schedule)

    @property
    def name(self) -> str:
        """Names the weights."""
        return "raft-compact"

    @property
    def summary(self) -> str:
        """Sentence of the model card on the network."""
        return "The training of RAFT-Stereo."

    @property
    def data(self) -> str:
        """Sentence of the model card on the training data."""
        return (
            "pairs of procedural rooms and gardens (contrib/training), generated on the fly, "
            "each used once; no real data"
        )

    @property
    def evaluated_on(self) -> str:
        """Sentence of the model card on the measures of `validate`."""
        return (
            f"{self.validation_pairs} pairs of 512x320 of separate scenes, every pixel, occluded "
            "ones included: end-point error and share of pixels off by more than 1 and 3 px, from "
            "semi-global matching (8 iterations), `zero_` from nothing (24), and `start_` the "
            "semi-global matching itself, gaps filled."
        )

    @property
    def step_pixels(self) -> int:
        """Pixels of left images that a step learns from."""
        return self.batch_size * self.width * self.height

    def network(self) -> nn.Module:
        """Return a fresh network."""
        torch.manual_seed(self.seed)
        return RaftStereo(self.config)

    def settle(self, network: nn.Module) -> None:
        """Nothing: the network normalises by no statistics of a batch."""

    def batch(self, step: int) -> dict[str, Tensor]:
        """left, right (B, 3, H, W), disparity and visible (B, H, W), initial flow (B, 1, h, w)."""
        first = (self.seed * 10**9 + step) * self.batch_size
        samples = [
            stereo_sample(first + index, self.width, self.height)
            for index in range(self.batch_size)
        ]
        starts = [
            self._start(sample, np.random.default_rng(first + index))
            for index, sample in enumerate(samples)
        ]
        return {
            "left": _images([sample.left for sample in samples]),
            "right": _images([sample.right for sample in samples]),
            "disparity": torch.as_tensor(np.stack([sample.disparity for sample in samples])),
            "visible": torch.as_tensor(np.stack([sample.visible for sample in samples])),
            "initial": torch.as_tensor(np.stack(starts))[:, None],
        }

    def loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, Mapping[str, float]]:
        """Return the error of every iteration's flow, and of the match that the features alone
        would choose.
        """
        assert isinstance(network, RaftStereo)
        flows, last, (left, right) = network(
            batch["left"], batch["right"], self.iterations, batch["initial"]
        )
        truth = -batch["disparity"][:, None]
        of_flow = sequence_loss(flows, last, truth)
        of_features = matching_loss(
            left.float(), right.float(), batch["disparity"], batch["visible"], self.config.factor
        )
        error = (last.detach() - truth).abs()
        figures = {
            "epe_px": float(error.mean()),
            "bad3": float((error > 3).float().mean()),
            "matching": float(of_features.detach()),
        }
        return of_flow + self.matching_weight * of_features, figures

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Errors on pairs of separate scenes, from semi-global matching, and from nothing with
        three times the iterations.
        """
        assert isinstance(network, RaftStereo)
        figures = {
            "epe_px": 0.0,
            "bad1": 0.0,
            "bad3": 0.0,
            "zero_epe_px": 0.0,
            "zero_bad3": 0.0,
            "start_epe_px": 0.0,
            "start_bad3": 0.0,
        }
        for index in range(self.validation_pairs):
            sample = stereo_sample(VALIDATION_SEED + index, 512, 320)
            truth = torch.as_tensor(-sample.disparity)[None, None]
            left, right = _images([sample.left]), _images([sample.right])
            start = start_from_matching(
                sample.left, sample.right, 0, _range(sample), self.config.factor
            )
            initial = torch.as_tensor(start)[None, None]
            errors = {
                "": (network.flow(left, right, 8, initial)[0] - truth).abs(),
                "zero_": (network.flow(left, right, 24)[0] - truth).abs(),
                "start_": (
                    functional.interpolate(initial, truth.shape[2:]) * self.config.factor - truth
                ).abs(),
            }
            for prefix, error in errors.items():
                for name, value in {
                    "epe_px": error.mean(),
                    "bad1": (error > 1).float().mean(),
                    "bad3": (error > 3).float().mean(),
                }.items():
                    if f"{prefix}{name}" in figures:
                        figures[f"{prefix}{name}"] += float(value) / self.validation_pairs
        return figures

    def _start(self, sample: StereoSample, rng: np.random.Generator) -> Map:
        """Return the initial flow in cells, (h, w)."""
        kind = rng.uniform()
        height, width = (size // self.config.factor for size in (self.height, self.width))
        if kind < self.started:
            return start_from_matching(
                sample.left, sample.right, 0, _range(sample), self.config.factor
            )
        if kind < (1 + self.started) / 2:
            return np.zeros((height, width), np.float32)
        shift = rng.uniform(-8, 8, 2)  # what moved since the frame before
        moved = cv2.warpAffine(
            sample.disparity,
            np.array([[1, 0, shift[0]], [0, 1, shift[1]]]),
            (self.width, self.height),
            borderMode=cv2.BORDER_REPLICATE,
        )
        coarse = cv2.resize(moved, (width, height), interpolation=cv2.INTER_NEAREST)
        return np.asarray(
            -(coarse * rng.normal(1, 0.02) + rng.normal(0, 1)) / self.config.factor, np.float32
        )


def _range(sample: StereoSample) -> int:
    """Return the disparity that a pairing of cameras with known depth range would search up to,
    with a margin.
    """
    return int(sample.disparity.max() * 1.15) + 2


def _images(images: list[np.ndarray]) -> Tensor:
    return torch.as_tensor(np.stack(images)).permute(0, 3, 1, 2).float()
