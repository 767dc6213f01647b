"""Write measured figures into README.md, the pages of docs/ and benchmarks/RESULTS.md: ``python docs/fill_tables.py``.

It follows `make reports bench validate` and the commands that benchmarks/RESULTS.md names. Tables are between
``<!-- name -->`` and ``<!-- /name -->``; nothing between them is typed by hand.
"""

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from result_tables import (
    author_clips_colmap_table,
    author_clips_table,
    budget_rows,
    ceilings_table,
    colmap_controls_table,
    fidelity_table,
    k_table,
    report_table,
    results_table,
    sweep_table,
    views_table,
)

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.figures.study_figure import draw_study
from ggvs_eval.reports.model.metric_study import STUDY_FILE, Study, read_study
from ggvs_eval.reports.tables.study_tables import (
    absence_list,
    by_ladder_table,
    correlation_table,
    ladder_table,
    sensitivity_table,
    verdict_table,
)

ROOT = Path(__file__).parents[1]
OUT = ROOT / "out"
OFFLINE_RUN, UNSEEN_RUN = OUT / "offline" / "offline", OUT / "offline_unseen" / "offline"
# Of the validation rooms the whole picture stands for all regions; the validation of depth prints the others.
DEPTH_FIGURES = r"depth\.(motorcycle\.(epe_px|bad_[23]_percent)\.[^.]*$|sparse|rendering\.PSNR|reuse|rooms\.whole_picture|demo\.)"
MATCHERS = ("sgbm", "sweep", "raft")
DEPTH_ROWS = {  # shown: name of the figure without its matcher
    "Motorcycle, mean error (px)": "depth.motorcycle.epe_px",
    "Motorcycle, off by more than 2 px (%)": "depth.motorcycle.bad_2_percent",
    "Motorcycle, off by more than 3 px (%)": "depth.motorcycle.bad_3_percent",
    "real rig, sparse points within 2 % (%)": "depth.sparse.within_2_percent",
    "real rig, median error there (%)": "depth.sparse.median_error_percent",
    "real rig, PSNR rendered from it (dB)": "depth.rendering.PSNR",
    "validation rooms, pixels within 2 % (%)": "depth.rooms.whole_picture.within_2_percent",
    "demo, pixels within 2 % (%)": "depth.demo.whole_picture.within_2_percent",
    "– with texture": "depth.demo.texture.within_2_percent",
    "– without texture": "depth.demo.untextured.within_2_percent",
    "– at edges of depth": "depth.demo.edge.within_2_percent",
    "– on thin things": "depth.demo.thin.within_2_percent",
    "demo, spread over time of what stands still (%)": "depth.demo.static.spread_percent",
    "– after the temporal filter": "depth.demo.static.spread_filtered_percent",
    "demo, flicker of what stands still (`depth_mTV`, %)": "depth.demo.static.flicker_percent",
    "– with a sharpness (`depth_Sharpness`, %) of": "depth.demo.static.sharpness_percent",
    "seconds per depth map of 1345x1008": "depth.seconds",
}
SPEED_ROWS = {  # shown: first part of the figures' names
    "1352x1014, K = 4, network": "online_step",
    "1352x1014, K = 4, geometric weights": "online_geometric_step",
    "640x360, K = 2, network": "online_small_step",
}
STAGES = {"filter": "_filter", "splat": "_splat", "TSDF": "_tsdf", "blend": "_blend", "frame, p50": "", "frame, p95": "_p95"}

ABLATION_METRICS = ("PSNR", "LPIPS", "TCC", "STED", "SDT", "EPI_coherence", "EPI_line_texture", "EPI_slope_error")
REFINEMENT_FIGURES = {"reprojection": ".2f", "contradiction": ".2f", "PSNR": ".2f", "SSIM": ".3f"}
BESIDE_ADDITIONS = {"compensated": ("PSNR_cc",), "recurrent_limit": ("PSNR", "flicker")}
DOMAIN_METRICS = {"PSNR": ".2f", "LPIPS": ".3f"}
STUDIES = {"demo room": OUT / "metric_study", "hololens_rgbd": OUT / "metric_study_real"}
OFFLINE_METRICS = ("PSNR", "PSNR_cc", "SSIM", "LPIPS", "TCC", "STED", "Flicker", "SDV", "EPI_coherence", "EPI_slope_error")
PRICE_METRICS = ("PSNR", "PSNR_static", "PSNR_moving", "PSNR_disoccluded", "LPIPS", "STED", "EPI_coherence")
BASELINE_METRICS = ("PSNR", "SSIM", "LPIPS", "L1", "TCC", "STED", "SDT", "SDV")
VIDEO_METRICS = ("PSNR", "PSNR_cc", "PSNR_moving", "SSIM", "LPIPS", "L1", "TCC", "STED", "Flicker", "SDT", "SDV")

Figures = dict[str, dict[str, Any]]
Tables = Mapping[str, Callable[[], str]]


def main() -> None:
    """Fill every table whose figures have been computed."""
    _fill(ROOT / "README.md", {"real_frame": lambda: fidelity_table(OUT / "real_frame")})
    _fill(
        ROOT / "docs" / "results.md",
        {
            "demo": lambda: results_table(OUT / "demo"),
            "ceilings": lambda: ceilings_table(OUT / "demo"),
            "real_frame": lambda: results_table(OUT / "real_frame"),
            "real_frame_views": lambda: views_table(OUT / "real_frame"),
            "real_frame_folds": lambda: results_table(OUT / "real_frame_folds"),
            "real_frame_folds_views": lambda: views_table(OUT / "real_frame_folds"),
            "real_frame_coverage": lambda: results_table(OUT / "real_frame_coverage"),
            "real_frame_coverage_views": lambda: views_table(OUT / "real_frame_coverage"),
            "real_video": lambda: sweep_table(OUT / "real_video", VIDEO_METRICS),
            "real_video_views": lambda: views_table(OUT / "real_video" / "dome"),
            "depth": depth_table,
            "speed": speed_table,
        },
    )
    _fill(
        ROOT / "docs" / "measurements.md",
        {
            "ablations": lambda: sweep_table(OUT / "rooms_ablations", ABLATION_METRICS),
            "clean": lambda: sweep_table(OUT / "rooms_clean", BASELINE_METRICS),
            "noise": lambda: sweep_table(OUT / "rooms_noise", ABLATION_METRICS),
            "switches": lambda: sweep_table(OUT / "rooms_switches", BASELINE_METRICS),
            "over_k": lambda: k_table(OUT / "rooms_k", BASELINE_METRICS),
            "offline": lambda: report_table(OFFLINE_RUN, ("quality", "consistency", "path"), OFFLINE_METRICS),
            "offline_price": lambda: report_table(OFFLINE_RUN, ("price",), PRICE_METRICS),
            "refinement": refinement_table,
            "domains": domains_table,
            "speed_before": lambda: compared_speed_table(OUT / "bench.json"),
            "device": device_table,
        },
    )
    _fill(ROOT / "docs" / "readings.md", {"additions": additions_table})
    _fill(ROOT / "docs" / "metrics.md", {"verdicts": lambda: verdict_table(_studies())})
    _fill(
        ROOT / "benchmarks" / "RESULTS.md",
        {
            "real_frame_budget": lambda: budget_rows(OUT / "real_frame"),
            "baselines": lambda: sweep_table(OUT / "rooms_baselines", BASELINE_METRICS, OUT / "rooms_speed"),
            "offline_costs": lambda: report_table(OFFLINE_RUN, ("costs",)),
            "offline_seeds": lambda: report_table(OFFLINE_RUN, ("seeds",), OFFLINE_METRICS),
            "offline_unseen": lambda: report_table(UNSEEN_RUN, ("quality", "consistency", "path"), OFFLINE_METRICS),
            "offline_unseen_seeds": lambda: report_table(UNSEEN_RUN, ("seeds",), OFFLINE_METRICS),
            "held": lambda: results_table(OUT / "real_frame_held"),
            "calibration": lambda: figures_table(OUT / "validate.json", r"calibration\."),
            "real_frame_refined": lambda: results_table(OUT / "real_frame_refined"),
            "real_frame_refined_coverage": lambda: results_table(OUT / "real_frame_refined_coverage"),
            "depth": lambda: figures_table(OUT / "depth_validation" / "figures.json", DEPTH_FIGURES),
            "validate": lambda: figures_table(OUT / "validate.json", r"(?!calibration|depth)"),
            "bench": lambda: figures_table(OUT / "bench.json", r"(?!roofline|step_memory)"),
            "roofline": lambda: roofline_table(OUT / "bench.json"),
            "colmap_controls": lambda: colmap_controls_table(OUT / "colmap_controls.json"),
            "author_clips": lambda: author_clips_table(OUT / "author_clips.json"),
            "author_clips_colmap": lambda: author_clips_colmap_table(OUT / "author_clips.json"),
            "ladders": lambda: ladder_table(read_study(STUDIES["demo room"])),
            "by_ladder": lambda: by_ladder_table(_studies()),
            "correlations": lambda: correlation_table(read_study(STUDIES["demo room"])),
            "correlations_real": lambda: correlation_table(read_study(STUDIES["hololens_rgbd"])),
            "sensitivity": lambda: sensitivity_table(read_study(STUDIES["demo room"])),
            "absent": lambda: absence_list(read_study(STUDIES["demo room"])) or "Nothing.",
        },
    )
    _draw_metric_study()


def _draw_metric_study() -> None:
    """Draw what metrics answered to planted degradations."""
    try:
        print(draw_study(_present_studies(), ROOT / "docs" / "images" / "metric_study.png"))
    except ResultsError as error:
        print(f"the figure of the metric study is left as it is: {error}")


def _present_studies() -> dict[str, Path]:
    """The studies that were made; the first one must have been."""
    title, first = next(iter(STUDIES.items()))
    return {title: first} | {name: folder for name, folder in STUDIES.items() if (folder / STUDY_FILE).is_file()}


def _studies() -> list[Study]:
    return [read_study(folder) for folder in _present_studies().values()]


def _fill(file: Path, tables: Tables) -> None:
    text = file.read_text(encoding="utf-8")
    for name, make in tables.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        if not pattern.search(text):
            raise SystemExit(f"{file} has no place for the table {name}")
        try:
            table = make()
        except (FileNotFoundError, ResultsError) as error:
            print(f"{file.name}: {name} is left as it is: {error}")
            continue
        text = pattern.sub(lambda match, table=table: f"{match[1]}{table}\n{match[2]}", text)
    file.write_text(text, encoding="utf-8")


def depth_table() -> str:
    """The figures of depth, a row each, a column per matcher; what was not measured says so."""
    figures = _read(OUT / "depth_validation" / "figures.json")
    bench = OUT / "bench.json"
    figures |= _read(bench) if bench.is_file() else {}
    rows = ["| | " + " | ".join(MATCHERS) + " | target |", "| --- |" + " ---: |" * (len(MATCHERS) + 1)]
    for shown, name in DEPTH_ROWS.items():
        matcher_figures = [figures.get(f"{name}.{matcher}") for matcher in MATCHERS]
        if any(matcher_figures):
            target = next((_target(figure) for figure in matcher_figures if figure and _target(figure)), "")
            cells = [f"{figure['value']:.4g}" if figure else "not computed" for figure in matcher_figures]
            rows.append(f"| {shown} | " + " | ".join([*cells, target]) + " |")
    return "\n".join(rows)


def speed_table() -> str:
    """Milliseconds per stage and frame of the online step, as the paper's table of timing."""
    figures = _read(OUT / "bench.json")
    rows = ["| ms | " + " | ".join(STAGES) + " | frames/s |", "| --- |" + " ---: |" * (len(STAGES) + 1)]
    for shown, name in SPEED_ROWS.items():
        cells = [f"{figures[name + stage]['value']:.0f}" for stage in STAGES.values()]
        rows.append(f"| {shown} | " + " | ".join(cells) + f" | {figures[name + '_rate']['value']:.2f} |")
    return "\n".join(rows)


def domains_table() -> str:
    """Tabulate the output of ``python -m benchmarks.domain_validation``: a row per domain, PSNR and LPIPS per method."""
    measured = _read(OUT / "validate_domains.json")
    means, methods = measured["means"], measured["methods"]
    columns = [(metric, label) for metric in DOMAIN_METRICS if metric in means for label in methods]
    columns += [("PSNR", label) for label in means["PSNR"] if label not in methods]
    rows = ["| domain | " + " | ".join(f"{metric}, {label}" for metric, label in columns) + " |"]
    rows.append("| --- |" + " ---: |" * len(columns))
    for domain in means["PSNR"][methods[0]]:
        cells = [f"{means[metric][label][domain]:{DOMAIN_METRICS[metric]}}" for metric, label in columns]
        rows.append(f"| {domain} | " + " | ".join(cells) + " |")
    return "\n".join([*rows, *(f"\nNot computed: {line}." for line in measured["not_computed"])])


def additions_table() -> str:
    """Tabulate the output of ``python -m benchmarks.additions``: a row per addition and domain, its own measure first."""
    gains = _read(OUT / "additions.json")["gains"]
    rows = ["| addition | domain | measure | without | with |", "| --- | --- | --- | ---: | ---: |"]
    for gain in sorted(gains, key=lambda gain: not gain["for"]):
        if gain["for"] or gain["measure"] in BESIDE_ADDITIONS.get(gain["addition"], ()):
            values = " | ".join(f"{gain[given]:.2f}" for given in ("without", "with"))
            rows.append(f"| `{gain['addition']}` | {gain['domain']} | {gain['measure']} | {values} |")
    return "\n".join(rows)


def refinement_table() -> str:
    """Tabulate the output of ``python -m benchmarks.refinement_validation``: a row per calibration."""
    rows = ["| calibration | reprojection (px) | contradiction (px) | PSNR | SSIM |", "| --- |" + " ---: |" * 4]
    for state, means in _read(OUT / "validate_refinement.json")["means"].items():
        cells = [f"{means[name]:{form}}" for name, form in REFINEMENT_FIGURES.items()]
        rows.append(f"| {state} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def device_table() -> str:
    """Tabulate the times that ``benchmarks.bench_device --device cuda --json out/device.json`` wrote: ms per frame on both."""
    measured = _read(OUT / "device.json")
    rows = [f"{measured['machine']}:", "", "| ms per frame | CPU | GPU | times as fast |", "| --- | ---: | ---: | ---: |"]
    for figure in measured["figures"]:
        here, there = (f"{1e3 * figure[place]['whole']:.0f}" if place in figure else "" for place in ("cpu", "device"))
        ratio = f"{figure['ratio']:.3g}" if "ratio" in figure else ""
        rows.append(f"| {figure['label']}, {figure['width']}x{figure['height']} | {here} | {there} | {ratio} |")
    return "\n".join(rows)


def figures_table(file: Path, names: str = "") -> str:
    """Flat figures whose names begin with a pattern, as Markdown; a ratio above 1 means better than the peer."""
    all_figures = _read(file)
    figures = {name: figure for name, figure in all_figures.items() if re.match(names, name)}
    if not figures:
        raise ResultsError(f"{file} holds no such figures")
    rows = ["| figure | value | target | peer | ratio |", "| --- | ---: | ---: | --- | ---: |"]
    for name, figure in figures.items():
        peer = f"{figure['peer']}: {figure['peer_value']:.4g}" if figure.get("peer") else ""
        ratio = f"{figure['ratio']:.3g}" if figure.get("ratio") is not None else ""
        rows.append(f"| {name} | {figure['value']:.4g} {figure['unit']} | {_target(figure)} | {peer} | {ratio} |")
    return "\n".join(rows)


# Title, figure of today, milliseconds (and those of its peer) before the kernels were revised, target.
BEFORE_MS: tuple[tuple[str, str, float, float | None, float | None], ...] = (
    ("splat of a view, Open3D's projection of points", "geometry_splat", 57.76, 45.62, None),
    ("ray march, Open3D's VoxelBlockGrid", "geometry_tsdf_depth", 183.8, 11650.0, None),
    ("all geometry of a step, both of these", "geometry_step", 437.7, 11840.0, None),
    ("SSIM, scikit-image", "metrics.ssim_ms", 8.215, 437.9, 10.0),
    ("splat, four views with the mask channel", "online_step_splat", 221.0, None, 112.0),
    ("fusion and march", "online_step_tsdf", 170.0, None, 100.0),
    ("blend, network included", "online_step_blend", 194.0, None, 130.0),
    ("whole step, 1352x1014, K = 4", "online_step", 650.0, None, 420.0),
    ("whole step, 640x360, K = 2", "online_small_step", 79.0, None, 62.0),
    ("live depth of a map, SGBM", "depth.rig_seconds.live", 2700.0, None, 600.0),
)


def compared_speed_table(file: Path) -> str:
    """Today's times beside those before the kernels were revised, each with the peer of its own run, as Markdown."""
    figures = _read(file)
    columns = ("before (ms)", "peer in that run (ms)", "ratio", "today (ms)", "peer in this run (ms)", "ratio", "target (ms)")
    rows = ["| | " + " | ".join(columns) + " |", "| --- |" + " ---: |" * len(columns)]
    for title, name, before, peer_before, target in BEFORE_MS:
        figure = figures[name]
        scale = 1e3 if figure["unit"].startswith("s") else 1.0
        values = [before, peer_before, None if peer_before is None else peer_before / before, scale * figure["value"]]
        values += [scale * figure["peer_value"], figure["ratio"]] if figure.get("peer") else [None, None]
        rows.append(f"| {title} | " + " | ".join("" if each is None else f"{each:.4g}" for each in [*values, target]) + " |")
    return "\n".join(rows)


def roofline_table(file: Path) -> str:
    """What each kernel of a step takes, beside what the machine could do, as Markdown."""
    figures = {name: figure["value"] for name, figure in _read(file).items() if name.startswith("roofline_")}
    kernels = [name.removesuffix("_share") for name in figures if name.endswith("_share")]
    rows = ["| kernel | CPU ms | GFLOP | MB moved | MB made | share of its roof | AVX2 |", "| --- |" + " ---: |" * 6]
    for kernel in kernels:
        operations, moved, made, share, avx2 = (
            figures[f"{kernel}_{what}"] for what in ("operations", "bytes", "results", "share", "avx2")
        )
        name = kernel.removeprefix("roofline_")
        rows.append(
            f"| {name} | {figures[kernel]:.1f} | {operations:.2f} | {moved:.0f} | {made:.0f} | {share:.0f} % | {avx2:.2f} x |"
        )
    return "\n".join(rows)


def _read(file: Path) -> Figures:
    figures: Figures = json.loads(file.read_text(encoding="utf-8"))
    return figures


def _target(figure: dict[str, Any]) -> str:
    sign = "≥" if figure["higher_is_better"] else "≤"
    return "" if figure.get("target") is None else f"{sign} {figure['target']:.4g}"


if __name__ == "__main__":
    main()
