"""Scenes of 3D Gaussians that others have fitted, from their files: ``splats:PATH`` renders them by
this package's splat.
"""

import re
from collections.abc import Mapping, Sequence
from functools import lru_cache
from itertools import pairwise
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from ggvs_eval import built_in
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError, no_such_path
from ggvs_eval.files.listing import list_files
from ggvs_eval.files.names import Number, is_stamp, numbers_in
from ggvs_eval.files.plain import why_unread
from ggvs_eval.method import NEAR_M, Rendering
from ggvs_eval.plugins import Registry
from ggvs_eval.scene_fitter import FittedScene

if TYPE_CHECKING:  # the command line starts without torch
    from ggvs_eval.baselines.fitted.published import PublishedScene
    from ggvs_eval.gaussians import GaussianCloud
    from ggvs_eval.gaussians.settings import SplatSettings

PREFIX = "splats:"
CLOUD, DEFORMATION = "point_cloud.ply", "deformation.pth"
GLB = ".glb"
FILES: Registry[Any] = Registry("files of Gaussians", built_in.SPLAT_FILES)
ITERATION = re.compile(r"iteration_(\d+)")
ENDING = re.compile(r"\.(ply|glb)$")
KINDS = (
    "a .ply of 3D Gaussian splatting, a folder with one .ply per instant (its frame number in its "
    "name), a .glb with KHR_gaussian_splatting, or an output folder of it or of 4DGS, with "
    f"point_cloud/iteration_N/{CLOUD}"
)


class SplatsScene(FittedScene):
    """Clouds of Gaussians in ``.ply`` files or a ``.glb``: one for all instants, or one for each.

    Args:
        path: see `splats_files`.
        n_frames: of the capture; clouds that are numbered from 1 to it are those of its frames from
            0.

    Reading:
        Gaussians are in the world of the capture's cameras, unless a file next to them says
        otherwise. What is at z <= 0.2 of the capture's units is left out, as 3D Gaussian splatting
        does while it fits; the background is black, or white where the settings of the training say
        so. The number of a file of a sequence is the last one in its name, and it is the capture's
        frame number, from 0.
    """

    def __init__(self, path: Path, n_frames: int = 1) -> None:
        self._path = path
        self._files = splats_files(path)
        self._by_number = _numbered(self._files, path, n_frames)
        self._settings = splats_settings(path)
        self._read = lru_cache(maxsize=1)(_read)
        # what is broken shows before anything is rendered
        self._read(*self._by_number[self.instants[0]])

    @property
    def instants(self) -> list[int]:
        """Frame numbers of the clouds, ascending; 0 for one of all instants."""
        return sorted(self._by_number)

    def cloud(self, index: int) -> "GaussianCloud":
        """Return the Gaussians of an instant."""
        _require_instants([index], self._by_number, self._path)
        cloud = self._read(
            *self._by_number[index if len(self._by_number) > 1 else self.instants[0]]
        )
        return self._settings.apply(cloud)

    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant."""
        from ggvs_eval.gaussians import render_gaussians

        start = perf_counter()
        cloud = self.cloud(index)
        read = perf_counter()
        picture = render_gaussians(cloud, target, self._settings.background, near=NEAR_M)
        seconds = {"read": read - start, "splat": perf_counter() - read}
        return Rendering(picture.image.clamp_max(1).numpy(), picture.depth.numpy(), seconds)

    @property
    def size_bytes(self) -> int:
        """Bytes of all files."""
        return sum(file.stat().st_size for file in self._files)


def _is_glb(path: Path) -> bool:
    return path.suffix.lower() == GLB


def reading_modules(path: Path) -> tuple[str, ...]:
    """Return the modules that determine the rendering of a file of Gaussians, including its
    reader.
    """
    root = FILES.root(GLB) if _is_glb(path) else None
    return (SplatsScene.__module__, *([root] if root else []))


def _read(path: Path, mesh: int) -> "GaussianCloud":
    from ggvs_eval.gaussians import read_ply

    cloud: GaussianCloud = FILES[GLB].read(path, mesh) if _is_glb(path) else read_ply(path)
    if not len(cloud):
        raise RenderError(
            f"{path}: wanted a cloud of Gaussians, it holds no Gaussians; give one that the "
            f"training kept"
        )
    return cloud


def open_splats(path: Path, instants: range = range(1)) -> "SplatsScene | PublishedScene":
    """Open the Gaussians that others have fitted.

    Args:
        path: see `splats_files`.
        instants: frame numbers of the clip that they were fitted to; Gaussians of 4DGS move by the
            share of it that has passed.

    Raises:
        RenderError: nothing there that is known, a cloud that cannot be read, or in a sequence two
            files of one number.
        WeightsError: a deformation field of other names or shapes than 4DGS writes.
    """
    from ggvs_eval.baselines.fitted.published import PublishedScene

    files = splats_files(path)
    if files[-1].name == DEFORMATION:
        return PublishedScene(files[0].parent, instants, NEAR_M, settings=splats_settings(path))
    return SplatsScene(path, len(instants))


def splats_files(path: Path) -> list[Path]:
    """List the files of which a scene is made.

    Args:
        path: a ``.ply`` or ``.glb``; a folder of ``.ply``, one per instant; or the output folder of
            3D Gaussian splatting or of 4DGS, whose last iteration is taken.
    """
    if path.is_file():
        return [path]
    try:
        iterations = {
            int(number[1]): folder
            for folder in path.glob("point_cloud/*")
            if (number := ITERATION.fullmatch(folder.name))
        }
        place = iterations[max(iterations)] if iterations else path
        files = [place / CLOUD] if (place / CLOUD).is_file() else list_files(place, (".ply",))
    except OSError as error:
        raise RenderError(
            f"{path}: wanted {KINDS}; got an unreadable path: {why_unread(error)}"
        ) from error
    if not files:
        raise RenderError(
            f"{path}: wanted {KINDS}; got none of them"
            if path.is_dir()
            else no_such_path(path, KINDS)
        )
    if (place / DEFORMATION).is_file():
        return [*files, place / DEFORMATION]
    counts = [*map(_whole, _frame_numbers(files))]
    return [files[counts.index(max(counts))]] if _are_iterations(counts) else files


def splats_settings(path: Path) -> "SplatSettings":
    """Return the settings next to the files of a scene.

    Arguments and errors as of `splats_files`.
    """
    from ggvs_eval.gaussians.settings import find_settings

    return find_settings(splats_files(path)[0], path)


def splats_notes(path: Path) -> list[str]:
    """List what is passed over in the files of a scene, and what is assumed.

    Arguments and errors as of `splats_files`.
    """
    from ggvs_eval.gaussians.ply import NORMALISED_NOTE, header_notes

    files, settings = splats_files(path), splats_settings(path)
    said = [] if _is_glb(files[0]) else header_notes(files[0])
    of_header = [
        f"{files[0]}: {note}"
        for note in said
        if note != NORMALISED_NOTE or settings.to_world is None
    ]
    n_others = len(list_files(files[0].parent, (".ply",))) - 1
    if path.is_dir() and len(files) == 1 < n_others + 1 and files[0].name != CLOUD:
        of_header.append(
            f"{path}: its {n_others + 1} files are numbered by iterations; the last one is used: "
            f"{files[0].name}"
        )
    if len(files) > 1 and sorted(map(_whole, _frame_numbers(files))) == [*range(1, len(files) + 1)]:
        n = len(files)
        of_header.append(
            f"{path}: numbered from 1 to {n}; used as the frames 0 to {n - 1} if the capture has "
            f"{n}"
        )
    return of_header + settings.notes


def _whole(number: Number | None) -> int:
    return number if isinstance(number, int) else -1


def _are_iterations(counts: Sequence[int]) -> bool:
    """Return whether some numbers are of iterations: whole hundreds, or one less, each of which
    differs from the others.
    """
    are_hundreds = all(count >= 0 and count % 100 in (0, 99) for count in counts)
    return (
        len(counts) > 1
        and are_hundreds
        and min(later - earlier for earlier, later in pairwise(sorted(counts))) >= 99
    )


def require_instants(path: Path, frames: Sequence[int], n_frames: int) -> None:
    """Refuse a sequence that lacks clouds of some frames; nothing but names is read."""
    files = splats_files(path)
    if files[-1].name != DEFORMATION:
        _require_instants(frames, _numbered(files, path, n_frames), path)


def _require_instants(frames: Sequence[int], numbered: Mapping[int, object], path: Path) -> None:
    absent = [frame for frame in frames if frame not in numbered]
    if len(numbered) > 1 and absent:
        raise RenderError(
            f"{path}: wanted a cloud of frame {absent[0]}, there are {len(numbered)} of "
            f"{min(numbered)} to {max(numbered)}; number the files as the capture's frames, from 0"
        )


def _numbered(files: Sequence[Path], path: Path, n_frames: int) -> Mapping[int, tuple[Path, int]]:
    """Return frame number -> file and the mesh in it; a cloud of all instants is of frame 0."""
    if len(files) == 1:
        return (
            {frame: (path, mesh) for frame, mesh in FILES[GLB].frames(path).items()}
            if _is_glb(path)
            else {0: (files[0], 0)}
        )
    numbers: dict[int, tuple[Path, int]] = {}
    for file, number in zip(files, _frame_numbers(files), strict=True):
        if not isinstance(number, int) or is_stamp(number):
            raise RenderError(
                f"{file}: wanted a frame number in the name of each .ply of the sequence {path}; "
                f"rename it"
            )
        if number in numbers:
            name = numbers[number][0].name
            raise RenderError(
                f"{path}: {name} and {file.name} are both of frame {number}; give a folder with "
                f"one file per frame"
            )
        numbers[number] = (file, 0)
    counts_from_1 = sorted(numbers) == [*range(1, n_frames + 1)]
    return {number - counts_from_1: place for number, place in numbers.items()}


def _frame_numbers(files: Sequence[Path]) -> list[Number | None]:
    try:
        return numbers_in([file.stem for file in files])
    except ValueError:
        return [None] * len(files)


def named_splats(labels: Sequence[str]) -> tuple[tuple[str, ...], dict[str, Path]]:
    """Give each ``splats:PATH`` or ``NAME=splats:PATH`` among some methods a name that folders can
    bear.

    Returns:
        The labels, and label -> path of those that are splats: ``splats-`` and the last part of the
        path, or the given name.

    Examples:
        >>> named_splats(["ours", "splats:out/room/point_cloud.ply", "mine=splats:/tmp/clouds"])
        (('ours', 'splats-point_cloud', 'mine'), {'splats-point_cloud': PosixPath('out/room/point_cloud.ply'), 'mine': ...})
    """  # noqa: E501
    plain: list[str] = []
    paths: dict[str, Path] = {}
    for label in labels:
        name, separator, text = label.rpartition(PREFIX)
        if not separator or (name and not name.endswith("=")):
            plain.append(label)
            continue
        path = Path(text)
        name = (
            name[:-1]
            or f"splats-{re.sub(r'[^A-Za-z0-9_.-]+', '-', ENDING.sub('', path.resolve().name))}"
        )
        if not text or not re.fullmatch(r"\w[\w.-]*", name):
            raise RenderError(
                f"method {label}: wanted {PREFIX}PATH or NAME={PREFIX}PATH with a plain name, PATH "
                f"being {KINDS}"
            )
        if paths.get(name, path) != path:
            raise RenderError(
                f"{paths[name]} and {path} would both be called {name}; give NAME={PREFIX}PATH"
            )
        plain.append(name)
        paths[name] = path
    return tuple(plain), paths
