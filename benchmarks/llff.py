"""Tabulate runs on NeRF's Real Forward-Facing set (LLFF) by each way of measuring: ``python -m
benchmarks.llff RUN [RUN ...]``.

RUN is a folder of `ggvs-eval run RUN --capture SCENE --protocol llff_3view_SCENE`. The way of
measuring moves a number more than most methods differ, so every way that published values use is
shown, each with the values that follow it.
"""

import argparse
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
from scipy import stats

from ggvs_eval.files.images import read_image
from ggvs_eval.measured_frames import measured_frame
from ggvs_eval.metrics.stream import score_view
from ggvs_eval.pipelines.run.score_view import metric_options
from ggvs_eval.protocol import Measurement, WayName
from ggvs_eval.reports.tables.published import published_values
from ggvs_eval.run_folder import RunFolder, frame_path, read_json

METRICS = ("PSNR", "SSIM", "LPIPS")
DECIMALS = {"PSNR": 2, "SSIM": 3, "LPIPS": 3}
OURS = "ours"
WAYS: dict[WayName, str] = {
    "mvsnerf": "MVSNeRF's notebook",
    "enerf": "central 80 %",
    "as-is": "whole frame",
}
Scores = dict[str, dict[str, np.ndarray]]  # label -> metric -> a value per test view


def main() -> None:
    """Print both tables."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="+", help="scored run folders, one per scene")
    scenes = {root.name: score_run(RunFolder(root)) for root in parser.parse_args().runs}
    names = {root: read_json(root / "methods.json")["names"] for root in parser.parse_args().runs}
    titles = {label: title for each in names.values() for label, title in each.items()}
    print("\n".join((*means_table(scenes, titles), "", *differences_table(scenes, titles))))


def score_run(run: RunFolder) -> dict[WayName, Scores]:
    """Measure every method of a run by each way."""
    protocol = run.protocol()
    scores: dict[WayName, Scores] = {}
    for way in WAYS:
        measurement = replace(protocol.measurement, as_=way, metrics=METRICS)
        scores[way] = {}
        for label in run.labels():
            values: dict[str, list[float]] = {metric: [] for metric in METRICS}
            for view in protocol.views.test:
                read = partial(_pair, run, label, view, measurement)
                measured = score_view(
                    map(read, protocol.frames.numbers), METRICS, metric_options(measurement)
                )
                for metric, _, value in measured.values:
                    values[metric].append(value)
            scores[way][label] = {metric: np.array(each) for metric, each in values.items()}
    return scores


def _pair(
    run: RunFolder, label: str, view: str, measurement: Measurement, frame: int
) -> tuple[np.ndarray, np.ndarray]:
    files = frame_path(run.renders(label, view), frame), frame_path(run.truth(view), frame)
    rendered, truth = (measured_frame(read_image(file), measurement) for file in files)
    return rendered, truth


def means_table(
    scenes: Mapping[str, Mapping[WayName, Scores]], titles: Mapping[str, str]
) -> Iterator[str]:
    """Yield the means over the test views of each scene, PSNR / SSIM / LPIPS, and what is published
    by the same way.
    """
    labels = list(titles)
    yield f"| scene | measured as | {' | '.join(titles[label] for label in labels)} | published |"
    yield "|" + " --- |" * (len(labels) + 3)
    for scene, ways in scenes.items():
        for way, scores in ways.items():
            cells = [_cell(scores[label]) if label in scores else "not run" for label in labels]
            published = _published(scene) if way == "mvsnerf" else {}
            others = "; ".join(f"{method} {values}" for method, values in published.items())
            yield f"| {scene} | {WAYS[way]} | {' | '.join(cells)} | {others} |"


def _published(scene: str) -> dict[str, str]:
    """Return the values of the protocol of a scene by method, which were measured by the way
    `mvsnerf`.
    """
    values: dict[str, dict[str, str]] = {}
    for each in published_values():
        if each.protocol == f"llff_3view_{scene}":
            values.setdefault(each.method, {})[each.metric] = each.value
    return {
        method: " / ".join(by_metric[metric] for metric in METRICS)
        for method, by_metric in values.items()
    }


def _cell(values: Mapping[str, np.ndarray]) -> str:
    return " / ".join(f"{values[metric].mean():.{DECIMALS[metric]}f}" for metric in METRICS)


def differences_table(
    scenes: Mapping[str, Mapping[WayName, Scores]], titles: Mapping[str, str]
) -> Iterator[str]:
    """Tabulate the PSNR of `ours` minus that of every other method, paired by view, with half of
    the 95 % interval.
    """
    labels = [label for label in titles if label != OURS]
    yield f"| scene | PSNR minus that of | {' | '.join(titles[label] for label in labels)} |"
    yield "| --- | --- |" + " ---: |" * len(labels)
    for scene, ways in scenes.items():
        for way, scores in ways.items():
            gains = [
                scores[OURS]["PSNR"] - scores[label]["PSNR"] if label in scores else None
                for label in labels
            ]
            cells = [
                "not run" if gain is None else f"{gain.mean():+.2f} ± {_half_width(gain):.2f}"
                for gain in gains
            ]
            yield f"| {scene} | {WAYS[way]} | {' | '.join(cells)} |"


def _half_width(values: np.ndarray) -> float:
    return float(stats.t.ppf(0.975, len(values) - 1) * values.std(ddof=1) / np.sqrt(len(values)))


if __name__ == "__main__":
    main()
