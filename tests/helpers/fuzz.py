"""Inputs to damage: a small valid capture of every layout, and what is done to their files."""

import json
import os
from collections.abc import Callable
from pathlib import Path
from random import Random

import cv2
import h5py
import numpy as np

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.llff import llff_pose, write_llff_poses
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from helpers.calibration_files import turned_rig, write_anipose, write_opencv, write_qualisys
from helpers.captures import make_binary, make_image, make_rig, write_colmap, write_dynerf
from helpers.community_layouts import (
    write_frame_folders,
    write_immersive,
    write_meetroom,
    write_panoptic,
    write_technicolor_with_depth,
)
from helpers.small_layouts import (
    NUMBERS,
    write_capture_toml,
    write_easymocap,
    write_frames,
    write_multipleview,
    write_nerfstudio,
)

PAIR = ("cam00", "cam01")
ENDLESS_BYTES = 8 << 30  # a sparse file: it takes no room
LONG_KEY = b"k" * 60_000


def write_outdoor(folder: Path) -> Path:
    """EasyMocap with all that may lie beside it."""
    write_easymocap(folder, (-0.1, 0.02, 0.0, 0.0, 0.0))
    (folder / "vhull").mkdir()
    np.save(folder / "vhull" / "000000.npy", np.array([[-0.5, -0.5, 4.0], [0.5, 0.5, 5.0]]))
    for name in NUMBERS:
        write_frames(folder / "mask" / name, 0)
        write_image(folder / "bkgd" / f"{name}.png", make_image(0, 0))
    header = (
        "ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float "
        "y\nproperty float z\nend_header\n"
    )
    (folder / "background.ply").write_text(header + "0 0 3\n0 0 7\n0.1 0 9\n")
    return folder


def write_d3dmv(folder: Path) -> Path:
    """A compressed scene of two cameras."""
    folder.mkdir()
    frames = np.stack([[make_image(camera, frame) for frame in range(2)] for camera in range(2)])
    with h5py.File(folder / "scene000.h5", "w") as file:
        chunks = (1, 1, *frames.shape[2:])
        file.create_dataset("rgb", data=frames, chunks=chunks, compression="lzf", shuffle=True)
        file.create_dataset("bg_rgb", data=frames[:, 0])
    write_llff_poses(folder / "scene000_pb.npy", [llff_pose(camera) for camera in make_rig(PAIR)])
    return folder


def write_spaces(folder: Path) -> Path:
    """One position of a rig of two cameras."""
    at = []
    for index, camera in enumerate(make_rig(("cam_00", "cam_01"))):
        write_image(folder / camera.name / "image_000.png", make_image(index, 0))
        view = {
            "principal_point": [32.0, 24.0],
            "pixel_aspect_ratio": 1.0,
            "focal_length": 57.6,
            "width": 64.0,
            "height": 48.0,
        }
        pose = {
            "position": camera.centre.tolist(),
            "orientation": cv2.Rodrigues(camera.rotation)[0].ravel().tolist(),
        }
        at.append({**view, **pose, "relative_path": f"{camera.name}/image_000.png"})
    (folder / "models.json").write_text(json.dumps([at]))
    return folder


def write_rgbd(folder: Path) -> Path:
    """ScanNet's export of two frames."""
    for index, camera in enumerate(make_rig(PAIR)):
        write_image(folder / "color" / f"{index}.png", make_image(index, 0))
        (folder / "depth").mkdir(exist_ok=True)
        cv2.imwrite(
            str(folder / "depth" / f"{index}.png"), np.full((24, 32), 3000 + index, np.uint16)
        )
        (folder / "pose").mkdir(exist_ok=True)
        np.savetxt(folder / "pose" / f"{index}.txt", np.linalg.inv(camera.world_to_camera), "%f")
    (folder / "intrinsic").mkdir()
    for kind, scale in (("color", 1.0), ("depth", 0.5)):
        K = np.eye(4)
        K[:3, :3] = np.diag([scale, scale, 1.0]) @ make_rig(PAIR)[0].K
        np.savetxt(folder / "intrinsic" / f"intrinsic_{kind}.txt", K, "%f")
        np.savetxt(folder / "intrinsic" / f"extrinsic_{kind}.txt", np.eye(4), "%f")
    return folder


def write_beside_frames(folder: Path, write: Callable[[Path], object]) -> Path:
    """Pictures of two cameras, and a calibration of another tool."""
    for index, name in enumerate(PAIR):
        write_frames(folder / "images" / name, index)
    write(folder)
    return folder


def write_binary_colmap(folder: Path) -> Path:
    write_colmap(folder, PAIR)
    make_binary(folder / "sparse" / "0")
    return folder


CAPTURES: dict[str, Callable[[Path], Path]] = {
    "capture.toml": write_capture_toml,
    "d3dmv": write_d3dmv,
    "spaces": write_spaces,
    "immersive": write_immersive,
    "technicolor": write_technicolor_with_depth,
    "panoptic": write_panoptic,
    "rgbd": write_rgbd,
    "multipleview": write_multipleview,
    "3dgstream": write_frame_folders,
    "dynerf": lambda folder: write_dynerf(folder, PAIR),
    "meetroom": write_meetroom,
    "enerf-outdoor": write_outdoor,
    "colmap": write_binary_colmap,
    "nerfstudio": write_nerfstudio,
    "qualisys": lambda folder: write_beside_frames(
        folder, lambda it: write_qualisys(it / "rig.qca.txt", turned_rig(PAIR))
    ),
    "anipose": lambda folder: write_beside_frames(
        folder, lambda it: write_anipose(it / "rig.toml", turned_rig(PAIR))
    ),
    "opencv": lambda folder: write_beside_frames(
        folder, lambda it: write_opencv(it, turned_rig(PAIR))
    ),
}


def read_everything(path: Path) -> str:
    """Open a capture and read all that is in it; its layout, or the line with which it was
    refused.
    """
    try:
        capture = open_capture(path)
        for name in capture.camera_names:
            frames = list(capture.frames(name))
            assert len(frames) == capture.n_frames
            capture.background(name)
            extras = capture.extras_of(name)
            if extras.mask is not None:
                list(extras.mask.frames(0, extras.mask.n_frames))
            if extras.depth is not None:
                list(extras.depth.depths(0, extras.depth.n_frames))
            assert len(capture.digest(name)) == 64
        return capture.layout
    except CaptureError as error:
        message = str(error)
        assert message.isprintable()
        assert 20 < len(message) < 4000
        return message


TOKENS = [
    b"\0",
    b"\n",
    b"\xff",
    b"-",
    b"nan",
    b"inf",
    b"1e999",
    b"-1",
    b"0",
    b"9" * 400,
    b"[" * 3000,
    b"{",
    b"]",
    b'"',
    b"'",
    b"null",
    b"true",
    b"!!python/object/apply:os.system ['id']",
    b"&a *a",
    b"../..",
    b"/dev/zero",
    b"\xef\xbb\xbf",
    b"\xed\xa0\x80",
    b"\r",
    b": ",
    b"#",
    b"\x80\x04\x95",
    b"PK\x03\x04",
    b"\x89PNG\r\n\x1a\n",
    b"\x89HDF\r\n\x1a\n",
    b"\\u0000",
    b"\\ud800",
    b"%YAML:1.0\n",
]


def damaged(content: bytes, edit: tuple[str, object]) -> bytes:
    """The content after one edit."""
    kind, how = edit
    at = int(how[0] * len(content)) if isinstance(how, tuple) else 0
    match kind:
        case "flip":
            changed = bytearray(content)
            for place, value in how if content else ():  # type: ignore[attr-defined]
                changed[int(place * len(content))] ^= value
            return bytes(changed)
        case "cut":
            return content[: int(how * len(content))]  # type: ignore[operator]
        case "replace":
            return bytes(how)  # type: ignore[call-overload]
        case "insert":
            return content[:at] + how[1] + content[at:]  # type: ignore[index]
        case "overwrite":
            return content[:at] + how[1] + content[at + len(how[1]) :]  # type: ignore[index]
        case "repeat":
            return content[:at] + content[int(how[1] * len(content)) :]  # type: ignore[index]
        case _:
            return content[:at] + content[at + how[1] :]  # type: ignore[index]


def random_edit(random: Random) -> tuple[str, object]:
    """An edit for `damaged`."""
    kind = random.choice(("flip", "cut", "replace", "insert", "overwrite", "repeat", "drop"))
    match kind:
        case "flip":
            return kind, [
                (random.random(), random.randint(1, 255)) for _ in range(random.randint(1, 6))
            ]
        case "cut":
            return kind, random.random()
        case "replace":
            return kind, random.randbytes(random.randint(0, 60))
        case "repeat":
            return kind, (random.random(), random.random())
        case "drop":
            return kind, (random.random(), random.randint(1, 40))
        case _:
            return kind, (random.random(), random.choice(TOKENS))


def make_endless(path: Path) -> None:
    """A regular file of 8 GiB that takes no room."""
    with path.open("wb") as file:
        file.truncate(ENDLESS_BYTES)


def add_long_key(path: Path) -> None:
    """A key of 60 kB at the beginning of a text file, in its own notation."""
    content = path.read_bytes() if path.is_file() else b""
    if content.startswith(b"{"):
        path.write_bytes(b'{"' + LONG_KEY + b'": 1, ' + content[1:])
    else:
        head, line_end, rest = (
            content.partition(b"\n") if content.startswith(b"%YAML") else (b"", b"", content)
        )
        sign = b" = 1" if path.suffix == ".toml" else b": 1"
        path.write_bytes(head + line_end + LONG_KEY + sign + b"\n" + rest)


# What takes a file's place without being one, or being one beyond all measure.
IMPOSTORS: dict[str, Callable[[Path], object]] = {
    "a pipe": os.mkfifo,
    "a device": lambda path: path.symlink_to("/dev/zero"),
    "an endless file": make_endless,
    "a folder": Path.mkdir,
    "a dangling link": lambda path: path.symlink_to("nowhere"),
    "a link to itself": lambda path: path.symlink_to(path.name),
    "nothing": lambda path: None,
}
