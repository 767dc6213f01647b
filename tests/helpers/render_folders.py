"""Renders of two views and three frames in every layout that others write, and the run folder they
are scored in.
"""

import json
import tarfile
import zipfile
from collections.abc import Sequence
from functools import cache
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views
from ggvs_eval.run_folder import RunFolder, frame_path, write_json

CAMERAS = ("cam00", "cam01", "cam02")
VIEWS = ("cam02", "cam00")  # the protocol's order is not the alphabet's
FRAMES = range(2, 5)
N_FRAMES = 7
WIDTH, HEIGHT = 64, 48
METRICS = ("PSNR", "L1", "SDT", "SDV")
Place = tuple[str, int]


def make_run(
    root: Path, metrics: Sequence[str] = METRICS, frames: range = FRAMES, n_frames: int = N_FRAMES
) -> RunFolder:
    """A run folder as `prepare_truth` leaves it: the captured frames of the test views, nothing
    rendered.
    """
    run = RunFolder(root)
    measurement = Measurement(tuple(metrics))
    protocol = Protocol(
        "tiny",
        "Tiny room",
        Views(VIEWS, "by hand"),
        Frames(frames.start, len(frames)),
        Synthesis(2),
        measurement,
    )
    for view in VIEWS:
        for frame in frames:
            write_image(frame_path(run.truth(view), frame), truth(view, frame))
    cameras = {name: {"size": [WIDTH, HEIGHT]} for name in CAMERAS}
    record = {
        "scene": "room",
        "fps": 30.0,
        "n_frames": n_frames,
        "cameras": cameras,
        "digests": dict.fromkeys(CAMERAS, "ab12"),
    }
    write_json(root / "capture.json", record)
    run.protocol_file.write_text(protocol.to_toml(), encoding="utf-8")
    return run


@cache
def truth(view: str, frame: int) -> Image8:
    """A captured frame: a smooth random pattern of its camera, before which a bright square
    moves.
    """
    coarse = (
        np.random.default_rng(CAMERAS.index(view)).integers(20, 200, (6, 8, 3)).astype(np.uint8)
    )
    image = cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC)
    image[10:15, 4 + 6 * frame : 20 + 6 * frame] = (250, 240, 60)
    return image


@cache
def rendered(view: str, frame: int) -> Image8:
    """A rendering of it: 3 levels too bright, and somewhat noisy."""
    noise = np.random.default_rng([CAMERAS.index(view), frame]).integers(-2, 3, (HEIGHT, WIDTH, 3))
    return np.clip(truth(view, frame) + 3 + noise, 0, 255).astype(np.uint8)


def write_folders(
    folder: Path,
    frames: Sequence[int] = FRAMES,
    numbers: Sequence[int] | None = None,
    pattern: str = "{view}/{number:04d}.png",
) -> Path:
    """``<view>/<frame>.png`` of the given frames, under other numbers or names where they are
    given.
    """
    for view in VIEWS:
        for frame, number in zip(frames, numbers or frames, strict=True):
            write_picture(folder / pattern.format(view=view, number=number), rendered(view, frame))
    return folder


def write_picture(path: Path, image: Image8) -> None:
    """PNG, or JPEG where the name says so."""
    path.parent.mkdir(parents=True, exist_ok=True)
    if path.suffix == ".png":
        write_image(path, image)
    else:
        cv2.imwrite(str(path), cv2.cvtColor(image, cv2.COLOR_RGB2BGR))


def write_videos(
    folder: Path, frames: Sequence[int] = FRAMES, views: Sequence[str] = VIEWS, fps: float = 30.0
) -> Path:
    for view in views:
        write_video(folder / f"{view}.mp4", (rendered(view, frame) for frame in frames), fps, crf=0)
    return folder


def stack(view: str, dtype: str = "uint8", frames: Sequence[int] = FRAMES) -> np.ndarray:
    """(T, H, W, 3), floats in [0, 1]."""
    images = np.stack([rendered(view, frame) for frame in frames])
    return images if dtype == "uint8" else (images / 255.0).astype(dtype)


def write_flat(
    folder: Path, places: Sequence[Place], names: tuple[str, str] = ("renders", "gt")
) -> Path:
    """The pictures of these places, one behind the other, beside copies of the truth."""
    for index, (view, frame) in enumerate(places):
        write_image(folder / names[0] / f"{index:05d}.png", rendered(view, frame))
        write_image(folder / names[1] / f"{index:05d}.png", truth(view, frame))
    return folder


def write_nerfbaselines(
    folder: Path, pattern: str = "{view}/{frame:04d}.png", copies: bool = True
) -> Path:
    """Predictions under the data set's relative names."""
    for view in VIEWS:
        for frame in FRAMES:
            name = pattern.format(view=view, frame=frame)
            write_image(folder / "color" / name, rendered(view, frame))
            if copies:
                write_image(folder / "gt-color" / name, truth(view, frame))
    (folder / "info.json").write_text(json.dumps({"method": "some method", "nb_version": "1.2.5"}))
    return folder


def write_easyvolcap(
    folder: Path, copies: bool = True, frames: Sequence[int] = FRAMES, views: Sequence[str] = VIEWS
) -> Path:
    """``RENDER/frame0002_camera0000.png`` with alpha, truth and error beside each; depth and alpha
    in folders of their own.
    """
    for view in views:
        for frame in frames:
            name, opaque = (
                f"frame{frame:04d}_camera{CAMERAS.index(view):04d}",
                np.full((HEIGHT, WIDTH, 1), 255, np.uint8),
            )
            pictures = {
                "RENDER/{}": rendered(view, frame),
                "DEPTH/{}": truth(view, frame),
                "RENDER/{}_error": truth(view, frame) // 9,
            }
            for pattern, image in {
                **pictures,
                **({"RENDER/{}_gt": truth(view, frame)} if copies else {}),
            }.items():
                path = folder / f"{pattern.format(name)}.png"
                path.parent.mkdir(parents=True, exist_ok=True)
                cv2.imwrite(str(path), np.concatenate([image[..., ::-1], opaque], axis=-1))
    return folder


def write_4dgaussians(folder: Path) -> Path:
    """A model folder with the train, test and video sets; the video's gt/ is empty."""
    for name in ("train", "test", "video"):
        place = write_flat(folder / name / "ours_14000", view_major())
        write_video(place / "video_rgb.mp4", (rendered(*where) for where in view_major()), 30.0)
    for file in (folder / "video" / "ours_14000" / "gt").iterdir():
        file.unlink()
    return folder


def pack(folder: Path, archive: Path) -> Path:
    """The folder's content as an archive of the kind that its name says."""
    files = sorted(file for file in folder.rglob("*") if file.is_file())
    if archive.suffix == ".zip":
        with zipfile.ZipFile(archive, "w") as packed:
            for file in files:
                packed.write(file, file.relative_to(folder))
    else:
        with tarfile.open(archive, "w:gz") as tar:
            for file in files:
                tar.add(file, file.relative_to(folder).as_posix())
    return archive


def view_major() -> list[Place]:
    """Every place, view after view in the protocol's order."""
    return [(view, frame) for view in VIEWS for frame in FRAMES]
