"""Estimated scores of perfect renderings and the real ones, of rooms that are filmed twice and
coded.

    python -m benchmarks.ceiling_accuracy [--seeds 11 12 13] [--crfs 0 12 23] [--sigmas 0.5 1 2 4]

Each room is filmed without noise and twice with noise of other seeds (`demo --noise-seed`); the
estimate sees one noisy film.
"""

import tempfile
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import tyro

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.shots import rig_shots
from ggvs_eval.contrib.worlds.room.lighting import Instant
from ggvs_eval.files.coding import read_coding
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.metrics.ceilings import ceilings
from ggvs_eval.metrics.registry import ceiling_metrics
from ggvs_eval.metrics.stream import score_views

TOLERANCES = {"PSNR": 1.0, "SSIM": 0.01, "TCC": 0.01, "STED": 0.3}  # STED: relative


@dataclass(frozen=True)
class Options:
    """Options of what is filmed.

    Attributes:
        seeds: rooms; not those of the demos.
        cameras: of each room's rig.
        crfs: rate factors of x264.
        sigmas: standard deviations of the sensor's noise, of 255 levels.
        width: pixels.
        height: pixels.
        n_frames: of each film.
        garden: a garden instead of a room.
    """

    seeds: tuple[int, ...] = (11, 12, 13)
    cameras: tuple[int, ...] = (3,)
    crfs: tuple[float, ...] = (0, 12, 23)
    sigmas: tuple[float, ...] = (0.5, 1, 2, 4)
    width: int = 384
    height: int = 288
    n_frames: int = 24
    garden: bool = False


@dataclass(frozen=True)
class Comparison:
    """One ceiling of one film.

    Attributes:
        real: metric -> score of the perfect rendering.
        estimate: metric -> what was predicted; empty where it is unknown.
        bounds: metric -> that the prediction is a bound, and on which side.
    """

    real: dict[str, float]
    estimate: dict[str, float]
    bounds: dict[str, str]

    def holds(self, metric: str) -> bool | None:
        """True if the prediction is what it says; None where it says nothing."""
        if metric not in self.estimate:
            return None
        real, predicted = self.real[metric], self.estimate[metric]
        if metric in self.bounds:
            return real <= predicted if self.bounds[metric] == "at most" else real >= predicted
        error = abs(predicted - real) / (real if metric == "STED" else 1)
        return error <= TOLERANCES[metric]

    def cell(self, metric: str) -> str:
        """Real score / prediction, with a cross where it does not hold."""
        real, predicted = self.real[metric], self.estimate.get(metric)
        side = f"{self.bounds[metric]} " if metric in self.bounds else ""
        text = "unknown" if predicted is None else f"{side}{predicted:.3f}"
        return f"{real:.3f} / {text}{' ✗' if self.holds(metric) is False else ''}"


def film(options: DemoOptions, camera: int, instants: Sequence[Instant]) -> list[Image8]:
    """Film one camera of a room, before any codec."""
    return [
        frame.image
        for frame in Footage(options, rig_shots(options)[camera], instants.__getitem__).frames()
    ]


def compare(
    clean: Sequence[Image8], first: Sequence[Image8], second: Sequence[Image8], crf: float
) -> dict[str, Comparison]:
    """Return both ceilings of the first of two recordings, coded at a rate factor."""
    with tempfile.TemporaryDirectory() as folder:
        paths = [Path(folder) / f"{number}.mp4" for number in (1, 2)]
        for path, frames in zip(paths, (first, second), strict=True):
            write_video(path, frames, 30, crf)
        captured, again = (list(VideoFrames(path).frames(0, len(clean))) for path in paths)
        bounds = ceilings(
            lambda: iter(captured),
            ceiling_metrics(),
            coding=read_coding(paths[0], range(len(clean))),
        )
    scored = score_views(
        ((pair[:2], pair[2]) for pair in zip(clean, again, captured, strict=True)),
        ceiling_metrics(),
    )
    real = [
        {
            name: float(np.mean([value for other, _, value in one.values if other == name]))
            for name in ceiling_metrics()
        }
        for one in scored
    ]
    return {
        "noise-free": Comparison(real[0], bounds.noise_free, dict(bounds.bounds)),
        "second": Comparison(real[1], bounds.second_recording, dict(bounds.second_bounds)),
    }


def compare_rooms(options: Options) -> Iterator[tuple[str, str, Comparison]]:
    """Films, kind of ceiling, and how the estimate compares."""
    for seed in options.seeds:
        room = DemoOptions(
            seed=seed,
            scene="garden" if options.garden else "room",
            width=options.width,
            height=options.height,
            n_frames=options.n_frames,
        )
        instants = [
            lit_room(seed, room.scene).at(index / room.fps) for index in range(room.n_frames)
        ]
        for camera in options.cameras:
            clean = film(replace(room, noise_sigma_255=0), camera, instants)
            for sigma in options.sigmas:
                noisy = replace(room, noise_sigma_255=sigma)
                recordings = [
                    film(replace(noisy, noise_seed=number), camera, instants) for number in (1, 2)
                ]
                for crf in options.crfs:
                    for kind, comparison in compare(clean, *recordings, crf).items():
                        yield f"{seed}, camera {camera} | {crf:g} | {sigma:g}", kind, comparison


def main(options: Options) -> None:
    """Print the table, and how many of the predictions hold."""
    held: list[bool | None] = []
    print(f"| room | crf | noise | ceiling | {' | '.join(ceiling_metrics())} |")
    print("| --- | ---: | ---: | --- |" + " --- |" * len(ceiling_metrics()))
    for film_name, kind, comparison in compare_rooms(options):
        print(
            f"| {film_name} | {kind} | "
            f"{' | '.join(comparison.cell(name) for name in ceiling_metrics())} |",
            flush=True,
        )
        held += [comparison.holds(name) for name in ceiling_metrics()]
    print(f"\n{held.count(True)} hold, {held.count(False)} do not, {held.count(None)} are unknown")


if __name__ == "__main__":
    main(tyro.cli(Options))
