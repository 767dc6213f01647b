"""State of a fit: a row per Gaussian, what all of them share, the optimiser's moments.

And its checkpoint.
"""

import io
import pickle
from pathlib import Path

import torch
from torch import Tensor

from ggvs_eval.baselines.fitted.points import Points
from ggvs_eval.baselines.fitted.scene import Motion
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.gaussians.cloud import GaussianCloud

Gaussians = dict[str, Tensor]  # name -> a row per Gaussian
SHARED = "shared."  # before the names of the motion's own parameters
OPACITY = 0.1  # at the start
EPSILON = 1e-15  # of Adam: gradients of single Gaussians are tiny
RATES = {  # of Adam; that of the means counts in extents of the rig
    "means": 1.6e-4,
    "log_scales": 5e-3,
    "quaternions": 1e-3,
    "opacity_logits": 0.05,
    "sh_base": 2.5e-3,
    "sh_rest": 2.5e-3 / 20,
}
MOMENTS = ("step", "exp_avg", "exp_avg_sq")  # what Adam keeps of a tensor


def first_gaussians(points: Points, degree: int, motion: Motion) -> Gaussians:
    """Round Gaussians at points, as large as the points are apart."""
    cloud = GaussianCloud.of_points(
        points.means, points.colours, scale=points.spacings(), opacity=OPACITY, degree=degree
    )
    values = cloud.parameters()
    sh = values.pop("sh")
    return {
        **values,
        "sh_base": sh[:, :1].clone(),
        "sh_rest": sh[:, 1:].clone(),
        **motion.start(points),
    }


def box_of(means: Tensor) -> Tensor:
    """Return the bounding box of points (N, 3), the larger corner first, (2, 3)."""
    return torch.stack([means.amax(dim=0), means.amin(dim=0)])


class FitState:
    """A fit between two steps.

    Args:
        learns_gaussians: whether they are learned, or only what the motion shares.

    Attributes:
        gaussians: name -> leaf tensor, a row per Gaussian.
        motion: how they move; its parameters are learned too.
        optimiser: Adam, with one group for each tensor, named.
        gradient_sum: norms of screen gradients since the last round of density control, in units of
            half the image, (N,).
        visits: views that have seen each Gaussian since then, (N,).
    """

    def __init__(
        self, gaussians: Gaussians, motion: Motion, *, learns_gaussians: bool = True
    ) -> None:
        self.gaussians = {
            name: tensor.detach().clone().requires_grad_(learns_gaussians)
            for name, tensor in gaussians.items()
        }
        self.motion = motion
        self.step = 0
        shared = {
            f"{SHARED}{name}": value
            for name, value in motion.named_parameters()
            if value.requires_grad
        }
        learned = (self.gaussians if learns_gaussians else {}) | shared
        groups = [{"name": name, "params": [tensor], "lr": 0.0} for name, tensor in learned.items()]
        self.optimiser = torch.optim.Adam(groups, eps=EPSILON, fused=True)
        self.forget_gradients()

    def __len__(self) -> int:
        """Return the number of Gaussians."""
        return len(self.gaussians["means"])

    def forget_gradients(self) -> None:
        """Begin a new round of density control."""
        self.gradient_sum = torch.zeros(len(self), device=self.gaussians["means"].device)
        self.visits = torch.zeros_like(self.gradient_sum)

    def take(self, rows: Tensor, fresh: Tensor) -> None:
        """Go on with some of the rows, in that order, which may come more than once.

        Args:
            rows: indices of Gaussians, (M,).
            fresh: whose moments begin at zero, (M,).
        """
        for group in self.optimiser.param_groups:
            name, old = group["name"], group["params"][0]
            if name not in self.gaussians:
                continue
            moments = self.optimiser.state.pop(old, {})
            new = old.detach()[rows].requires_grad_()
            for moment in ("exp_avg", "exp_avg_sq"):
                if moment in moments:
                    moments[moment] = moments[moment][rows]
                    moments[moment][fresh] = 0
            self.gaussians[name] = group["params"][0] = new
            if moments:
                self.optimiser.state[new] = moments
        self.forget_gradients()

    def write(self, path: Path) -> None:
        """Write a checkpoint whole or not at all."""
        moments = {
            group["name"]: {key: self.optimiser.state[parameter][key] for key in MOMENTS}
            for group in self.optimiser.param_groups
            for parameter in group["params"]
            if parameter in self.optimiser.state
        }
        values = {
            "step": self.step,
            "gaussians": {name: tensor.detach() for name, tensor in self.gaussians.items()},
            "motion": self.motion.state_dict(),
            "moments": moments,
            "gradient_sum": self.gradient_sum,
            "visits": self.visits,
        }
        buffer = io.BytesIO()
        torch.save(values, buffer)
        write_bytes(path, buffer.getvalue())

    @classmethod
    def read(cls, path: Path, motion: Motion, device: torch.device) -> "FitState":
        """Read a checkpoint."""
        try:
            values = torch.load(path, map_location=device, weights_only=True)
            motion.load_state_dict(values["motion"])
            state = cls(values["gaussians"], motion)
            for group in state.optimiser.param_groups:
                if group["name"] in values["moments"]:
                    state.optimiser.state[group["params"][0]] = values["moments"][group["name"]]
            state.step = int(values["step"])
            state.gradient_sum, state.visits = values["gradient_sum"], values["visits"]
        except (
            RuntimeError,
            KeyError,
            ValueError,
            TypeError,
            EOFError,
            AttributeError,
            pickle.UnpicklingError,
        ) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise TrainingError(
                f"{path}: wanted the state of this fit, got {reason}; move it away to restart the "
                f"fit"
            ) from error
        return state
