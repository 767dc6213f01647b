"""Films three tiny captures and prints the SHA-256 of what is in them; run as a script, in a
process of its own.
"""

import hashlib
import json
import sys
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.layouts.layouts import LAYOUTS
from ggvs_eval.contrib.worlds.room import lighting

TINY = DemoOptions(
    width=64, height=48, n_frames=2, cameras_per_row=2, path_poses=1, supersampling=1
)
FILMS = {
    "dynerf": TINY,
    "enerf-outdoor": replace(
        TINY, layout="enerf-outdoor", rig="arc", path_poses=0, calibration_error_px=0.5
    ),
    "d3dmv": replace(
        TINY,
        layout="d3dmv",
        rig="grid",
        path_poses=0,
        defocus_px=1.0,
        processing=1.0,
        jpeg_quality=90,
    ),
}


def digest_pictures(options: DemoOptions) -> str:
    """What is filmed before any encoder sees it: every frame, its depth, and the camera that is
    written down.
    """
    digest = hashlib.sha256()
    for shot in LAYOUTS[options.layout].shots(options):
        footage = Footage(options, shot, instant)
        for frame in footage.frames():
            digest.update(
                frame.image.tobytes() + frame.depth.tobytes() + frame.foreground.tobytes()
            )
        camera = footage.noted_camera()
        digest.update(
            camera.world_to_camera.tobytes()
            + camera.K.tobytes()
            + np.array([camera.near, camera.far]).tobytes()
        )
    return digest.hexdigest()


@cache
def instant(index: int) -> lighting.Instant:
    """The room of all films at a frame number, lit once."""
    return lit_room(TINY.seed, TINY.scene).at(index / TINY.fps)


def digest_files(folder: Path) -> str:
    """Names and bytes of all files of a capture."""
    digest = hashlib.sha256()
    for path in sorted(path for path in folder.rglob("*") if path.is_file()):
        digest.update(path.relative_to(folder).as_posix().encode() + path.read_bytes())
    return digest.hexdigest()


def main(folder: Path) -> None:
    """Film into a folder. An eighth of the rays finds the light that bounces: the same code in a
    fraction of the time.
    """
    lighting.AMBIENT_DIRECTIONS = 8
    digests = {}
    for name, options in FILMS.items():
        digests[f"{name}, pictures"] = digest_pictures(options)
        digests[f"{name}, files"] = digest_files(write_demo(folder / name, options, workers=1))
    print(json.dumps(digests))


if __name__ == "__main__":
    main(Path(sys.argv[1]))
