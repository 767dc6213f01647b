"""Prior knowledge of cameras: lenses, and perhaps poses, from any file or capture that says so."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.arrays import Array
from ggvs_eval.capture import Capture, source_chain
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.calibration_file import find_calibration_files, read_calibration_file
from ggvs_eval.datasets.capture_toml import LensTable, as_matrix
from ggvs_eval.datasets.colmap import by_camera, find_model
from ggvs_eval.datasets.colmap_model import read_model
from ggvs_eval.datasets.frames import has_shape
from ggvs_eval.datasets.media import match_cameras
from ggvs_eval.datasets.undistort import UndistortedFrames
from ggvs_eval.errors import CameraError, CaptureError
from ggvs_eval.files.listing import same_name
from ggvs_eval.files.toml_tables import build_table, read_toml
from ggvs_eval.lens import Lens

INTRINSICS = "intrinsics.toml"


@dataclass(frozen=True, eq=False)
class KnownCamera:
    """Prior knowledge of one camera.

    Attributes:
        world_to_camera: (4, 4); None if only the lens is known.
        is_metric: whether the pose is known to be in metres.
    """

    lens: Lens
    world_to_camera: Array | None
    is_metric: bool = False


@dataclass(frozen=True)
class IntrinsicsTable:
    """One ``[[camera]]`` of ``intrinsics.toml``.

    Attributes:
        width: of its images, pixels.
        K: intrinsics, 3 x 3, pixels, pixel centres at halves.
        distortion: of the lens; none if absent.
    """

    name: str
    width: int
    height: int
    K: tuple[tuple[float, ...], ...]
    distortion: LensTable | None = None


@dataclass(frozen=True)
class IntrinsicsFile:
    """The whole of ``intrinsics.toml``."""

    camera: tuple[IntrinsicsTable, ...]


def read_known(
    path: Path, sizes: Mapping[str, tuple[int, int]] | None = None
) -> dict[str, KnownCamera]:
    """Return the cameras by name.

    Args:
        path: ``intrinsics.toml`` or another TOML file of that form, ``capture.toml``, a folder with
            ``intrinsics.toml``, a folder with a COLMAP model, a calibration of Qualisys, anipose,
            freemocap or OpenCV (see `read_calibration_file`; a folder of these where OpenCV has a
            file for each camera), or any capture.
        sizes: (width, height) of each camera's frames, for files that do not say for which they
            are.

    Reading:
        Lenses are those of the frames as they are on disk: of a capture that is undistorted as it
        is read, the distorting ones. Cameras are called as their frames are, however the umlauts of
        the file's names are written.
    """
    cameras = _read_cameras(path, {same_name(name): size for name, size in (sizes or {}).items()})
    matched = match_cameras(cameras, sizes or ()).names
    return {matched.get(name, name): camera for name, camera in cameras.items()}


def _read_cameras(path: Path, sizes: Mapping[str, tuple[int, int]]) -> dict[str, KnownCamera]:
    """Return the cameras as they are called there; the sizes are by NFC names."""
    if not path.is_dir() and find_calibration_files(path):
        return _of_calibration_file(path, sizes)
    if path.suffix.lower() == ".toml" and path.name != "capture.toml":
        return _read_intrinsics(path)
    if (path / INTRINSICS).is_file():
        return _read_intrinsics(path / INTRINSICS)
    model = (
        path
        if any((path / f"cameras.{kind}").is_file() for kind in ("bin", "txt"))
        else find_model(path)
    )
    if model is not None:
        views = by_camera(model, read_model(model))
        return {name: KnownCamera(view.lens, view.world_to_camera) for name, view in views.items()}
    if find_calibration_files(path):
        return _of_calibration_file(path, sizes)
    return _of_capture(
        open_capture(path.parent if path.name == "capture.toml" else path, measure_depth=False)
    )


def write_intrinsics(path: Path, lenses: Mapping[str, Lens]) -> None:
    """Write pinhole intrinsics so that `read_known` reads them back.

    Args:
        lenses: by camera name; their coefficients are not written.
    """
    lines = [
        "# Pinhole intrinsics in pixels, pixel centres at halves (column i is at u = i + 0.5)."
    ]
    for name, lens in lenses.items():
        rows = ", ".join(
            "[" + ", ".join(f"{float(value)!r}" for value in row) + "]" for row in lens.K
        )
        quoted = name.replace("\\", "\\\\").replace('"', '\\"')
        lines += [
            "",
            "[[camera]]",
            f'name = "{quoted}"',
            f"width = {lens.width}",
            f"height = {lens.height}",
            f"K = [{rows}]",
        ]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")


def fit_known(
    path: Path, cameras: Mapping[str, KnownCamera], sizes: Mapping[str, tuple[int, int]]
) -> dict[str, KnownCamera]:
    """Return the known cameras at the size of the frames.

    Args:
        sizes: (width, height) of each camera's frames.
    """
    missing = [name for name in sizes if name not in cameras]
    if missing:
        raise CaptureError(
            f"{path}: wanted intrinsics of {', '.join(missing)}, it has "
            f"{', '.join(cameras) or 'none'}; use the same camera names in both places"
        )
    fitted = {}
    for name, (width, height) in sizes.items():
        lens = cameras[name].lens
        if not has_shape((width, height), (lens.width, lens.height)):
            content = f"frames of {width} x {height}"
            raise CaptureError(
                f"{path}: {name} is calibrated for {lens.width} x {lens.height}, got {content}; "
                "give frames of that shape, scaled but not cropped"
            )
        fitted[name] = replace(cameras[name], lens=lens.resized(width, height))
    return fitted


def colmap_camera(lens: Lens) -> tuple[str, list[float]]:
    """COLMAP's name and parameters of a lens.

    Raises:
        CameraError: a lens that COLMAP cannot express: skewed, or with more than eight
            coefficients.
    """
    if abs(lens.K[0, 1]) > 1e-9 or len(lens.coefficients) > 8:
        content = f"skew {lens.K[0, 1]:g} and {len(lens.coefficients)} coefficients"
        raise CameraError(
            f"lens: wanted no skew and at most 8 coefficients, got {content}; undistort the frames "
            f"first"
        )
    pinhole = [float(value) for value in (lens.K[0, 0], lens.K[1, 1], lens.K[0, 2], lens.K[1, 2])]
    if lens.is_pinhole:
        return "PINHOLE", pinhole
    coefficients = [float(value) for value in lens.coefficients]
    if lens.model == "fisheye":
        return "OPENCV_FISHEYE", pinhole + coefficients
    if not any(coefficients[4:]):
        return "OPENCV", pinhole + coefficients[:4]
    return "FULL_OPENCV", pinhole + coefficients + [0.0] * (8 - len(coefficients))


def _read_intrinsics(path: Path) -> dict[str, KnownCamera]:
    table = build_table(IntrinsicsFile, read_toml(path, CaptureError), str(path), "", CaptureError)
    names = [camera.name for camera in table.camera]
    if len(set(names)) < len(names) or not names:
        raise CaptureError(
            f"{path}: wanted cameras of different names, got {', '.join(names) or 'none'}; correct "
            f"the names"
        )
    return {camera.name: KnownCamera(_lens(path, camera), None) for camera in table.camera}


def _lens(path: Path, table: IntrinsicsTable) -> Lens:
    distortion = table.distortion or LensTable("opencv", (0.0,) * 4)
    K = as_matrix(table.K, 3, f"{path}: {table.name}: K")
    try:
        return Lens(
            K=K,
            model=distortion.model,
            coefficients=distortion.coefficients,
            width=table.width,
            height=table.height,
        )
    except CameraError as error:
        raise CaptureError(f"{path}: {table.name}: {error}") from error


def _of_calibration_file(
    path: Path, sizes: Mapping[str, tuple[int, int]]
) -> dict[str, KnownCamera]:
    """Return the cameras of a calibration file.

    Of cameras without frames only the stated size counts.
    """
    cameras = {}
    for name, camera in read_calibration_file(path).cameras.items():
        if camera.size is None and same_name(name) not in sizes:
            continue
        try:
            cameras[name] = KnownCamera(
                camera.lens(sizes.get(same_name(name))), camera.world_to_camera, camera.is_metric
            )
        except CameraError as error:
            raise CaptureError(f"{path}: {name}: {error}") from error
    return cameras


def _of_capture(capture: Capture) -> dict[str, KnownCamera]:
    cameras = {}
    for camera, source in zip(capture.cameras, capture.sources, strict=True):
        pinhole = Lens(camera.K, "opencv", (0.0,) * 4, *camera.size)
        lens = next(
            (
                frames.lens
                for frames in source_chain(source)
                if isinstance(frames, UndistortedFrames)
            ),
            pinhole,
        )
        cameras[camera.name] = KnownCamera(lens, camera.world_to_camera)
    return cameras
