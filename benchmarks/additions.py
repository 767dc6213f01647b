"""What each addition to the paper's method pays in the measure it is for: ``python -m benchmarks.additions``.

Geometric weights, with each addition and without it, on views of validation rooms; prints a table and writes out/additions.json.
What pays nowhere is off by default.
"""

import argparse
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import reduce
from pathlib import Path

import numpy as np
import pandas as pd

from benchmarks.domain_views import View, ViewPlan, prepare_views
from ggvs_eval.arrays import Image8, Mask
from ggvs_eval.files.images import quantise
from ggvs_eval.geometry.splat import COVERED_ALPHA, splat_depth
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.time.flicker import flicker
from ggvs_eval.metrics.time.strred import strred
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.progress import track
from ggvs_eval.run_folder import write_json
from ggvs_eval.synthetic.domains import find_domain
from ggvs_eval.training.instant_samples import InstantSample

METHOD = "ours-geometric"
MEASURES = {"PSNR": ".2f", "PSNR in holes": ".2f", "STED": ".2f", "flicker": ".2f"}


@dataclass(frozen=True)
class Addition:
    """One option of `OnlineOptions` that the paper has not, what it is measured by, and where.

    Attributes:
        option: its name.
        off: its value without the addition, as in a label.
        on: and with it.
        measure: of `MEASURES`.
        domains: where it should pay.
    """

    option: str
    off: str
    on: str
    measure: str
    domains: tuple[str, ...]


ADDITIONS = (
    Addition("compensated", "false", "true", "PSNR", ("exposure", "plain", "arc")),
    Addition("settled", "false", "true", "PSNR", ("misplaced_depth", "plain", "arc")),
    Addition("recurrent_limit", "0", "0.85", "STED", ("plain", "arc", "exposure")),
    Addition("remembered", "false", "true", "PSNR in holes", ("plain", "arc", "exposure")),
)


def main() -> None:
    """Print the table of the additions and write it."""
    arguments = _arguments()
    plan = ViewPlan(arguments.targets, arguments.views, arguments.frames, arguments.seeds, size=tuple(arguments.size))
    rows = []
    for domain in arguments.domains:
        domain_plan = ViewPlan(**{**asdict(plan), "targets": 3 * plan.targets}) if find_domain(domain).hand_held else plan
        views = prepare_views(arguments.out / "additions", [domain], domain_plan, workers=arguments.jobs)
        for view in track(views, find_domain(domain).title, len(views)):
            rows += score_view(view, [each for each in ADDITIONS if domain in each.domains])
    table = mean_gains(pd.DataFrame(rows))
    print(table.to_string(index=False, float_format=lambda value: format(value, ".3f")))
    command = f"python -m benchmarks.additions --frames {plan.frames} --targets {plan.targets} --seeds {plan.seeds}"
    path = arguments.out / "additions.json"
    write_json(path, {"command": command, "gains": table.to_dict(orient="records"), "rows": rows})
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
            about: dict[str, object] = {"domain": view.domain, "view": view.name, "addition": addition.option, "given": given}
            rows.append(about | measures(shown, [sample.truth for sample in samples], holes))
    return rows


def measures(shown: Sequence[Image8], truths: Sequence[Image8], holes: Sequence[Mask]) -> dict[str, float]:
    """All measures of one rendered view; those of single frames alone where there is one. Of holes their squared error, too."""
    pairs = list(zip(shown, truths, strict=True))
    errors = np.concatenate([(np.float64(a[hole]) - b[hole]).ravel() for (a, b), hole in zip(pairs, holes, strict=True)]) / 255
    values = {
        "PSNR": float(np.mean([psnr(*pair) for pair in pairs])),
        "hole_values": float(errors.size),
        "hole_energy": float((errors**2).sum()),
    }
    if len(pairs) > 1:
        values |= {"STED": float(strred(shown, truths).strred), "flicker": float(flicker(pairs).excess)}
    return values


def unseen(sample: InstantSample) -> Mask:
    """Mask what no source covers by half, as `PSNR_disoccluded` does, (H, W)."""
    instant = sample.instant
    near = instant.near_plane
    alphas = [splat_depth(view.camera, view.depth, instant.target, near=near).alpha for view in instant.sources]
    return np.asarray(reduce(np.maximum, alphas) < COVERED_ALPHA)


def mean_gains(rows: pd.DataFrame) -> pd.DataFrame:
    """Tabulate every measure of every addition and domain without and with it; holes count by their pixels."""
    keys = ["addition", "domain", "given"]
    means = rows.groupby(keys, sort=False).mean(numeric_only=True)
    sums = rows.groupby(keys, sort=False)[["hole_energy", "hole_values"]].sum()
    means["PSNR in holes"] = -10 * np.log10(sums["hole_energy"] / sums["hole_values"])
    found = means[[name for name in MEASURES if name in means]].stack().rename_axis([*keys, "measure"])
    table = found.unstack("given")[["without", "with"]].reset_index()
    order = {each.option: number for number, each in enumerate(ADDITIONS)}
    table["for"] = [name == _of(option).measure for option, name in zip(table["addition"], table["measure"], strict=True)]
    return table.sort_values(by=["addition"], key=lambda names: names.map(order), kind="stable")


def _of(option: str) -> Addition:
    return next(each for each in ADDITIONS if each.option == option)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    domains = list(dict.fromkeys(domain for each in ADDITIONS for domain in each.domains))
    parser.add_argument("--domains", nargs="+", default=domains, choices=domains)
    parser.add_argument("--seeds", type=int, default=1, help="how many of the three validation seeds")
    parser.add_argument("--targets", type=int, default=2, help="target views per seed, of hand-held cameras three times as many")
    parser.add_argument("--views", type=int, default=4, help="K")
    parser.add_argument("--frames", type=int, default=16, help="instants per view of fixed rigs")
    parser.add_argument("--size", type=int, nargs=2, default=(320, 240), help="of the images, pixels")
    parser.add_argument("--out", type=Path, default=Path("out"), help="folder for additions.json and what is kept")
    parser.add_argument("--jobs", type=int, default=default_workers(), help="processes that film and compute depth")
    return parser.parse_args()


if __name__ == "__main__":
    main()
