"""How Gaussians move: by a deformation field (4DGS), along polynomials (Spacetime Gaussians), along lines (FreeTimeGS), not at all.

What a motion keeps per Gaussian stands beside the canonical properties under names of its own, and is thinned and split with
them; what all Gaussians share are the parameters of the module.
"""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Literal

import torch
from torch import Tensor, nn

from ggvs_eval.baselines.fitted.hexplane import DeformationNetwork
from ggvs_eval.baselines.fitted.points import Points
from ggvs_eval.gaussians.cloud import GaussianCloud

MotionName = Literal["hexplane", "polynomial", "linear"]
PLANE_RATE, LAYER_RATE = 5e-3, 5e-4  # of Adam, of a field's planes and of its layers


class Motion(nn.Module, ABC):
    """Canonical Gaussians and a time -> the Gaussians of that time.

    Attributes:
        rates: learning rate of each tensor that it keeps per Gaussian.
        lengths: which of them are lengths, whose rate counts in extents of the rig and falls with that of the means.
        has_coarse_stage: whether Gaussians are first fitted to all times together, without motion.
    """

    rates: Mapping[str, float] = {}
    lengths: tuple[str, ...] = ()
    has_coarse_stage = False

    def start(self, points: Points) -> dict[str, Tensor]:  # noqa: ARG002  # most keep something
        """What it keeps per Gaussian, when nothing moves yet."""
        return {}

    def shared_rate(self, name: str) -> float:  # noqa: ARG002  # most share nothing
        """Learning rate of a parameter that all Gaussians share."""
        return 0.0

    @abstractmethod
    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return the Gaussians at a time in [0, 1] of the clip."""

    def penalty(self) -> Tensor | float:
        """What is added to the loss for motion that is not smooth."""
        return 0.0


def canonical(gaussians: Mapping[str, Tensor]) -> GaussianCloud:
    """The Gaussians as they are kept."""
    sh = torch.cat([gaussians["sh_base"], gaussians["sh_rest"]], dim=1)
    names = ("means", "log_scales", "quaternions", "opacity_logits")
    return GaussianCloud(*(gaussians[name] for name in names), sh)


class NoMotion(Motion):
    """Gaussians of one instant."""

    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:  # noqa: ARG002
        """Return them as they are kept."""
        return canonical(gaussians)


class HexPlaneMotion(Motion):
    """Differences from a deformation field, added before activations: 4DGS.

    Args:
        network: the field.
        reach: what an output of 1 moves a Gaussian, world units.

    Reading:
        The heads give world units in the authors' files (reach 1). A field of our own counts in extents of the rig, so that a
        scene in millimetres is learned as fast as one in metres; the authors scale their learning rates instead.
    """

    has_coarse_stage = True

    def __init__(self, network: DeformationNetwork, reach: float = 1.0) -> None:
        super().__init__()
        self.network = network
        self.reach = reach

    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return canonical Gaussians plus what the field says of their places at that time."""
        moved = self.network(gaussians["means"], time)
        cloud = canonical(gaussians)
        values = cloud.parameters()
        values["means"] = cloud.means + self.reach * moved["pos"]
        if "scales" in moved:
            values["log_scales"] = cloud.log_scales + moved["scales"]
        if "rotations" in moved:
            values["quaternions"] = cloud.quaternions + moved["rotations"]
        if "opacity" in moved:
            values["opacity_logits"] = cloud.opacity_logits + moved["opacity"][:, 0]
        if "shs" in moved:
            values["sh"] = cloud.sh + moved["shs"].view(len(cloud), -1, 3)[:, : cloud.sh.shape[1]]
        return GaussianCloud(**values)

    def shared_rate(self, name: str) -> float:
        """Return the learning rate of planes, or that of layers."""
        return PLANE_RATE if ".grids." in name else LAYER_RATE

    def penalty(self) -> Tensor:
        """Return the penalty on planes that bend."""
        return self.network.smoothness()


class ExplicitMotion(Motion):
    """Each Gaussian by itself: a polynomial through its own time, and how long it is there.

    ``linear``: position mean + velocity dt, opacity times exp(-(dt / duration)^2 / 2), as FreeTimeGS (CVPR 2025) prints it.
    ``polynomial``: cubic position, quaternion + omega dt, opacity times exp(-(dt / duration)^2), as Spacetime Gaussians (CVPR
    2024). dt is the time from the Gaussian's own; both times count in clips.

    Args:
        name: which of both.

    Reading:
        Spacetime Gaussians lets no gradient of the polynomial reach the Gaussian's own time; FreeTimeGS says nothing of it, and
        has the same here. Of FreeTimeGS's penalty and relocation nothing is taken: one optimiser serves all motions.
    """

    def __init__(self, name: MotionName) -> None:
        super().__init__()
        self.is_linear = name == "linear"
        self.degree = 1 if self.is_linear else 3
        position_rate = 1.6e-4 * 3.5 * 0.5
        self.rates = {"velocities": 10 * position_rate, "times": 1e-4, "log_durations": 0.03}
        if not self.is_linear:
            self.rates = {**self.rates, "velocities": position_rate, "turns": 1e-4}
        self.lengths = ("velocities",)

    def start(self, points: Points) -> dict[str, Tensor]:
        """Return each point's own time and duration, and no velocity."""
        count = len(points.means)
        kept = {
            "velocities": torch.zeros(count, self.degree, 3),
            "times": points.times.clone(),
            "log_durations": points.durations.log(),
        }
        return kept if self.is_linear else {**kept, "turns": torch.zeros(count, 4)}

    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return the Gaussians where their polynomials are at that time, as opaque as they are then."""
        values = canonical(gaussians).parameters()
        away = time - gaussians["times"]  # (N,)
        ahead = away.detach()[:, None]
        for power in range(self.degree):
            values["means"] = values["means"] + gaussians["velocities"][:, power] * ahead ** (power + 1)
        if not self.is_linear:
            values["quaternions"] = values["quaternions"] + gaussians["turns"] * ahead
        fading = (away * torch.exp(-gaussians["log_durations"])) ** 2
        values["opacity_logits"] = faded(values["opacity_logits"], fading / 2 if self.is_linear else fading)
        return GaussianCloud(**values)


def faded(logits: Tensor, fading: Tensor) -> Tensor:
    """Logits of opacities sigmoid(logits) exp(-fading), both (N,).

    With p the opacity, logit(p e^-f) = l - f - log(1 - p e^-f) + log(1 - p), where 1 - p e^-f = (1 - p) + p (1 - e^-f).
    """
    opacity = torch.sigmoid(logits)
    return logits - fading - torch.log1p(-torch.expm1(-fading) * opacity * torch.exp(torch.nn.functional.softplus(logits)))
