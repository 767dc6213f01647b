"""Depth of a wide rig by each choice: ``python -m benchmarks.wide_rigs --data FOLDER``, of people
in a dome and of rooms.

Renders views from the depth that each choice gives and prints PSNR, SSIM (means over frames) and
seconds of a core per map. The validation cameras of the dome decide, together with rooms
(`--domains`); the test cameras (`--cameras test`) are reported.
"""

import argparse
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from time import process_time

import pandas as pd

from benchmarks.domain_views import ViewPlan, render_domain
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.compute_device import one_thread
from ggvs_eval.contrib.training.samples.samples import SampleMaker
from ggvs_eval.contrib.worlds.domains import VALIDATION_SEEDS
from ggvs_eval.datasets import open_capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.files.images import quantise
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.consistency import WIDE_SHARE
from ggvs_eval.pipelines.offline.depth.fill_store import DepthPartners
from ggvs_eval.progress import track

DOME = "panoptic_basketball"
CAMERAS = {"validation": ("3", "8", "20", "27"), "test": ("0", "10", "15", "30")}
PIXELS_ALONE = "sgbm, agreement in pixels alone"
# column, capture without other targets, target, sources, frame
View = tuple[str, Capture, Camera, Sequence[Camera], int]


def main() -> None:
    """Print the table of the choices that are asked for."""
    arguments = _arguments()
    choices = {name: DepthRunOptions(name).options() for name in arguments.matchers}
    if arguments.pixels_alone:
        choices = {PIXELS_ALONE: DepthRunOptions("sgbm").options(), **choices}
    rows: list[dict[str, object]] = []
    for name, options in choices.items():
        consistency.WIDE_SHARE = 0.0 if name == PIXELS_ALONE else WIDE_SHARE
        views = [*_dome_views(arguments, options), *_room_views(arguments)]
        for view in track(views, name, len(views)):
            rows += [{"depth": name, **row} for row in _scores(view, options, arguments.methods)]
    scores = pd.DataFrame(rows)
    for metric, form in (("PSNR", "{:.2f}"), ("SSIM", "{:.4f}"), ("seconds per map", "{:.1f}")):
        table = scores.pivot_table(metric, ["depth", "method"], "view", "mean", sort=False)
        print(
            f"\n{metric}\n{table.assign(mean=table.mean(axis=1)).to_string(float_format=form.format)}"
        )


def _scores(
    view: View, options: DepthOptions, methods: Sequence[str]
) -> Iterator[Mapping[str, object]]:
    column, capture, target, sources, frame = view
    maker, started = SampleMaker(capture, options, frame), process_time()
    with one_thread():
        instant, truth = maker.instant(target, sources), maker.image(target)
        seconds = (process_time() - started) / len(sources)
        for method in methods:
            image = quantise(find_method(method).make().step(replace(instant, index=0)).image)
            scores = {
                "PSNR": psnr(image, truth),
                "SSIM": ssim(image, truth),
                "seconds per map": seconds,
            }
            yield {"view": column, "method": method, **scores}


def _dome_views(arguments: argparse.Namespace, options: DepthOptions) -> Iterator[View]:
    """Yield each held-out camera at each frame.

    Held-out cameras are sources and partners of none.
    """
    if arguments.data is None:
        return
    capture = open_capture(arguments.data / DOME)
    held_out = {*CAMERAS["test"], *CAMERAS[arguments.cameras]}
    for name in CAMERAS[arguments.cameras]:
        seen = capture.without(
            [each for each in capture.camera_names if each in held_out - {name}], "held out"
        )
        target = seen.camera(name)
        sources = [
            each.camera for each in DepthPartners(seen, options).sources(target, arguments.views)
        ]
        yield from ((name, seen, target, sources, frame) for frame in arguments.frames)


def _room_views(arguments: argparse.Namespace) -> Iterator[View]:
    plan = ViewPlan(arguments.targets, arguments.views, seeds=arguments.seeds)
    for domain in arguments.domains:
        for seed in VALIDATION_SEEDS[: arguments.seeds]:
            capture, choices = render_domain(arguments.out / "domains", domain, seed, plan)
            yield from ((domain, capture, target, sources, 0) for target, sources in choices)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--matchers", nargs="+", default=["sgbm"], help="names, see `ggvs-eval prepare --help`"
    )
    parser.add_argument(
        "--pixels-alone",
        action="store_true",
        help="also sgbm whose depths agree by reprojection alone",
    )
    parser.add_argument("--methods", nargs="+", default=["ours-geometric", "ours"])
    parser.add_argument(
        "--data", type=Path, default=None, help=f"folder with {DOME}; without, rooms alone"
    )
    parser.add_argument("--cameras", choices=list(CAMERAS), default="validation")
    parser.add_argument("--frames", type=int, nargs="+", default=[0, 20])
    parser.add_argument("--views", type=int, default=4, help="K")
    parser.add_argument(
        "--domains", nargs="*", default=[], help="rooms, see `ggvs_eval.contrib.worlds.domains`"
    )
    parser.add_argument("--seeds", type=int, default=1, help="how many of the validation seeds")
    parser.add_argument("--targets", type=int, default=3, help="target views per seed")
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder in which rooms are kept"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
