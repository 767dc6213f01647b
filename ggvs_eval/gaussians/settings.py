"""Settings next to a cloud of Gaussians, and comments in its header, by which it is drawn otherwise
or in another world.
"""

import json
import re
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from ggvs_eval.errors import RenderError
from ggvs_eval.files.plain import check_plain
from ggvs_eval.gaussians.cloud import GaussianCloud, antialiased, turned_harmonics

LARGEST_FILE = 4 << 20
# of nerfstudio: its world is scale * (transform @ that of the capture)
WORLD_FILE = "dataparser_transforms.json"
Effect = Literal["antialiased", "white", "normalised"]
# File -> what of its text means what. 3DGS and 4DGS write cfg_args, gsplat cfg.yml, nerfstudio
# config.yml.
SETTINGS: tuple[tuple[str, str, Effect], ...] = (
    ("cfg_args", r"antialiasing=True", "antialiased"),
    ("cfg_args", r"white_background=True", "white"),
    ("cfg.yml", r"(?m)^\s*antialiased:\s*true", "antialiased"),
    ("cfg.yml", r"(?m)^\s*normalize_world_space:\s*true", "normalised"),
    ("config.yml", r"rasterize_mode:\s*antialiased", "antialiased"),
    ("config.yml", r"(?m)^\s*background_color:\s*white", "white"),
)
# below the folder of an output that has the settings
OUTPUT_FOLDERS = re.compile(r"point_cloud|iteration_\d+|ply")
DESCRIBE = {
    "antialiased": "its Gaussians are drawn antialiased, as they were trained",
    "white": "its Gaussians are drawn over white, as they were trained",
}


@dataclass(frozen=True)
class SplatSettings:
    """Settings of a cloud.

    Attributes:
        files: that state any, in order.
        effects: what they state -> file.
        to_world: from the cloud's world to the capture's, a similarity (4, 4); None if they are the
            same.
    """

    files: tuple[Path, ...] = ()
    effects: dict[Effect, Path] | None = None
    to_world: tuple[tuple[float, ...], ...] | None = None

    @property
    def background(self) -> tuple[float, float, float]:
        """Colour behind everything."""
        return (1.0, 1.0, 1.0) if "white" in (self.effects or {}) else (0.0, 0.0, 0.0)

    @property
    def notes(self) -> list[str]:
        """A line per setting that is applied."""
        notes = [
            f"{file}: {DESCRIBE[effect]}"
            for effect, file in (self.effects or {}).items()
            if effect in DESCRIBE
        ]
        world = [file for file in self.files if file.name == WORLD_FILE]
        return notes + [
            f"{file}: the cloud is moved from nerfstudio's world to the capture's by it"
            for file in world
        ]

    def apply(self, cloud: GaussianCloud) -> GaussianCloud:
        """Return a cloud as it is drawn, in the capture's world."""
        if "antialiased" in (self.effects or {}):
            cloud = antialiased(cloud)
        return cloud if self.to_world is None else moved_cloud(cloud, np.array(self.to_world))


NO_SETTINGS = SplatSettings()


def find_settings(cloud: Path, root: Path) -> SplatSettings:
    """Read the settings next to a cloud's file, or in the folder of the output that it is a part
    of.

    Args:
        cloud: its file.
        root: the path that the user gave.

    Raises:
        RenderError: the cloud's world is another than the capture's, or may be, and no file states
            the transform.
    """
    folders, root = [cloud.resolve().parent], root.resolve()
    while OUTPUT_FOLDERS.fullmatch(folders[-1].name) or root in folders[-1].parents:
        folders.append(folders[-1].parent)
    effects: dict[Effect, Path] = {}
    candidates = [
        (folder / name, pattern, effect) for folder in folders for name, pattern, effect in SETTINGS
    ]
    for file, pattern, effect in candidates:
        if re.search(pattern, _text(file)):
            effects.setdefault(effect, file)
    worlds = [folder / WORLD_FILE for folder in folders if (folder / WORLD_FILE).is_file()]
    if "normalised" in effects and not worlds:
        raise RenderError(
            f"{effects['normalised']}: normalize_world_space is true, so {cloud.name} is in "
            "another world than the capture; train with --no-normalize-world-space, or write "
            f"transform and scale of gsplat's parser into {WORLD_FILE} next to it"
        )
    files = tuple(dict.fromkeys([*effects.values(), *worlds[:1]]))
    return SplatSettings(files, effects, _to_world(worlds[0]) if worlds else None)


def moved_cloud(cloud: GaussianCloud, similarity: np.ndarray) -> GaussianCloud:
    """Return a cloud after a similarity of its world, (4, 4): a scale and a rotation in its upper
    left part.
    """
    scale = float(np.cbrt(np.linalg.det(similarity[:3, :3])))
    rotation = torch.from_numpy(similarity[:3, :3] / scale)
    means = cloud.means.double() @ (scale * rotation).T + torch.from_numpy(similarity[:3, 3])
    # w last
    rotations = Rotation.from_quat(np.roll(cloud.quaternions.double().numpy(), -1, axis=1))
    turned = np.roll((Rotation.from_matrix(rotation.numpy()) * rotations).as_quat(), 1, axis=1)
    return replace(
        cloud,
        means=means.to(cloud.means.dtype),
        log_scales=cloud.log_scales + float(np.log(scale)),
        quaternions=torch.from_numpy(turned).to(cloud.quaternions.dtype),
        sh=turned_harmonics(cloud.sh, rotation.to(cloud.sh.dtype)),
    )


def _text(file: Path) -> str:
    try:
        check_plain(file, LARGEST_FILE)
        return file.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return ""


def _to_world(file: Path) -> tuple[tuple[float, ...], ...]:
    try:
        content = json.loads(_text(file))
        forward = np.eye(4)
        forward[:3] = np.asarray(content["transform"], dtype=np.float64)[:3] * float(
            content["scale"]
        )
        rotation = forward[:3, :3] / content["scale"]
        if not (
            np.allclose(rotation @ rotation.T, np.eye(3), atol=1e-3)
            and np.linalg.det(forward[:3, :3]) > 0
        ):
            raise ValueError(f"transform {rotation.tolist()}, scale {content['scale']}")
        return tuple(map(tuple, np.linalg.inv(forward).tolist()))
    except (
        ValueError,
        KeyError,
        TypeError,
        IndexError,
        ZeroDivisionError,
        RecursionError,
        np.linalg.LinAlgError,
    ) as error:
        raise RenderError(
            f"{file}: wanted nerfstudio's transform (3 x 4, a rotation and a shift) and scale, got "
            f"{str(error)[:200]}; copy it again from the output of the training"
        ) from error
