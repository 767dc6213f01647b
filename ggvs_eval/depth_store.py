"""Depth maps on disk, keyed by everything they were computed from.

A store holds one folder per key and in it one file per instant and `job.json`, which says in words
what the key represents. Files are written under a temporary name and renamed, so that a killed
process leaves either the whole file or none. At 1345 x 1008 a map takes some 3.9 MB
(files/packed_maps.py), plain 6.8 MB, which earlier versions wrote and which is read as well.
"""

import zipfile
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map, Mask
from ggvs_eval.camera import Camera
from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import atomic_file, sweep_files
from ggvs_eval.files.packed_maps import unpack, write_packed
from ggvs_eval.run_folder import JOB_FILE, write_json
from ggvs_eval.tasks.task import digest_inputs

# entries that the spec of checked depth adds to that of raw depth
CHECK_ENTRIES = ("checked_with", "check")
CONFIDENCE_STEPS = 255  # confidence is kept in 8 bit


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of one image.

    Attributes:
        depth: z in the camera's frame, world units, 0 = invalid, (H, W) float32.
        confidence: trust in it, in [0, 1], 0 if the depth is invalid, (H, W) float32.
        guess: what takes the place of depth that other cameras do not confirm, (H, W) float32; None
            if the background does.
    """

    depth: Map
    confidence: Map
    guess: Map | None = None

    def clean(self) -> "DepthMap":
        """Return the map with depth, guess and confidence 0 wherever depth is not `is_known`."""
        mask, zero = is_known(self.depth), np.float32(0)
        guess = None if self.guess is None else np.where(is_known(self.guess), self.guess, zero)
        stray = ~mask & ((self.depth != 0) | (self.confidence != 0))
        if guess is None and not stray.any():
            return self
        return DepthMap(
            np.where(mask, self.depth, zero), np.where(mask, self.confidence, zero), guess
        )


def is_known(depth: Map) -> Mask:
    """Mask the depth that is positive and finite; any other value of a map is unknown."""
    return (depth > 0) & (depth < np.inf)


def describe_depth(
    camera: Camera,
    partners: Sequence[Camera],
    digests: Mapping[str, str],
    options: Mapping[str, object],
) -> dict[str, object]:
    """Everything a depth map depends on, as it is written into `job.json`.

    Args:
        options: parameters and code of the algorithm, values that JSON knows.
    """
    cameras = [
        {"name": view.name, **view.to_json(), "frames": digests[view.name]}
        for view in (camera, *partners)
    ]
    return {"camera": cameras[0], "partners": cameras[1:], "options": dict(options)}


@dataclass(frozen=True, order=True)
class DepthJob:
    """One camera and the partners its depth is computed with.

    Equal jobs of one plan give equal depth.

    Attributes:
        camera_name: the camera whose depth is wanted.
        partner_names: the cameras it is matched with, in order; none if a sensor measured its
            depth.
        checked_with: depth of other cameras that it is checked against; none for raw depth.
        spec: all that the depth depends on, as JSON values; written once, when the job is planned.
    """

    camera_name: str
    partner_names: tuple[str, ...]
    checked_with: tuple["DepthJob", ...] = ()
    spec: Mapping[str, object] = field(default_factory=dict, compare=False, repr=False)

    @cached_property
    def key(self) -> str:
        """Of its depth in a store."""
        return DepthStore.key(self.spec)

    @property
    def unchecked(self) -> "DepthJob":
        """The same depth as it was found."""
        return replace(
            self,
            checked_with=(),
            spec={name: self.spec[name] for name in self.spec if name not in CHECK_ENTRIES},
        )

    def checked_against(
        self, partners: tuple["DepthJob", ...], check: Mapping[str, object]
    ) -> "DepthJob":
        """Return the depth, checked against that of other cameras."""
        spec = dict(self.spec) | dict(
            zip(CHECK_ENTRIES, ([partner.key for partner in partners], check), strict=True)
        )
        return replace(self, checked_with=partners, spec=spec)


class DepthStore:
    """A folder of depth maps.

    Args:
        root: the folder; created by the first `write`.
    """

    def __init__(self, root: Path) -> None:
        self.root = root

    @staticmethod
    def key(spec: Mapping[str, object]) -> str:
        """Return the key of a description by `describe_depth`: sha256 of its JSON text."""
        return digest_inputs(spec)

    def folder(self, key: str) -> Path:
        """Return the folder of the depth maps with that key."""
        return self.root / key[:24]

    def path(self, key: str, frame: int) -> Path:
        """Return the file of one instant."""
        return self.folder(key) / f"{frame:06d}.npz"

    def has(self, key: str, frame: int) -> bool:
        """Return whether that instant is stored."""
        return self.path(key, frame).is_file()

    def write_spec(self, spec: Mapping[str, object]) -> str:
        """Open the folder of a spec, with a `job.json` that says what it holds, sweep it, and
        return its key.
        """
        key = self.key(spec)
        sweep_files(self.folder(key))
        path = self.folder(key) / JOB_FILE
        if not path.is_file():
            write_json(path, {"sha256": key, "identity": spec, "files": {}})
        return key

    def write(self, key: str, frame: int, depth_map: DepthMap) -> None:
        """Store one instant, see `DepthMap.clean`; confidence is rounded to 8 bit."""
        depth_map = depth_map.clean()
        confidence = np.rint(depth_map.confidence * CONFIDENCE_STEPS).astype(np.uint8)
        with atomic_file(self.path(key, frame)) as temporary, temporary.open("wb") as file:
            arrays: dict[str, NDArray[Any]] = {
                "depth": depth_map.depth.astype(np.float32, copy=False),
                "confidence": confidence,
            }
            if depth_map.guess is not None:
                arrays["guess"] = depth_map.guess.astype(np.float32, copy=False)
            write_packed(file, arrays)

    def read(self, key: str, frame: int) -> DepthMap:
        """Read one instant.

        Raises:
            DepthError: not stored, or damaged.
        """
        path = self.path(key, frame)
        if not path.is_file():
            raise DepthError(
                f"{path}: wanted a stored depth map, got none; run `ggvs-eval prepare`"
            )
        try:
            with np.load(path, allow_pickle=False) as members:
                maps = unpack(members)
            depth, confidence, guess = maps["depth"], maps["confidence"], maps.get("guess")
        except (OSError, ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
            raise DepthError(
                f"{path}: not a readable depth map ({error}); move this file away and run "
                f"`ggvs-eval prepare` again"
            ) from error
        for depth_map in (depth, depth if guess is None else guess):
            _check(path, depth_map, confidence)
        return DepthMap(depth, confidence.astype(np.float32) / np.float32(CONFIDENCE_STEPS), guess)


def _check(path: Path, depth: NDArray[np.generic], confidence: NDArray[np.generic]) -> None:
    if (
        depth.dtype != np.float32
        or confidence.dtype != np.uint8
        or depth.ndim != 2
        or depth.shape != confidence.shape
    ):
        raise DepthError(
            f"{path}: wanted float32 depth and uint8 confidence of one (H, W), got {depth.dtype} "
            f"{depth.shape} and {confidence.dtype} {confidence.shape}; move this file away and run "
            "`ggvs-eval prepare` again"
        )
    if not np.isfinite(depth).all() or depth.min(initial=0) < 0:
        raise DepthError(
            f"{path}: depth must be finite and not negative; move this file away and run "
            f"`ggvs-eval prepare` again"
        )
