"""3DGStream (Sun et al., CVPR 2024): the cloud of the previous instant is moved by a small field,
and a few Gaussians are added.

Online, with seconds of fitting per instant: the middle between a method that is shown an instant
once and one that is given all.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from ggvs_eval.baselines.fitted.optimiser import (
    DensitySchedule,
    FitSchedule,
    GaussianFitter,
    Journal,
    clip_schedule,
    optimise,
    rotated,
)
from ggvs_eval.baselines.fitted.per_instant import STATE, fresh_or_stored, scene_file
from ggvs_eval.baselines.fitted.scene import (
    Backdrop,
    StoredScene,
    TransformationMotion,
    canonical,
    render_cloud,
    write_scene,
)
from ggvs_eval.baselines.fitted.shots import Shots
from ggvs_eval.baselines.fitted.state import OPACITY, FitState, Gaussians, box_of
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import compute_device, computing_on, one_thread
from ggvs_eval.gaussians import GaussianCloud
from ggvs_eval.method import Rendering
from ggvs_eval.scene_fitter import FittedScene, Footage, Progress

RATE = 15.0  # times the learning rates, for Gaussians that were added
# mean norm of the screen gradient, in units of half the image, from which on a Gaussian spawns
# another
GRADIENT = 1.5e-4


@dataclass(frozen=True)
class Stream(GaussianFitter):
    """3DGStream: the first instant as 3D Gaussian splatting, each later one from the one before it.

    Attributes:
        steps: images that are looked at for the first instant.
        transforming: for each later one, while the field learns how the Gaussians move; as
            published.
        spawning: for each later one, while Gaussians that were added learn; as published.
        spawned: Gaussians added at most.
        points, most, degree, structure, save_every, device: as of `GaussianFitter`.

    Reading:
        Not as published: first points from estimated depth, a field of three dense planes at two
        resolutions instead of hash grids (the same at the size of a room, and without
        tiny-cuda-nn), its box that of all Gaussians instead of set by hand, and spherical harmonics
        that do not turn with their Gaussians.
    """

    steps: int = 3000
    transforming: int = 150
    spawning: int = 100
    spawned: int = 4000
    name = "3dgstream"
    look_ahead = "past"

    def __post_init__(self) -> None:
        """Refuse options that no fit could follow."""
        self.require_counts("steps", "transforming", "spawning", "spawned")

    def depth_indices(self, indices: range) -> Sequence[int]:
        """Return the first instant alone."""
        return indices[:1]

    def fit(self, footage: Footage, folder: Path, progress: Progress) -> None:
        """Fit the first instant, then each later one to what the one before has left.

        An instant that was cut off begins anew.
        """
        device = compute_device(self.device)
        with one_thread(), computing_on(device):
            for place, index in enumerate(footage.indices):
                if scene_file(folder, index).is_file():
                    continue
                if place == 0:
                    self._fit_first(footage, folder, progress, device)
                else:
                    self._fit_next(footage, folder, index, progress, device)
        Shots(footage, footage.indices, folder).remove_frames()

    def load(self, folder: Path) -> FittedScene:
        """Read back the first cloud and what happens to it."""
        return StreamedScene(folder, self.device)

    def _steps(self, instants: int) -> int:
        """Return the steps of N instants together."""
        return self.steps + (instants - 1) * (self.transforming + self.spawning)

    def _journal(
        self, footage: Footage, folder: Path, before: int, n_done: int, progress: Progress
    ) -> Journal:
        return Journal(
            folder=folder,
            name="fit",
            steps=self._steps(len(footage.indices)),
            before=before,
            n_done=n_done,
            progress=progress,
        )

    def _fit_first(
        self, footage: Footage, folder: Path, progress: Progress, device: torch.device
    ) -> None:
        index = footage.indices[0]
        state = fresh_or_stored(footage, index, (self.points, self.degree), folder / STATE, device)
        journal = self._journal(footage, folder, 0, state.step, progress)
        options = clip_schedule(self.steps, 0, self.most, self.structure, self.save_every)
        optimise(
            state, Shots(footage, [index], folder, salt=index), options, journal, folder / STATE
        )
        write_scene(scene_file(folder, index), state.gaussians, state.motion, footage)
        (folder / STATE).unlink()

    def _fit_next(
        self, footage: Footage, folder: Path, index: int, progress: Progress, device: torch.device
    ) -> None:
        shots = Shots(footage, [index], folder, salt=index)
        base = StreamedScene(folder, self.device).moved(index - 1)
        before = self._steps(index - footage.indices[0])
        journal = self._journal(footage, folder, before, 0, progress)
        field = TransformationMotion(box_of(base["means"]), shots.extent, footage.seed).to(device)
        moving = FitState(base, field, learns_gaussians=False)
        transforming = FitSchedule(
            self.transforming, density=None, structure=self.structure, measure_every=0
        )
        optimise(moving, shots, transforming, journal, None)
        with torch.no_grad():
            base = field.moved(base)
        added = self._spawned(base, moving, footage.seed + index)
        later = self._journal(footage, folder, before + self.transforming, 0, progress)
        state = FitState(added, Backdrop(base))
        density = DensitySchedule(
            every=20,
            first=20,
            last=self.spawning - 20,
            gradient=GRADIENT,
            least_opacity=0.01,
            most=self.spawned,
        )
        spawning = FitSchedule(
            self.spawning, rate=RATE, density=density, structure=self.structure, measure_every=0
        )
        optimise(state, shots, spawning, later, None)
        later.measure(state, shots)
        write_scene(scene_file(folder, index), state.gaussians, field, footage)

    def _spawned(self, base: Gaussians, moving: FitState, seed: int) -> Gaussians:
        """Return the Gaussians next to those with a large image gradient, faint at first."""
        pull = moving.gradient_sum / moving.visits.clamp(min=1)
        rows = torch.sort(pull, descending=True, stable=True).indices[: self.spawned]
        rows = rows[pull[rows] > GRADIENT]
        noise = np.random.default_rng(seed).standard_normal((len(rows), 3), dtype=np.float32)
        added = {name: tensor[rows].clone() for name, tensor in base.items()}
        added["means"] += rotated(
            added["quaternions"], torch.as_tensor(noise) * added["log_scales"].exp()
        )
        added["opacity_logits"].fill_(float(np.log(OPACITY / (1 - OPACITY))))
        return added


class StreamedScene(FittedScene):
    """The cloud of the first instant, and a field and a few Gaussians for each later one.

    Instants are made one after the other; asked for in that order, each costs one field.
    """

    def __init__(self, folder: Path, device: str) -> None:
        self._folder, self._device = folder, device
        self._instant: tuple[int, Gaussians] | None = None

    def moved(self, index: int) -> Gaussians:
        """Return the first instant's Gaussians where they are at another one."""
        first = int(min(self._folder.glob("*.safetensors")).stem)
        at, gaussians = self._instant or (first, {})
        if not gaussians or at > index:
            at, gaussians = (
                first,
                StoredScene(scene_file(self._folder, first), self._device).gaussians,
            )
        with torch.no_grad():
            for later in range(at + 1, index + 1):
                field = StoredScene(scene_file(self._folder, later), self._device).motion
                assert isinstance(field, TransformationMotion)
                gaussians = field.moved(gaussians)
        self._instant = index, gaussians
        return gaussians

    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant."""
        scene = StoredScene(scene_file(self._folder, index), self._device)

        def cloud() -> GaussianCloud:
            moved = self.moved(index)
            return (
                canonical(moved)
                if scene.motion.kind == "none"
                else Backdrop(moved).cloud(scene.gaussians, 0.0)
            )

        return render_cloud(cloud, target, scene.near, self._device)

    @property
    def size_bytes(self) -> int:
        """Bytes of the first cloud and of all that follows."""
        return sum(path.stat().st_size for path in self._folder.glob("*.safetensors"))
