"""Published values of the paper: grey rows with their source and caveats, never mixed with measured ones."""

import csv
from collections.abc import Sequence
from functools import cache
from importlib import resources

from ggvs_eval.reports.model.table import Cell, Row

SOURCE = "Ha et al., Geometry-guided Online 3D Video Synthesis with Multi-View Temporal Consistency, CVPR 2025"
CAVEATS = (
    "The paper blends with a trained network and takes depth from RAFT-Stereo; the methods measured here need not.",
    "It gives the number of test views (9 on DyNeRF), not which; the choice moves PSNR by more than a decibel.",
    "It leaves the backbone of LPIPS and the variants of STED and SSIM open; ours are in the protocol.",
)
PAPER = " (paper)"  # ends the name of the paper's rows, which are not the only published ones
UNITS = {"PSNR": "dB"}
HIGHER_IS_BETTER = ("PSNR", "SSIM", "TCC")
TIMING_WORDS = {
    "forward_splatting_ms": "forward splatting",
    "tsdf_ms": "TSDF",
    "blending_tensorrt_ms": "blending, TensorRT",
    "blending_no_tensorrt_ms": "blending, no TensorRT",
    "total_no_tensorrt_ms_text": "total, no TensorRT (as its text says)",
    "total_ms_text": "total (as its text says)",
}


@cache
def read_published(name: str) -> dict[str, dict[str, dict[str, str]]]:
    """One of the paper's tables.

    Args:
        name: ``quality``, ``consistency``, ``ablation`` or ``timing``.

    Returns:
        dataset -> method -> metric -> value, with the digits that the paper prints.
    """
    text = (resources.files("ggvs_eval.reports.tables") / "data" / f"{name}.csv").read_text(encoding="utf-8")
    values: dict[str, dict[str, dict[str, str]]] = {}
    for line in csv.DictReader(line for line in text.splitlines() if not line.startswith("#")):
        values.setdefault(line["dataset"], {}).setdefault(line["method"], {})[line["metric"]] = line["value"]
    return values


def is_higher_better(metric: str) -> bool:
    """Direction of one of the paper's metrics."""
    return metric in HIGHER_IS_BETTER


def paper_dataset(name: str) -> str:
    """The paper's own name of a data set; empty where it has none of that name."""
    return next((dataset for dataset in read_published("quality") if dataset.lower() == name.lower()), "")


def published_rows(name: str, dataset: str, metrics: Sequence[str]) -> tuple[Row, ...]:
    """The paper's rows for one dataset, shown in grey below what was measured on its terms, see `why_not_beside`."""
    methods = read_published(name).get(paper_dataset(dataset), {})
    return tuple(
        Row(f"{method}{PAPER}", tuple(published_cell(values.get(metric)) for metric in metrics), "published")
        for method, values in methods.items()
    )


def published_cell(text: str | None) -> Cell:
    """A published value with its own digits, or the word that there is none."""
    return Cell("not reported") if text is None else Cell(text, float(text))
