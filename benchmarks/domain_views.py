"""The views by which choices are made, of every domain: what a method is shown of them, kept on
disk, and what it should show.

Captures are rendered once, depth is computed once: another call with other weights only renders.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.instant_samples import (
    InstantSample,
    camera_arrays,
    stored_arrays,
    stored_cameras,
    write_arrays,
)
from ggvs_eval.contrib.training.samples.capture_source import draw_views, held_back_halves
from ggvs_eval.contrib.training.samples.samples import SampleMaker
from ggvs_eval.contrib.training.samples.training_data import (
    HELD_BACK,
    choose_views,
    domain_validation_plan,
    room_options,
)
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.domains import VALIDATION_SEEDS, find_domain
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.digest import digest_values
from ggvs_eval.jobs.processes import finish_all, worker_pool
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.offline.depth.consistency import describe_check
from ggvs_eval.pipelines.offline.sensor.sensor_depth import describe_filter

VERSION = 2  # counts up whenever equal plans give other views
REAL, REAL_TITLE = "real", "real hand-held"
REAL_CAPTURE = "hololens_rgbd"


@dataclass(frozen=True)
class ViewPlan:
    """Views of each domain.

    Attributes:
        targets: target views per seed.
        views: K.
        frames: instants of each view where the domain's rig is static; a hand-held camera has one.
        seeds: how many of the validation seeds.
        matcher: whose depth rigs get; sensors' depth is taken where there is one.
        size: of the images, pixels; each domain's own by default.
        alone: depth is not checked against that of the other sources, as `play` and `view` have it.
    """

    targets: int = 3
    views: int = 4
    frames: int = 1
    seeds: int = 1
    matcher: str = "sgbm"
    size: tuple[int, int] | None = None
    alone: bool = False


@dataclass(frozen=True)
class View:
    """One target view of a domain.

    Attributes:
        domain: its name.
        name: of the view within the domain.
        files: what is shown at each instant.
    """

    domain: str
    name: str
    files: tuple[Path, ...]

    def samples(self) -> Iterator[InstantSample]:
        """Yield, instant by instant, what a method is given of the view and what the target's
        camera saw.
        """
        for index, file in enumerate(self.files):
            sample = read_view(file)
            yield replace(sample, instant=replace(sample.instant, index=index))


def prepare_views(
    cache: Path, domains: Iterable[str], plan: ViewPlan, data: Path | None = None, workers: int = 1
) -> list[View]:
    """Return the views of domains; what is not on disk yet is rendered and gets its depth.

    Args:
        cache: where all of it is kept; several plans may share it.
        domains: their names; `REAL` is the held-back part of the real RGB-D sequence.
        plan: which views.
        data: folder with the real captures.
        workers: processes; a capture is one job.
    """
    jobs = []
    for name in domains:
        seeds: Sequence[int] = (0,) if name == REAL else VALIDATION_SEEDS[: plan.seeds]
        jobs += [(cache, name, seed, plan, data) for seed in seeds]
    missing = [
        job
        for job in jobs
        if not all(file.is_file() for view in views_of(*job[:4]) for file in view.files)
    ]
    if workers == 1:
        for job in missing:
            make_views(*job)
    elif missing:
        with worker_pool(min(workers, len(missing))) as pool:
            finish_all(
                pool, [pool.submit(make_views, *job) for job in missing], "captures of the domains"
            )
    return [view for job in jobs for view in views_of(*job[:4])]


def views_of(cache: Path, domain: str, seed: int, plan: ViewPlan) -> list[View]:
    """Return the views of one capture, whether they are on disk or not."""
    folder, hand_held = (
        cache / f"views-{_digest(domain, seed, plan)}",
        domain == REAL or find_domain(domain).hand_held,
    )
    views = []
    for number in range(plan.targets):
        frames = range(1 if hand_held else plan.frames)
        files = tuple(folder / f"{domain}-{seed}-{number:02d}-{frame:03d}.npz" for frame in frames)
        views.append(View(domain, f"{seed}-{number:02d}", files))
    return views


def make_views(cache: Path, domain: str, seed: int, plan: ViewPlan, data: Path | None) -> None:
    """Film one capture, or open the real one, and write its views that are not there yet."""
    capture, choices = (
        _real(data, plan) if domain == REAL else render_domain(cache, domain, seed, plan)
    )
    for frame in range(len(views_of(cache, domain, seed, plan)[0].files)):
        options = DepthRunOptions(plan.matcher).options()
        maker = SampleMaker(
            capture, replace(options, consistency=False) if plan.alone else options, frame
        )
        for view, (target, sources) in zip(
            views_of(cache, domain, seed, plan), choices, strict=True
        ):
            if not view.files[frame].is_file():
                write_view(
                    view.files[frame],
                    InstantSample(maker.instant(target, sources), maker.image(target)),
                )


def real_capture(data: Path | None) -> Path | None:
    """Return the real RGB-D sequence in a folder of captures; None where it is not there."""
    return data / REAL_CAPTURE if data is not None and (data / REAL_CAPTURE).is_dir() else None


Choices = list[tuple[Camera, list[Camera]]]


def render_domain(cache: Path, domain: str, seed: int, plan: ViewPlan) -> tuple[Capture, Choices]:
    """Film a procedural capture, once, and draw its views: targets with their sources."""
    rooms = domain_validation_plan(
        domain, plan.views, plan.targets, plan.seeds, plan.matcher, plan.size
    )
    options = room_options(seed, rooms)
    if not find_domain(domain).hand_held:
        options = replace(options, n_frames=plan.frames)
    name = f"{domain}-{seed}-{options.width}x{options.height}-{options.n_frames}"
    capture = open_capture(write_demo(cache / "captures" / name, options, workers=1))
    return capture, [choose_views(capture, rooms, seed, number) for number in range(plan.targets)]


def _real(data: Path | None, plan: ViewPlan) -> tuple[Capture, Choices]:
    """Return the held-back part of the real sequence.

    Its views are drawn as those of any sequence that networks learn from.
    """
    path = real_capture(data)
    if path is None:
        raise CaptureError(
            f"{data}: wanted a folder with the capture {REAL_CAPTURE}, got none; give --data"
        )
    held_back = held_back_halves(open_capture(path))[1]
    rule = replace(HELD_BACK, targets=plan.targets, views=plan.views, matcher=plan.matcher)
    return held_back, [
        draw_views(held_back, rule, REAL_CAPTURE, number) for number in range(plan.targets)
    ]


def _digest(domain: str, seed: int, plan: ViewPlan) -> str:
    """Return the names all that views depend on but their number."""
    depth = DepthRunOptions(plan.matcher).options()
    described = [str(each) for each in (depth.describe(), describe_check(), describe_filter())]
    shared = {
        name: value for name, value in asdict(plan).items() if name not in ("targets", "seeds")
    }
    if domain != REAL:
        rooms = domain_validation_plan(
            domain, plan.views, plan.targets, plan.seeds, plan.matcher, plan.size
        )
        described += [
            str(room_options(seed, rooms)),
            f"{find_domain(domain).gap} {find_domain(domain).span}",
        ]
    return digest_values(str(VERSION), domain, str(shared), *described)[:12]


def write_view(path: Path, sample: InstantSample) -> None:
    """Write what a method is shown at one instant; depth as it is, confidence in 8 bit."""
    instant = sample.instant
    arrays = camera_arrays([instant.target, *(source.camera for source in instant.sources)])
    for index, source in enumerate(instant.sources):
        confidence = np.rint(source.confidence * 255).astype(np.uint8)
        arrays |= {
            f"image{index}": source.image,
            f"depth{index}": source.depth,
            f"confidence{index}": confidence,
        }
    write_arrays(
        path,
        arrays | {"truth": sample.truth, "units_per_metre": np.float64(instant.units_per_metre)},
    )


def read_view(path: Path) -> InstantSample:
    """Read what `write_view` wrote.

    Raises:
        TrainingError: absent or damaged.
    """
    with stored_arrays(path) as arrays:
        target, *cameras = stored_cameras(arrays)
        views = []
        for index, camera in enumerate(cameras):
            confidence = arrays[f"confidence{index}"].astype(np.float32) / np.float32(255)
            views.append(
                SourceView(camera, arrays[f"image{index}"], arrays[f"depth{index}"], confidence)
            )
        truth: Image8 = arrays["truth"]
        return InstantSample(
            Instant(0, target, tuple(views), float(arrays["units_per_metre"])), truth
        )
