"""Scenes as fits leave them on disk, Gaussians and their motion in one safetensors file, and how
they are rendered.

Motion is by a field (4DGS), along polynomials (Spacetime Gaussians), along lines (FreeTimeGS), or
none.

What a motion keeps per Gaussian is stored with the canonical properties under other names, and
thinned and split with them; what all Gaussians share are the parameters of the module.
"""

import json
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from time import perf_counter
from types import MappingProxyType
from typing import Any, ClassVar, Literal

import torch
from safetensors import SafetensorError, safe_open
from safetensors.torch import save
from torch import Tensor, nn

from ggvs_eval.baselines.fitted.hexplane import (
    DeformationNetwork,
    FieldConfiguration,
    PlaneGrid,
    field_outputs,
    linear,
)
from ggvs_eval.baselines.fitted.points import Points
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.errors import RenderError, WeightsError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.gaussians import GaussianCloud, render_gaussians
from ggvs_eval.method import NEAR_M, Rendering
from ggvs_eval.scene_fitter import FittedScene, Footage

MotionName = Literal["hexplane", "polynomial", "linear"]
# of Adam, extents per clip: of Spacetime Gaussians, by its rate of positions
VELOCITY_RATE = 1.6e-4 * 3.5 * 0.5
# of Adam, of a field's planes and of its layers: the authors' for a rig of 6 units
PLANE_RATE, LAYER_RATE = 1e-2, 1e-3
# the same of a step between two instants; that of the layers as published
STEP_PLANE_RATE, STEP_LAYER_RATE = 0.1, 2e-3
SCENE = "scene.safetensors"
NOTE = "scene"  # in the file's header: what it is, as JSON


class Motion(nn.Module, ABC):
    """Canonical Gaussians and a time -> the Gaussians of that time.

    Attributes:
        rates: learning rate of each tensor that it keeps per Gaussian.
        lengths: which of them are lengths, whose rate counts in extents of the rig and falls with
            that of the means.
        has_coarse_stage: whether Gaussians are first fitted to all times together, without motion.
    """

    kind: ClassVar[str]
    rates: Mapping[str, float] = MappingProxyType({})
    lengths: tuple[str, ...] = ()
    has_coarse_stage = False

    def start(self, points: Points) -> dict[str, Tensor]:  # most keep something
        """Return the parameters per Gaussian when nothing moves yet."""
        return {}

    def shared_rate(self, name: str) -> float:  # most share nothing
        """Return the learning rate of a parameter that all Gaussians share."""
        return 0.0

    @abstractmethod
    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return the Gaussians at a time in [0, 1] of the clip."""

    def sizes(self) -> dict[str, Any]:
        """Return the settings by which `motion_of` makes one that takes its parameters."""
        return {}

    def penalty(self) -> Tensor | float:
        """Return the penalty on motion that is not smooth."""
        return 0.0


def canonical(gaussians: Mapping[str, Tensor]) -> GaussianCloud:
    """Return the Gaussians as they are kept."""
    names = ("means", "log_scales", "quaternions", "opacity_logits")
    return GaussianCloud(
        **{name: gaussians[name] for name in names},
        sh=torch.cat([gaussians["sh_base"], gaussians["sh_rest"]], dim=1),
    )


class NoMotion(Motion):
    """Gaussians of one instant."""

    kind = "none"

    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return them as they are kept."""
        return canonical(gaussians)


class HexPlaneMotion(Motion):
    """Differences from a deformation field, added before activations: 4DGS.

    Args:
        reach: what an output of 1 moves a Gaussian, world units.

    Reading:
        The heads give world units in the authors' files (reach 1). A field fitted here counts in
        extents of the rig, so that a scene in millimetres is learned as fast as one in metres; the
        authors scale their learning rates instead.
    """

    kind = "hexplane"
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

    def sizes(self) -> dict[str, Any]:
        """Return the field's configuration and the reach."""
        return {"reach": self.reach, "field": asdict(self.network.configuration)}

    def penalty(self) -> Tensor:
        """Return the penalty on planes that bend."""
        return self.network.smoothness()


class ExplicitMotion(Motion):
    """Motion of each Gaussian alone: a polynomial around its own time, and its duration.

    dt is the time from the Gaussian's own; both count in clips.

    Reading:
        Spacetime Gaussians lets no gradient of the polynomial reach the Gaussian's own time;
        FreeTimeGS says nothing of it, and has the same here. Of FreeTimeGS's penalty and relocation
        nothing is taken: one optimiser serves all motions.
    """

    degree: ClassVar[int]
    steepness: ClassVar[float]  # of the fading, in front of (dt / duration)^2
    lengths = ("velocities",)

    def start(self, points: Points) -> dict[str, Tensor]:
        """Return each point's own time and duration, and no velocity."""
        count = len(points.means)
        velocities = torch.zeros(count, self.degree, 3)
        return {
            "velocities": velocities,
            "times": points.times.clone(),
            "log_durations": points.durations.log(),
        }

    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return the Gaussians where their polynomials are at that time, as opaque as they are
        then.
        """
        values = canonical(gaussians).parameters()
        away = time - gaussians["times"]  # (N,)
        ahead = away.detach()[:, None]
        for power in range(self.degree):
            values["means"] = values["means"] + gaussians["velocities"][:, power] * ahead ** (
                power + 1
            )
        if "turns" in gaussians:
            values["quaternions"] = values["quaternions"] + gaussians["turns"] * ahead
        fading = self.steepness * (away * torch.exp(-gaussians["log_durations"])) ** 2
        values["opacity_logits"] = faded(values["opacity_logits"], fading)
        return GaussianCloud(**values)


class LinearMotion(ExplicitMotion):
    """Position mean + velocity dt, opacity times exp(-(dt / duration)^2 / 2), as FreeTimeGS (CVPR
    2025) prints them.
    """

    kind = "linear"
    degree, steepness = 1, 0.5
    rates = MappingProxyType(
        {"velocities": 20 * VELOCITY_RATE, "times": 1e-4, "log_durations": 0.03}
    )


class PolynomialMotion(ExplicitMotion):
    """Cubic position, quaternion + turn dt, opacity times exp(-(dt / duration)^2): Spacetime
    Gaussians (CVPR 2024), lite form.
    """

    kind = "polynomial"
    degree, steepness = 3, 1.0
    rates = MappingProxyType(
        {"velocities": VELOCITY_RATE, "times": 1e-4, "log_durations": 0.03, "turns": 1e-4}
    )

    def start(self, points: Points) -> dict[str, Tensor]:
        """Return what lines keep, and no turn."""
        return {**super().start(points), "turns": torch.zeros(len(points.means), 4)}


class TransformationMotion(Motion):
    """A small step of all Gaussians, from one instant to the next: 3DGStream's transformation cache
    as three dense planes.

    Args:
        box: what the planes span, (2, 3), the larger corner first.
        reach: what an output of 1 moves a Gaussian, world units.

    Reading:
        The authors' hash tables begin near zero, where their rate of 2e-3 soon makes neighbours
        differ. Planes begin at 0.1 to 0.5: at that rate 150 steps move them all alike, and anyone
        who walks stays behind a little more in every frame. In a validation room (demo seed 31,
        grid, a held-out camera) moving pixels of the third frame have 21.9 dB with 2e-3, 27.2 with
        0.02, 28.4 with 0.05, 28.7 with 0.1 and 28.8 with 0.2; without a field 19.1 in the first.
    """

    kind = "transformation"
    CONFIGURATION = FieldConfiguration(
        levels=(64, 128), time_nodes=1, channels=8, width=64, heads=()
    )

    def __init__(self, box: Tensor, reach: float, seed: int) -> None:
        super().__init__()
        self.reach = reach
        with torch.random.fork_rng(devices=[]), torch.device("cpu"):
            torch.manual_seed(seed)
            self.grid = PlaneGrid(box.cpu(), self.CONFIGURATION, axes=((0, 1), (0, 2), (1, 2)))
            width = self.CONFIGURATION.width
            features = len(self.CONFIGURATION.levels) * self.CONFIGURATION.channels
            last = linear(width, 7)
            nn.init.zeros_(last.weight)
            self.layers = nn.Sequential(
                linear(features, width), nn.ReLU(), linear(width, width), nn.ReLU(), last
            )

    def shared_rate(self, name: str) -> float:
        """Return the learning rate of planes, or that of layers."""
        return STEP_PLANE_RATE if ".grids." in name else STEP_LAYER_RATE

    def moved(self, gaussians: Mapping[str, Tensor]) -> dict[str, Tensor]:
        """Return the Gaussians after the step: places shifted, axes turned.

        Colours stay with the world.
        """
        (moved,) = field_outputs(self.grid, self.layers[0], [self.layers[1:]], gaussians["means"])
        shift, turn = moved.split([3, 4], dim=1)
        turn = turn + torch.tensor([1.0, 0.0, 0.0, 0.0])
        places, axes = (
            gaussians["means"] + self.reach * shift,
            quaternion_product(turn, gaussians["quaternions"]),
        )
        return {**gaussians, "means": places, "quaternions": axes}

    # has one instant
    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return the Gaussians after the step."""
        return canonical(self.moved(gaussians))

    def sizes(self) -> dict[str, Any]:
        """Return the reach."""
        return {"reach": self.reach}


class Backdrop(Motion):
    """Return Gaussians together with others that are not learned."""

    kind = "backdrop"

    def __init__(self, tensors: Mapping[str, Tensor]) -> None:
        super().__init__()
        self._others = tensors

    # has one instant
    def cloud(self, gaussians: Mapping[str, Tensor], time: float) -> GaussianCloud:
        """Return both; those that are learned come first."""
        return canonical(
            {name: torch.cat([tensor, self._others[name]]) for name, tensor in gaussians.items()}
        )


def quaternion_product(left: Tensor, right: Tensor) -> Tensor:
    """Return the rotation of the left after that of the right, w first, (N, 4) each."""
    a, u, b, v = left[:, :1], left[:, 1:], right[:, :1], right[:, 1:]
    scalar = a * b - (u * v).sum(dim=1, keepdim=True)
    return torch.cat([scalar, a * v + b * u + torch.linalg.cross(u, v, dim=1)], dim=1)


def motion_of(kind: str, sizes: Mapping[str, Any]) -> Motion:
    """Return a motion of a kind, with parameters that are to be replaced by those of a file."""
    if kind == HexPlaneMotion.kind:
        field = sizes["field"]
        field |= {"levels": tuple(field["levels"]), "heads": tuple(field["heads"])}
        return HexPlaneMotion(
            DeformationNetwork(torch.zeros(2, 3), FieldConfiguration(**field)), sizes["reach"]
        )
    if kind == TransformationMotion.kind:
        return TransformationMotion(torch.zeros(2, 3), sizes["reach"], seed=0)
    return {motion.kind: motion for motion in (NoMotion, LinearMotion, PolynomialMotion)}[kind]()


def faded(logits: Tensor, fading: Tensor) -> Tensor:
    """Return the logits of opacities sigmoid(logits) exp(-fading), both (N,).

    With p the opacity, 1 - p e^-f = (1 - p) (1 + (1 - e^-f) p / (1 - p)), where p / (1 - p) =
    e^logit.
    """
    return logits - fading - torch.log1p(-torch.expm1(-fading) * torch.exp(logits))


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
        tensors = read_tensors(path, model="a fitted scene")
        place = compute_device(device)
        rows = {
            name.removeprefix("gaussians."): tensor
            for name, tensor in tensors.items()
            if name.startswith("gaussians.")
        }
        self.gaussians = {name: tensor.to(place) for name, tensor in rows.items()}
        self.motion = motion_of(notes["motion"], notes["sizes"])
        parameters = {
            name.removeprefix("motion."): tensor
            for name, tensor in tensors.items()
            if name.startswith("motion.")
        }
        load_strict(parameters, self.motion, path, "a fitted scene")
        self.motion.to(place)
        self.first, self.last, self.near = notes["first"], notes["last"], notes["near"]

    def cloud(self, index: int) -> GaussianCloud:
        """Return the Gaussians of an instant."""
        if not self.first <= index <= self.last:
            raise RenderError(
                f"fitted scene: wanted instants {self.first}..{self.last}, got {index}; fit these "
                f"instants too"
            )
        return self.motion.cloud(
            self.gaussians, (index - self.first) / max(1, self.last - self.first)
        )


def _notes(path: Path) -> Any:
    try:
        with safe_open(path, "pt") as file:
            return json.loads((file.metadata() or {})[NOTE])
    except (OSError, SafetensorError, KeyError, ValueError) as error:
        raise WeightsError(
            f"{path}: wanted a fitted scene, got {type(error).__name__} ({error}); move it away "
            f"and fit again"
        ) from error


def render_cloud(
    cloud_of: Callable[[], GaussianCloud],
    target: Camera,
    near: float,
    device_name: str,
    background: Sequence[float] = (0.0, 0.0, 0.0),
) -> Rendering:
    """Render what a function gives on a device, with the time of both."""
    device = compute_device(device_name)
    with rendering_on(device):
        started = perf_counter()
        cloud = cloud_of()
        moved = clock_s(device)
        picture = render_gaussians(cloud, target, background, near=near)
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
        return render_cloud(
            lambda: self._scene.cloud(index), target, self._scene.near, self._device
        )

    @property
    def size_bytes(self) -> int:
        """Bytes of the file."""
        return self._path.stat().st_size
