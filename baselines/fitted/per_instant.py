"""3DGS of each instant alone: the best that one instant gives, and nothing that ties it to the next one."""

from pathlib import Path

import torch

from ggvs_eval.baselines.fitted.density import DensityOptions
from ggvs_eval.baselines.fitted.four_d import CloudOptions
from ggvs_eval.baselines.fitted.motion import NoMotion
from ggvs_eval.baselines.fitted.optimiser import Journal, OptimiserOptions, optimise
from ggvs_eval.baselines.fitted.points import initial_points
from ggvs_eval.baselines.fitted.scene import StoredScene, render_cloud, write_scene
from ggvs_eval.baselines.fitted.shots import Shots
from ggvs_eval.baselines.fitted.state import FitState, first_gaussians
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import compute_device, computing_on, one_thread
from ggvs_eval.method import Rendering
from ggvs_eval.scene_fitter import FittedScene, Footage, LookAhead, Progress, SceneFitter

STATE = "state.pt"


def instant_options(steps: int) -> OptimiserOptions:
    """Options of a fit to one instant: density control between a tenth and two thirds of the steps."""
    return OptimiserOptions(steps, density=DensityOptions(first=steps // 10, last=2 * steps // 3))


def scene_file(folder: Path, index: int) -> Path:
    """The file of one instant."""
    return folder / f"{index:06d}.safetensors"


class PerInstant(SceneFitter):
    """3D Gaussian splatting (Kerbl et al. 2023) of one instant after the other; works for a single one too.

    Args:
        options: how the optimiser runs at each instant.
        cloud: what it begins with.

    Reading:
        Not as published: first points from estimated depth instead of structure from motion, fewer steps, spherical harmonics of
        degree 1, opacity never reset.
    """

    name = "3dgs-per-instant"
    look_ahead: LookAhead = "none"

    def __init__(self, options: OptimiserOptions | None = None, cloud: CloudOptions | None = None) -> None:
        self.options = options or instant_options(1000)
        self.cloud = cloud or CloudOptions()

    def fit(self, footage: Footage, folder: Path, progress: Progress) -> None:
        """Fit a cloud to each instant that has none yet."""
        device = compute_device("auto")
        missing = [index for index in footage.indices if not scene_file(folder, index).is_file()]
        finished = len(footage.indices) - len(missing)
        for place, index in enumerate(missing):
            shots = Shots(footage, [index], folder, salt=index)
            with one_thread(), computing_on(device):
                state = fresh_or_stored(footage, index, self.cloud, folder / STATE, device)
                begun = (finished + place) * self.options.steps
                journal = Journal(folder, "fit", len(footage.indices) * self.options.steps, begun, state.step, progress)
                optimise(state, shots, self.options, journal, folder / STATE)
            write_scene(scene_file(folder, index), state.gaussians, state.motion, footage)
            (folder / STATE).unlink()
        Shots(footage, footage.indices, folder).remove_frames()

    def load(self, folder: Path) -> FittedScene:
        """Read back the clouds, each when it is rendered."""
        return InstantScenes(folder)


def fresh_or_stored(footage: Footage, index: int, cloud: CloudOptions, checkpoint: Path, device: torch.device) -> FitState:
    """The state of a killed fit to one instant, or a fresh one from that instant's depth."""
    if checkpoint.is_file():
        return FitState.read(checkpoint, NoMotion(), device)
    with torch.device("cpu"):
        gaussians = first_gaussians(initial_points(footage, [index], cloud.points), cloud.degree, NoMotion())
    return FitState({name: tensor.to(device) for name, tensor in gaussians.items()}, NoMotion())


class InstantScenes(FittedScene):
    """A cloud per instant; `folder` is that of the fit."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant."""
        scene = StoredScene(scene_file(self._folder, index))
        return render_cloud(lambda: scene.cloud(index), target, scene.near)

    @property
    def size_bytes(self) -> int:
        """Bytes of all clouds."""
        return sum(path.stat().st_size for path in self._folder.glob("*.safetensors"))
