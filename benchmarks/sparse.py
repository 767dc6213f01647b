"""Tabulate runs of the sparse protocols next to published values: ``python -m benchmarks.sparse RUN
[RUN ...]``.

RUN is a scored folder of `ggvs-eval run RUN --protocol n3v_sparse3_instant` or
`llff_sparse3_SCENE`. Published methods are fitted to the scene; what is measured here is fitted to
nothing. Intervals are over test pictures, paired; one picture has none.
"""

import argparse
import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from scipy import stats

from ggvs_eval.arrays import Array
from ggvs_eval.reports.model.measured import MeasuredRun, read_scores
from ggvs_eval.reports.tables.published import PublishedValue, published_values

METRICS = ("PSNR", "SSIM", "LPIPS")
DECIMALS = {"PSNR": 2, "SSIM": 3, "LPIPS": 3}
OURS = "ours"
PICTURES = Path(__file__).with_name("llff_sparse_pictures.csv")
BEST_LINES = 3


@dataclass(frozen=True)
class Lead:
    """The PSNR of GGVS minus that of another method, in dB.

    Attributes:
        mean: over test pictures.
        half_width: half of the 95 % interval, paired by picture; None for fewer than two.
    """

    mean: float
    half_width: float | None = None

    @property
    def text(self) -> str:
        """The difference and its interval, as a cell."""
        interval = "" if self.half_width is None else f" ± {self.half_width:.2f}"
        return f"{self.mean:+.2f}{interval}"


@dataclass(frozen=True)
class SparseRow:
    """One scene with one number of sources, next to the best published PSNR.

    Attributes:
        published: method -> metric -> value as printed.
        best: the published method of the highest PSNR.
        lead: over that.
    """

    run: MeasuredRun
    scene: str
    published: dict[str, dict[str, str]]
    best: str
    lead: Lead

    @property
    def place(self) -> str:
        """Scene and number of sources, as the first two cells."""
        return f"{self.scene} | {self.run.protocol.synthesis.k}"


def main() -> None:
    """Print both tables, and the lines that GGVS leads by most."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("runs", type=Path, nargs="+", help="scored run folders")
    rows = [sparse_row(read_scores(root)) for root in parser.parse_args().runs]
    tables = (published_table(rows), measured_table(rows), best_lines(rows))
    print("\n\n".join("\n".join(table) for table in tables))


def sparse_row(run: MeasuredRun) -> SparseRow:
    """Compare a run with the published values of its protocol."""
    values = [value for value in published_values() if value.protocol == run.protocol.name]
    published: dict[str, dict[str, str]] = {}
    for value in values:
        published.setdefault(value.method, {})[value.metric] = value.value
    best = max(published, key=lambda method: float(published[method]["PSNR"]))
    scene = values[0].scene
    return SparseRow(run, scene, published, best, _published_lead(run, scene, best, values))


def _published_lead(
    run: MeasuredRun, scene: str, best: str, values: Sequence[PublishedValue]
) -> Lead:
    pictures = _pictures(scene, run.protocol.synthesis.k, best)
    if len(pictures):
        return _lead(psnr_of_views(run, OURS) - pictures)
    (psnr,) = (value.value for value in values if (value.method, value.metric) == (best, "PSNR"))
    return Lead(float(psnr_of_views(run, OURS).mean()) - float(psnr))


@cache
def _read_pictures() -> tuple[dict[str, str], ...]:
    lines = PICTURES.read_text(encoding="utf-8").splitlines()
    return tuple(csv.DictReader(line for line in lines if not line.startswith("#")))


def _pictures(scene: str, n_sources: int, method: str) -> Array:
    """Return the published PSNR of each test picture in order; empty if only the mean is known."""
    key = (scene, str(n_sources), method)
    lines = [
        line
        for line in _read_pictures()
        if (line["scene"], line["n_sources"], line["method"]) == key
    ]
    return np.array(
        [float(line["psnr"]) for line in sorted(lines, key=lambda line: int(line["picture"]))]
    )


def psnr_of_views(run: MeasuredRun, label: str) -> Array:
    """Return the PSNR of each test view of a method, in the protocol's order."""
    return _values(run, label, "PSNR")


def _values(run: MeasuredRun, label: str, metric: str) -> Array:
    table = run.results.table
    of_method = table[(table["metric"] == metric) & (np.array(run.results.row_labels) == label)]
    by_view = of_method.groupby("view")["value"].mean()
    return np.array([by_view[view] for view in run.protocol.views.test])


def _lead(differences: Array) -> Lead:
    n_pictures = len(differences)
    if n_pictures < 2:
        return Lead(float(differences.mean()))
    error = differences.std(ddof=1) / np.sqrt(n_pictures)
    return Lead(float(differences.mean()), float(stats.t.ppf(0.975, n_pictures - 1) * error))


def published_table(rows: Sequence[SparseRow], head: str = "scene | sources") -> Iterator[str]:
    """Yield PSNR / SSIM / LPIPS of GGVS and of the published method of the highest PSNR, and the
    lead over that.
    """
    yield f"| {head} | GGVS (online) | best published | PSNR |"
    yield "| --- | --- | --- | --- | ---: |"
    for row in rows:
        published = f"{row.best} {_printed(row.published[row.best])}"
        yield f"| {row.place} | {_measured(row.run, OURS)} | {published} | {row.lead.text} |"


def best_lines(rows: Sequence[SparseRow]) -> Iterator[str]:
    """Yield the rows that GGVS leads by most."""
    return published_table(
        sorted(rows, key=lambda row: -row.lead.mean)[:BEST_LINES], "scene | cameras"
    )


def _printed(values: dict[str, str]) -> str:
    return " / ".join(values[metric] for metric in METRICS)


def _measured(run: MeasuredRun, label: str) -> str:
    return " / ".join(
        f"{_values(run, label, metric).mean():.{DECIMALS[metric]}f}" for metric in METRICS
    )


def measured_table(rows: Sequence[SparseRow]) -> Iterator[str]:
    """Yield the PSNR of every method measured here, and in brackets that of GGVS minus it."""
    first = rows[0].run
    labels = [label for label in first.labels if label != OURS]
    yield (
        f"| scene | sources | PSNR of GGVS | {' | '.join(first.name(label) for label in labels)} |"
    )
    yield "| --- | ---: | ---: |" + " ---: |" * len(labels)
    for row in rows:
        ours = psnr_of_views(row.run, OURS)
        cells = []
        for label in labels:
            if label not in row.run.labels:
                cells.append("not run")
                continue
            others = psnr_of_views(row.run, label)
            cells.append(f"{others.mean():.2f} ({_lead(ours - others).text})")
        yield f"| {row.place} | {ours.mean():.2f} | {' | '.join(cells)} |"


if __name__ == "__main__":
    main()
