"""The validation that matters: how well views are rendered from a matcher's depth, leave-one-out on
a real instant.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from time import perf_counter

import pandas as pd

from benchmarks.depth_validation.figures import Figures, Measure, figures_of
from ggvs_eval.capture import Capture
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.pipelines.run.evaluate import render
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.protocol import CameraPath, Protocol
from ggvs_eval.run_folder import RunFolder, read_json, write_json

METHOD = "ours-geometric"
MEASURES = (
    Measure("PSNR", "dB", higher_is_better=True, target=29.0),
    Measure("preparation_s", "s", higher_is_better=False),
)


def evaluate_rendering(
    capture: Capture, protocol: Protocol, out: Path, matchers: Sequence[str], workers: int
) -> tuple[pd.DataFrame, Figures]:
    """PSNR of every test view per matcher, the target left out of everything, depth included.

    Args:
        capture: at its own size.
        protocol: test views, size and K; only PSNR is measured.
        out: one run folder per matcher below it; what is there is kept.
        matchers: names, see `find_matcher`.
        workers: processes.

    Returns:
        A line per matcher: PSNR in dB of each view and their mean, seconds of the preparation; and
        the figures.
    """
    short = replace(
        protocol,
        measurement=replace(protocol.measurement, metrics=("PSNR",), ceilings=False),
        path=CameraPath(poses=0),
    )
    lines, measured = {}, {}
    for name in matchers:
        root = out / name.replace(":", "-").replace("/", "-")
        fresh, started = not root.exists(), perf_counter()
        prepared = prepare(root, capture, short, workers, DepthRunOptions(name), [METHOD])
        seconds = _preparation_seconds(root, perf_counter() - started if fresh else math.nan)
        render(prepared, workers)
        views = score(RunFolder(root), workers).per_view("PSNR").iloc[0]
        lines[name] = {**views.to_dict(), "mean": float(views.mean()), "preparation_s": seconds}
        measured[name] = {"PSNR": float(views.mean()), "preparation_s": seconds}
    return pd.DataFrame.from_dict(lines, orient="index"), figures_of(
        "rendering", MEASURES, measured
    )


def _preparation_seconds(root: Path, seconds: float) -> float:
    """Return the time a run folder took to prepare from nothing.

    NaN, not measured, where a killed call had done part of it.

    A later call finds the depth there and takes no time, so the first one's is kept.
    """
    record = root / "preparation.json"
    if math.isfinite(seconds):
        write_json(record, {"seconds": seconds})
    return float(read_json(record)["seconds"]) if record.is_file() else math.nan
