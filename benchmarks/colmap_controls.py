"""COLMAP consistency of a run's camera path against its controls: what must score high does, and
what must not does not.

``python -m benchmarks.colmap_controls RUN [--every 2] [--out out/colmap_controls.json]``
RUN is a scored run whose capture has true images along the path, as the demo's. The true path is
spoilt in ways that a measure without truth might like; the methods of the run are below.
"""

import argparse
import sys
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.more_metrics.colmap_consistency import colmap_consistency
from ggvs_eval.errors import GgvsError
from ggvs_eval.files.images import read_image
from ggvs_eval.metrics.image.sharpness import sharpness
from ggvs_eval.run_folder import RunFolder, frame_path, missing_frames, read_json, write_json

NOISE_255 = 20.0
BLUR_PX = 2.0
Images = list[Image8]


def _shuffled(images: Images) -> Images:
    return [images[index] for index in np.random.default_rng(0).permutation(len(images))]


def _noise(images: Images) -> Images:
    return [
        np.random.default_rng(index).integers(0, 256, image.shape, dtype=np.uint8)
        for index, image in enumerate(images)
    ]


def _noisy(images: Images) -> Images:
    grain = (
        np.random.default_rng(index).normal(0, NOISE_255, image.shape)
        for index, image in enumerate(images)
    )
    return [
        np.clip(np.rint(image + one), 0, 255).astype(np.uint8)
        for image, one in zip(images, grain, strict=True)
    ]


def _blurred(images: Images) -> Images:
    return [
        np.asarray(cv2.GaussianBlur(image, (0, 0), BLUR_PX), dtype=np.uint8) for image in images
    ]


CONTROLS: dict[str, Callable[[Images], Images]] = {
    "true path": lambda images: images,
    "shuffled": _shuffled,
    "nothing but noise": _noise,
    "one frozen image": lambda images: images[:1] * len(images),
    f"noise of {NOISE_255:g} levels": _noisy,
    f"blurred, sigma {BLUR_PX:g} px": _blurred,
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Print one line per control and method, and write them all."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("run", type=Path)
    parser.add_argument("--every", type=int, default=2, help="use every Nth pose")
    parser.add_argument("--out", type=Path, default=Path("out/colmap_controls.json"))
    options = parser.parse_args(arguments)
    try:
        write_json(options.out, measure(RunFolder(options.run), options.every))
    except GgvsError as error:
        sys.exit(f"colmap_controls: {error}")


def measure(run: RunFolder, every: int) -> dict[str, dict[str, Any]]:
    """Return the name of a control or method -> what `colmap_consistency` says, and the
    sharpness.
    """
    record = read_json(run.path_record)["cameras"]
    poses = range(0, len(record), every)
    cameras = [Camera.from_json(f"path{pose:04d}", record[pose]) for pose in poses]
    true = _images(run, "truth", poses)
    paths: dict[str, Images] = {name: control(true) for name, control in CONTROLS.items()}
    paths |= {
        label: _images(run, label, poses)
        for label in run.labels()
        if not missing_frames(run.path(label), poses)
    }
    measured: dict[str, dict[str, Any]] = {}
    for name, images in paths.items():
        consistency = colmap_consistency(images, cameras)
        measured[name] = asdict(consistency) | {
            "sharpness": float(np.mean([sharpness(image) for image in images]))
        }
        print(f"{name}: {measured[name]}", flush=True)
    for name in ("true path", "shuffled"):
        measured[f"{name}, cameras unknown"] = asdict(colmap_consistency(paths[name])) | {
            "sharpness": measured[name]["sharpness"]
        }
    return measured


def _images(run: RunFolder, label: str, poses: range) -> Images:
    return [read_image(frame_path(run.path(label), pose)) for pose in poses]


if __name__ == "__main__":
    main()
