"""4DGS and its relatives: one cloud that moves through the clip, fitted to all instants
together.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import numpy as np
import torch

from ggvs_eval.baselines.fitted.hexplane import DeformationNetwork, compact
from ggvs_eval.baselines.fitted.optimiser import GaussianFitter, Journal, clip_schedule, optimise
from ggvs_eval.baselines.fitted.points import Points, initial_points
from ggvs_eval.baselines.fitted.scene import (
    SCENE,
    HexPlaneMotion,
    LinearMotion,
    Motion,
    MotionName,
    MovingScene,
    PolynomialMotion,
    write_scene,
)
from ggvs_eval.baselines.fitted.shots import Shots
from ggvs_eval.baselines.fitted.state import FitState, box_of, first_gaussians
from ggvs_eval.compute_device import compute_device, computing_on, one_thread
from ggvs_eval.errors import RenderError, did_you_mean
from ggvs_eval.scene_fitter import FittedScene, Footage, Progress

DEPTH_INSTANTS = 6  # whose depth gives the first points
STATE = "state.pt"


@dataclass(frozen=True)
class FourD(GaussianFitter):
    """4DGS (compact): canonical Gaussians and a HexPlane field, or an explicit motion of each
    Gaussian, from one optimiser.

    Attributes:
        motion: ``hexplane`` (4DGS), ``polynomial`` (Spacetime Gaussians, lite) or ``linear`` (as
            FreeTimeGS).
        steps: images that are looked at, a quarter of them without motion where a field moves the
            Gaussians.
        points, most, degree, structure, save_every, device: as of `GaussianFitter`.

    Reading:
        Not as published: first points from estimated depth; spherical harmonics of degree 1 from
        the first step on; a smaller field without a head for sizes; Adam continues through both
        stages; black background; one image per step; loss 0.8 L1 + 0.2 (1 - SSIM); explicit motions
        keep three colours, without the network of Spacetime Gaussians' full form.
    """

    motion: MotionName = "hexplane"
    steps: int = 8000
    name = "4dgs"
    look_ahead = "sequence"

    def __post_init__(self) -> None:
        """Refuse options that no fit could follow."""
        names = get_args(MotionName)
        if self.motion not in names:
            remedy = did_you_mean(self.motion, names)
            raise RenderError(
                f"4dgs: wanted a motion of {', '.join(names)}, got {self.motion!r}{remedy}"
            )
        self.require_counts("steps")

    def depth_indices(self, indices: range) -> Sequence[int]:
        """Return a few instants, spread over the clip."""
        return sorted(
            {
                indices[int(place)]
                for place in np.linspace(0, len(indices) - 1, DEPTH_INSTANTS).round()
            }
        )

    def fit(self, footage: Footage, folder: Path, progress: Progress) -> None:
        """Fit one cloud to the clip."""
        device = compute_device(self.device)
        shots = Shots(footage, footage.indices, folder)
        options = clip_schedule(
            self.steps, self.steps // 4, self.most, self.structure, self.save_every
        )
        with one_thread(), computing_on(device):
            state = self._state(footage, shots, folder / STATE, device)
            journal = Journal(
                folder=folder,
                name="fit",
                steps=self.steps,
                before=0,
                n_done=state.step,
                progress=progress,
            )
            optimise(state, shots, options, journal, folder / STATE)
        write_scene(folder / SCENE, state.gaussians, state.motion, footage)
        shots.remove_frames()

    def load(self, folder: Path) -> FittedScene:
        """Read back the cloud and its motion."""
        return MovingScene(folder, self.device)

    def _state(
        self, footage: Footage, shots: Shots, checkpoint: Path, device: torch.device
    ) -> FitState:
        if checkpoint.is_file():
            return FitState.read(
                checkpoint, self._motion(footage, shots, torch.zeros(2, 3)).to(device), device
            )
        with torch.device("cpu"):
            points = self._points(footage)
            motion = self._motion(footage, shots, box_of(points.means))
            gaussians = first_gaussians(points, self.degree, motion)
        return FitState(
            {name: tensor.to(device) for name, tensor in gaussians.items()}, motion.to(device)
        )

    def _points(self, footage: Footage) -> Points:
        """Return the first points.

        A cloud that a field moves is that of one instant, with the background of all.
        """
        indices = self.depth_indices(footage.indices)
        is_one_instant = self.motion == "hexplane" and len(indices) > 1
        points = initial_points(
            footage, indices, 2 * self.points if is_one_instant else self.points
        )
        if not is_one_instant:
            return points
        moving = points.times[~points.steady].unique()
        return (
            points.select(points.steady | (points.times == moving[len(moving) // 2]))
            if len(moving)
            else points
        )

    def _motion(self, footage: Footage, shots: Shots, box: torch.Tensor) -> Motion:
        if self.motion == "linear":
            return LinearMotion()
        if self.motion == "polynomial":
            return PolynomialMotion()
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(footage.seed)
            return HexPlaneMotion(
                DeformationNetwork(box, compact(len(footage.indices), self.degree)), shots.extent
            )
