"""Planted registration errors of sensor depth against what the estimate finds.

``python -m benchmarks.depth_registration OUT [SEED ...]``
Every line is one room rendered as an RGB-D sequence (24 frames of 480x360) with one error planted in its depth maps.
"""

import argparse
import shutil
from dataclasses import dataclass, replace
from pathlib import Path
from time import process_time

import cv2
import numpy as np

from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets import open_capture
from ggvs_eval.pipelines.offline.sensor.registration import Registration
from ggvs_eval.pipelines.offline.sensor.registration_estimate import measure_registration

SEEDS = (101, 102, 1000)
ROOM = DemoOptions(layout="rgbd", n_frames=24, fps=10, width=480, height=360)


@dataclass(frozen=True)
class Fault:
    """Misregistration of depth: shifted by pixels, turned about its middle, multiplied, or of a later frame."""

    right_px: float = 0.0
    down_px: float = 0.0
    roll_deg: float = 0.0
    scale: float = 1.0
    delay_frames: int = 0

    def plant(self, room: Path, folder: Path) -> Path:
        """Return a copy of the room with this fault; the last depth map represents those after it."""
        shutil.rmtree(folder, ignore_errors=True)
        shutil.copytree(room, folder)
        files = sorted((folder / "depth").iterdir(), key=lambda file: int(file.stem))
        maps = [cv2.imread(str(file), cv2.IMREAD_UNCHANGED) for file in files]
        for index, file in enumerate(files):
            late = maps[min(index + self.delay_frames, len(maps) - 1)]
            cv2.imwrite(str(file), np.rint(self._moved(late) * self.scale).astype(np.uint16))
        return folder

    def _moved(self, depth: np.ndarray) -> np.ndarray:
        height, width = depth.shape
        cosine, sine = np.cos(np.radians(self.roll_deg)), np.sin(np.radians(self.roll_deg))
        turn = np.array([[cosine, -sine], [sine, cosine]])
        middle = (np.array([width, height]) - 1) / 2
        shift = middle - turn @ middle + np.array([self.right_px, self.down_px]) * width / ROOM.width
        return cv2.warpAffine(depth, np.c_[turn, shift], (width, height), flags=cv2.INTER_NEAREST)


FAULTS = (
    Fault(),
    Fault(right_px=4, down_px=-3),
    Fault(roll_deg=1),
    Fault(scale=0.95),
    Fault(delay_frames=1),
    Fault(right_px=-6, down_px=2, roll_deg=0.6, scale=1.03),
)


def main() -> None:
    """Print a line per room and fault."""
    arguments = argparse.ArgumentParser(description=__doc__)
    arguments.add_argument("out", type=Path, help="folder for the rooms, about 10 MB")
    arguments.add_argument("seeds", type=int, nargs="*", default=SEEDS)
    options = arguments.parse_args()
    for seed in options.seeds:
        room = write_demo(options.out / str(seed), replace(ROOM, seed=seed), 1)
        for fault in FAULTS:
            capture = open_capture(fault.plant(room, options.out / "planted"))
            started = process_time()
            measured = measure_registration(capture)
            seconds = process_time() - started
            if measured is None:
                print(seed, fault, "too few edges")
                continue
            applied = "nothing" if measured.applied == Registration() else measured.applied.describe(ROOM.width)
            print(
                f"{seed} {fault}: {measured.registration.describe(ROOM.width)}; mends {applied}; "
                f"{measured.displacement_px:.2f} +- {measured.error_px:.2f} px; warped neighbours "
                f"{measured.psnr_db[0]:.2f} -> {measured.psnr_db[1]:.2f} dB; {seconds:.0f} s",
                flush=True,
            )


if __name__ == "__main__":
    main()
