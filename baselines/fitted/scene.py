"""Scenes as fits leave them on disk: Gaussians and their motion in one safetensors file, and how they are rendered."""

import json
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import Any

from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor

from ggvs_eval.baselines.fitted.motion import Motion, motion_of
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError, WeightsError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.gaussians import GaussianCloud, render_gaussians
from ggvs_eval.method import NEAR_M, Rendering
from ggvs_eval.scene_fitter import FittedScene, Footage

SCENE = "scene.safetensors"
NOTE = "scene"  # in the file's header: what it is, as JSON


def write_scene(path: Path, gaussians: dict[str, Tensor], motion: Motion, footage: Footage) -> None:
    """Write Gaussians and their motion whole or not at all."""
    tensors = {f"gaussians.{name}": tensor for name, tensor in gaussians.items()}
    tensors |= {f"motion.{name}": tensor for name, tensor in motion.state_dict().items()}
    notes = {
        "motion": motion.kind,
        "sizes": motion.sizes(),
        "first": footage.indices[0],
        "last": footage.indices[-1],
        "near": NEAR_M * footage.units_per_metre,
    }
    content = {name: tensor.detach().cpu().contiguous() for name, tensor in tensors.items()}
    write_bytes(path, save(content, {NOTE: json.dumps(notes)}))


class StoredScene:
    """Gaussians and their motion, read from a file.

    Args:
        path: what `write_scene` wrote.

    Attributes:
        gaussians: name -> a row per Gaussian.
        first, last: instants of the footage at the ends of the clip.
        near: Gaussians at or before this depth are not rendered, world units.
    """

    def __init__(self, path: Path, device: str = "cpu") -> None:
        notes = _notes(path)
        tensors = read_tensors(path, of="a fitted scene")
        place = compute_device(device)
        rows = {name.removeprefix("gaussians."): each for name, each in tensors.items() if name.startswith("gaussians.")}
        self.gaussians = {name: tensor.to(place) for name, tensor in rows.items()}
        self.motion = motion_of(notes["motion"], notes["sizes"])
        parameters = {name.removeprefix("motion."): tensor for name, tensor in tensors.items() if name.startswith("motion.")}
        load_strict(parameters, self.motion, path, "a fitted scene")
        self.motion.to(place)
        self.first, self.last, self.near = notes["first"], notes["last"], notes["near"]

    def cloud(self, index: int) -> GaussianCloud:
        """The Gaussians of an instant."""
        if not self.first <= index <= self.last:
            raise RenderError(f"fitted scene: wanted instants {self.first}..{self.last}, got {index}; fit these instants too")
        return self.motion.cloud(self.gaussians, (index - self.first) / max(1, self.last - self.first))


def _notes(path: Path) -> Any:
    try:
        with safe_open(path, "pt") as file:
            return json.loads((file.metadata() or {})[NOTE])
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise WeightsError(
            f"{path}: wanted a fitted scene, got {type(error).__name__} ({error}); delete it and fit again"
        ) from error


def render_cloud(cloud_of: Callable[[], GaussianCloud], target: Camera, near: float, device_name: str) -> Rendering:
    """Render what a function gives on a device, with the time of both."""
    device = compute_device(device_name)
    with rendering_on(device):
        started = perf_counter()
        cloud = cloud_of()
        moved = clock_s(device)
        picture = render_gaussians(cloud, target, near=near)
        image, depth = picture.image.clamp(max=1).numpy(force=True), picture.depth.numpy(force=True)
        seconds = {"motion": moved - started, "splat": clock_s(device) - moved}
    return Rendering(image, depth, seconds)


class MovingScene(FittedScene):
    """One cloud that moves through the whole clip."""

    def __init__(self, folder: Path, device: str) -> None:
        self._path, self._device = folder / SCENE, device
        self._scene = StoredScene(self._path, device)

    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant."""
        return render_cloud(lambda: self._scene.cloud(index), target, self._scene.near, self._device)

    @property
    def size_bytes(self) -> int:
        """Bytes of the file."""
        return self._path.stat().st_size
