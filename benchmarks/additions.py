"""Effect of each addition to the paper's method on its metric: ``python -m benchmarks.additions``.

Geometric weights, with each addition and without it, on views of validation rooms: single instants
of many views where colours and depth are at stake, few views over time where the past is. Prints a
table and writes out/additions.json. What does not pay is off by default.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.domain_views import View, ViewPlan, prepare_views
from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.worlds.domains import find_domain
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.metrics.image.corrected import apply_colour_map, fit_colour_map, unit_range
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.time.flicker import flicker
from ggvs_eval.metrics.time.strred import strred
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json

METHOD = "ours-geometric"
MEASURES = ("PSNR", "PSNR_cc", "PSNR in holes", "STED", "flicker")


@dataclass(frozen=True)
class Addition:
    """One option of `OnlineOptions` that the paper has not, what it is measured by, and where.

    Attributes:
        option: its name.
        off: its value without the addition, as in a label.
        on: and with it.
        measure: of `MEASURES`.
        domains: where it should pay.
        over_time: measured on few views of several instants; else on many of one.
    """

    option: str
    off: str
    on: str
    measure: str
    domains: tuple[str, ...]
    over_time: bool = False


ADDITIONS = (
    Addition("compensated", "false", "true", "PSNR", ("exposure", "plain", "arc")),
    Addition("settled", "false", "true", "PSNR", ("misplaced_depth", "plain", "arc")),
    Addition("forgiven_px", "0", "0.5", "PSNR", ("misplaced_depth", "plain", "arc")),
    Addition("recurrent_limit", "0", "0.85", "STED", ("plain", "arc", "exposure"), over_time=True),
    Addition(
        "remembered", "false", "true", "PSNR in holes", ("plain", "arc", "exposure"), over_time=True
    ),
)


def main() -> None:
    """Print the table of the additions and write it."""
    arguments = _arguments()
    plan = ViewPlan(
        arguments.targets, arguments.views, 1, arguments.seeds, size=tuple(arguments.size)
    )
    films = replace(plan, targets=arguments.films, frames=arguments.frames)
    rows = []
    for domain in arguments.domains:
        for over_time, chosen in ((False, plan), (True, films)):
            additions = [
                each for each in ADDITIONS if domain in each.domains and each.over_time == over_time
            ]
            views = (
                prepare_views(arguments.out / "additions", [domain], chosen, workers=arguments.jobs)
                if additions
                else []
            )
            for view in track(views, find_domain(domain).title, len(views)):
                rows += score_view(view, additions)
    table = mean_gains(pd.DataFrame(rows))
    print(table.to_string(index=False, float_format=lambda value: format(value, ".3f")))
    path = arguments.out / "additions.json"
    gains = table.astype(object).where(table.notna(), None).to_dict(orient="records")
    write_json(
        path,
        {
            "command": "python -m benchmarks.additions",
            "plan": asdict(plan),
            "gains": gains,
            "rows": rows,
        },
    )
    print(path)


def score_view(view: View, additions: Sequence[Addition]) -> list[dict[str, object]]:
    """Render a view with and without each addition, a row each: all measures."""
    samples = list(view.samples())
    holes = [unseen(sample) for sample in samples]
    rows: list[dict[str, object]] = []
    for addition in additions:
        for given, value in (("without", addition.off), ("with", addition.on)):
            method = find_method(f"{METHOD}+{addition.option}={value}").make()
            shown = [quantise(method.step(sample.instant).image) for sample in samples]
            about: dict[str, object] = {
                "domain": view.domain,
                "view": view.name,
                "addition": addition.option,
                "given": given,
            }
            rows.append(about | measures(shown, [sample.truth for sample in samples], holes))
    return rows


def measures(
    shown: Sequence[Image8], truths: Sequence[Image8], holes: Sequence[Mask]
) -> dict[str, float]:
    """All measures of one rendered view; those of single frames alone where there is one.

    Of holes their squared error, too.
    """
    pairs = list(zip(shown, truths, strict=True))
    errors = (
        np.concatenate(
            [
                (np.float64(a[hole]) - b[hole]).ravel()
                for (a, b), hole in zip(pairs, holes, strict=True)
            ]
        )
        / 255
    )
    values = {
        "PSNR": float(np.mean([psnr(*pair) for pair in pairs])),
        "PSNR_cc": float(np.mean([corrected_psnr(*pair) for pair in pairs])),
        "hole_values": float(errors.size),
        "hole_energy": float((errors**2).sum()),
    }
    if len(pairs) > 1:
        values |= {
            "STED": float(strred(shown, truths).strred),
            "flicker": float(flicker(pairs).excess),
        }
    return values


def corrected_psnr(shown: Image8, truth: Image8) -> float:
    """PSNR except for the target's own colour, which no source tells."""
    return psnr(
        apply_colour_map(fit_colour_map(shown[None], truth[None]), shown), unit_range(truth)
    )


def unseen(sample: InstantSample) -> Mask:
    """Return the mask what no source covers by half, as `PSNR_disoccluded` does, (H, W)."""
    instant = sample.instant
    near = instant.near_plane
    alphas = [
        splat_depth(view.camera, view.depth, instant.target, near=near).alpha
        for view in instant.sources
    ]
    return np.asarray(reduce(np.maximum, alphas) < COVERED_ALPHA)


def mean_gains(rows: pd.DataFrame) -> pd.DataFrame:
    """Tabulate every measure of every addition and domain without and with it.

    Holes count by their pixels.
    """
    keys = ["addition", "domain", "given"]
    means = rows.groupby(keys, sort=False).mean(numeric_only=True)
    sums = rows.groupby(keys, sort=False)[["hole_energy", "hole_values"]].sum()
    means["PSNR in holes"] = -10 * np.log10(sums["hole_energy"] / sums["hole_values"])
    found = (
        means[[name for name in MEASURES if name in means]].stack().rename_axis([*keys, "measure"])
    )
    table = found.unstack("given")[["without", "with"]].reset_index()
    order = {each.option: number for number, each in enumerate(ADDITIONS)}
    table["for"] = [
        name == _of(option).measure
        for option, name in zip(table["addition"], table["measure"], strict=True)
    ]
    return table.sort_values(by=["addition"], key=lambda names: names.map(order), kind="stable")


def _of(option: str) -> Addition:
    return next(each for each in ADDITIONS if each.option == option)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    domains = list(dict.fromkeys(domain for each in ADDITIONS for domain in each.domains))
    parser.add_argument("--domains", nargs="+", default=domains, choices=domains)
    parser.add_argument(
        "--seeds", type=int, default=1, help="how many of the three validation seeds"
    )
    parser.add_argument("--targets", type=int, default=9, help="target views per seed")
    parser.add_argument("--films", type=int, default=2, help="target views per seed over time")
    parser.add_argument("--views", type=int, default=4, help="K")
    parser.add_argument("--frames", type=int, default=16, help="instants of a view over time")
    parser.add_argument(
        "--size", type=int, nargs=2, default=(320, 240), help="of the images, pixels"
    )
    parser.add_argument(
        "--out", type=Path, default=Path("out"), help="folder for additions.json and what is kept"
    )
    parser.add_argument(
        "--jobs", type=int, default=usable_cpus(), help="processes that film and compute depth"
    )
    return parser.parse_args()


if __name__ == "__main__":
    main()
