"""3DGS of each instant alone: the best that one instant gives, and nothing that ties it to the next
one.
"""

from dataclasses import dataclass
from pathlib import Path

import torch

from ggvs_eval.baselines.fitted.optimiser import GaussianFitter, Journal, clip_schedule, optimise
from ggvs_eval.baselines.fitted.points import initial_points
from ggvs_eval.baselines.fitted.scene import NoMotion, StoredScene, render_cloud, write_scene
from ggvs_eval.baselines.fitted.shots import Shots
from ggvs_eval.baselines.fitted.state import FitState, first_gaussians
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import compute_device, computing_on, one_thread
from ggvs_eval.method import Rendering
from ggvs_eval.scene_fitter import FittedScene, Footage, Progress

STATE = "state.pt"


def scene_file(folder: Path, index: int) -> Path:
    """Return the file of one instant."""
    return folder / f"{index:06d}.safetensors"


@dataclass(frozen=True)
class PerInstant(GaussianFitter):
    """3D Gaussian splatting (Kerbl et al. 2023) of one instant after the other.

    Works for a single one too.

    Attributes:
        steps: images that are looked at for each instant.
        points, most, degree, structure, save_every, device: as of `GaussianFitter`.

    Reading:
        Not as published: first points from estimated depth instead of structure from motion, fewer
        steps, spherical harmonics of degree 1, opacity never reset.
    """

    steps: int = 1000
    name = "3dgs-per-instant"
    look_ahead = "none"

    def __post_init__(self) -> None:
        """Refuse invalid options."""
        self.require_counts("steps")

    def fit(self, footage: Footage, folder: Path, progress: Progress) -> None:
        """Fit a cloud to each instant that has none yet."""
        device = compute_device(self.device)
        options = clip_schedule(self.steps, 0, self.most, self.structure, self.save_every)
        missing = [index for index in footage.indices if not scene_file(folder, index).is_file()]
        finished = len(footage.indices) - len(missing)
        for place, index in enumerate(missing):
            shots = Shots(footage, [index], folder, salt=index)
            with one_thread(), computing_on(device):
                state = fresh_or_stored(
                    footage, index, (self.points, self.degree), folder / STATE, device
                )
                begun = (finished + place) * self.steps
                journal = Journal(
                    folder=folder,
                    name="fit",
                    steps=len(footage.indices) * self.steps,
                    before=begun,
                    n_done=state.step,
                    progress=progress,
                )
                optimise(state, shots, options, journal, folder / STATE)
            write_scene(scene_file(folder, index), state.gaussians, state.motion, footage)
            (folder / STATE).unlink()
        Shots(footage, footage.indices, folder).remove_frames()

    def load(self, folder: Path) -> FittedScene:
        """Read back the clouds, each when it is rendered."""
        return InstantScenes(folder, self.device)


def fresh_or_stored(
    footage: Footage, index: int, cloud: tuple[int, int], checkpoint: Path, device: torch.device
) -> FitState:
    """The state of a killed fit to one instant, or a fresh one from its depth.

    `cloud` is how many points, of which degree.
    """
    if checkpoint.is_file():
        return FitState.read(checkpoint, NoMotion(), device)
    with torch.device("cpu"):
        gaussians = first_gaussians(
            initial_points(footage, [index], cloud[0]), cloud[1], NoMotion()
        )
    return FitState({name: tensor.to(device) for name, tensor in gaussians.items()}, NoMotion())


class InstantScenes(FittedScene):
    """A cloud per instant."""

    def __init__(self, folder: Path, device: str) -> None:
        self._folder, self._device = folder, device

    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant."""
        scene = StoredScene(scene_file(self._folder, index), self._device)
        return render_cloud(lambda: scene.cloud(index), target, scene.near, self._device)

    @property
    def size_bytes(self) -> int:
        """Bytes of all clouds."""
        return sum(path.stat().st_size for path in self._folder.glob("*.safetensors"))
