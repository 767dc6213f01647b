"""Methods compared per domain: ``python -m benchmarks.domain_validation``, a part of ``make
validate``.

Prints a table of methods by domains for each metric and writes out/validate_domains.json. Choices
may be made by it: it shows validation seeds and the held-back part of the real sequence, never a
test capture.
"""

import argparse
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.domain_views import (
    REAL,
    REAL_CAPTURE,
    REAL_TITLE,
    View,
    ViewPlan,
    prepare_views,
    real_capture,
)
from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.worlds.domains import DOMAINS
from ggvs_eval.errors import WeightsError
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.method import Method
from ggvs_eval.metrics.image.lpips import lpips_between, lpips_features
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.metrics.time.strred import strred
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json

METHODS = ("ours", "ours-geometric", "distance-based")
METRICS = {"PSNR": ".2f", "SSIM": ".4f", "LPIPS": ".4f", "STED": ".2f"}
LPIPS_NET = "vgg"
DIFFERENCE = "{} - {}"

Makers = Mapping[str, Callable[[], Method]]


def main() -> None:
    """Print the tables of the methods and domains that are asked for."""
    arguments = _arguments()
    methods = {label: find_method(label).make for label in arguments.methods}
    plan = ViewPlan(
        arguments.targets,
        arguments.views,
        arguments.frames,
        arguments.seeds,
        arguments.matcher,
        alone=arguments.alone,
    )
    scores = validate_domains(
        methods,
        arguments.out / "domains",
        arguments.domains,
        plan,
        arguments.data,
        workers=arguments.jobs,
    )
    print(show_tables(scores))
    absent = REAL in arguments.domains and REAL not in set(scores["domain"])
    not_computed = (
        [f"{REAL_TITLE}: no {REAL_CAPTURE} in {arguments.data}; give --data"] if absent else []
    )
    for line in not_computed:
        print(f"not computed: {line}")
    write_scores(arguments.out / "validate_domains.json", scores, list(methods), not_computed)
    print(arguments.out / "validate_domains.json")


def validate_domains(
    methods: Makers,
    cache: Path,
    domains: Iterable[str] = (*DOMAINS, REAL),
    plan: ViewPlan = ViewPlan(),  # noqa: B008 - frozen
    data: Path | None = None,
    *,
    workers: int = 1,
    perceptual: bool = True,
) -> pd.DataFrame:
    """Score methods on the views of domains.

    Args:
        methods: how each is made, afresh for each view: a label of the registry, or any candidate,
            needs no file.
        cache: where captures and depth are kept, so that another call only renders.
        domains: their names; the real sequence takes part only where `data` has it.
        plan: which views.
        data: folder with the real captures.
        workers: processes that film and compute depth; methods render in this one.
        perceptual: whether LPIPS is computed too, which takes longer than rendering.

    Returns:
        One row per domain, view and method: PSNR in dB, SSIM, LPIPS (NaN where its weights have not
        been fetched), and of views with several instants STED.
    """
    present = [name for name in domains if name != REAL or real_capture(data)]
    views = prepare_views(cache, present, plan, data, workers)
    rows = [
        row
        for view in track(views, "views of the domains", len(views))
        for row in score_view(view, methods, perceptual)
    ]
    return pd.DataFrame(rows)


def score_view(view: View, methods: Makers, perceptual: bool = True) -> list[dict[str, object]]:
    """Render one view by every method and score it, a row each."""
    samples = list(view.samples())
    truths = [sample.truth for sample in samples]
    features = [_features(truth) for truth in truths] if perceptual else [None] * len(truths)
    rows = []
    for label, make in methods.items():
        method = make()
        rendered = [quantise(method.step(sample.instant).image) for sample in samples]
        row: dict[str, object] = {"domain": view.domain, "view": view.name, "method": label}
        row["PSNR"] = float(np.mean([psnr(*pair) for pair in zip(rendered, truths, strict=True)]))
        row["SSIM"] = float(np.mean([ssim(*pair) for pair in zip(rendered, truths, strict=True)]))
        row["LPIPS"] = float(
            np.mean([_lpips(image, truth) for image, truth in zip(rendered, features, strict=True)])
        )
        if len(rendered) > 1:
            row["STED"] = float(strred(rendered, truths).strred)
        rows.append(row)
    return rows


def mean_scores(scores: pd.DataFrame, metric: str) -> pd.DataFrame:
    """Means of a metric, methods by domains in the order in which they came, with the mean over
    domains as the last column.

    Below them, for each method after the first, the first one minus it.
    """
    table = scores.pivot_table(metric, "method", "domain", "mean", sort=False)
    table = table.reindex(
        index=scores["method"].unique(), columns=scores["domain"].unique()
    ).dropna(axis=1, how="all")
    first, *others = table.index
    for other in others:
        table.loc[DIFFERENCE.format(first, other)] = table.loc[first] - table.loc[other]
    return table.assign(mean=table.mean(axis=1))


def show_tables(scores: pd.DataFrame) -> str:
    """Return the tables of all metrics as text."""
    blocks = []
    for metric, form in METRICS.items():
        if metric in scores and scores[metric].notna().any():
            table = mean_scores(scores, metric)
            text = table.to_string(float_format=lambda value, form=form: format(value, form))
            blocks.append(f"{metric}\n{text}")
    return "\n\n".join(blocks)


def write_scores(
    path: Path, scores: pd.DataFrame, methods: list[str], not_computed: list[str]
) -> None:
    """Write every row, the means, and what was left out."""
    means = {
        metric: mean_scores(scores, metric).round(5).to_dict(orient="index")
        for metric in METRICS
        if metric in scores and scores[metric].notna().any()
    }
    rows = scores.astype(object).where(scores.notna(), None).to_dict(orient="records")
    command = "python -m benchmarks.domain_validation"
    write_json(
        path,
        {
            "command": command,
            "methods": methods,
            "means": means,
            "rows": rows,
            "not_computed": not_computed,
        },
    )


def _features(truth: Image8) -> object | None:
    """Compute the LPIPS features of a truth; None where its weights have not been fetched."""
    try:
        return lpips_features(truth, LPIPS_NET)
    except WeightsError:
        return None


def _lpips(rendered: Image8, truth: object | None) -> float:
    return (
        float("nan")
        if truth is None
        else lpips_between(lpips_features(rendered, LPIPS_NET), truth, LPIPS_NET)
    )


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--methods",
        nargs="+",
        default=list(METHODS),
        help="labels; the first is checked against the others",
    )
    parser.add_argument("--domains", nargs="+", default=[*DOMAINS, REAL], choices=[*DOMAINS, REAL])
    parser.add_argument(
        "--seeds", type=int, default=1, help="how many of the three validation seeds"
    )
    parser.add_argument("--targets", type=int, default=3, help="target views per seed")
    parser.add_argument("--views", type=int, default=4, help="K")
    parser.add_argument(
        "--frames", type=int, default=1, help="instants per view of fixed rigs; 2 or more give STED"
    )
    parser.add_argument("--matcher", default="sgbm", help="whose depth rigs get")
    parser.add_argument(
        "--alone",
        action="store_true",
        help="depth as play and view have it, not checked against other sources'",
    )
    parser.add_argument("--data", type=Path, default=None, help=f"folder with {REAL_CAPTURE}")
    parser.add_argument(
        "--out",
        type=Path,
        default=Path("out"),
        help="folder for validate_domains.json and what is kept",
    )
    parser.add_argument(
        "--jobs", type=int, default=usable_cpus(), help="processes that film and compute depth"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
