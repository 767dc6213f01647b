"""Tables of what the benchmarks wrote to out/, and of what the cards of trained weights say, as
Markdown, for `fill_tables`.
"""

import json
import re
from pathlib import Path
from typing import Any

from result_plan import OUT, RECORDS, ROOT

from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.methods.registry import METHODS

# Of the validation rooms the whole picture stands for all regions; the validation of depth prints
# the others.
DEPTH_FIGURES = (
    r"depth\.(motorcycle\.(epe_px|bad_[23]_percent)\.[^.]*$|sparse|rendering\.PSNR|reuse|"
    r"rooms\.whole_picture|demo\.)"
)
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
SAME_VIEWS = "## Validation on the views of all cards"
AS_MANY_PIXELS = "## With as many pixels as each baseline"
SPEED_ROWS = {  # shown: first part of the figures' names
    "1352x1014, K = 4, network": "online_step",
    "1352x1014, K = 4, geometric weights": "online_geometric_step",
    "640x360, K = 2, network": "online_small_step",
}
STAGES = {
    "filter": "_filter",
    "splat": "_splat",
    "TSDF": "_tsdf",
    "blend": "_blend",
    "frame, p50": "",
    "frame, p95": "_p95",
}

REFINEMENT_FIGURES = {"reprojection": ".2f", "contradiction": ".2f", "PSNR": ".2f", "SSIM": ".3f"}
BESIDE_ADDITIONS = {"compensated": ("PSNR_cc",), "recurrent_limit": ("PSNR", "flicker")}
DOMAIN_METRICS = {"PSNR": ".2f", "LPIPS": ".3f"}
WEIGHTS = ROOT / "pipelines" / "weights"

Figures = dict[str, dict[str, Any]]


def depth_table() -> str:
    """The figures of depth, a row each, a column per matcher; what was not measured says so."""
    figures = _read(OUT / "depth_validation" / "figures.json")
    bench = OUT / "bench.json"
    figures |= _read(bench) if bench.is_file() else {}
    rows = [
        "| | " + " | ".join(MATCHERS) + " | target |",
        "| --- |" + " ---: |" * (len(MATCHERS) + 1),
    ]
    for shown, name in DEPTH_ROWS.items():
        matcher_figures = [figures.get(f"{name}.{matcher}") for matcher in MATCHERS]
        if any(matcher_figures):
            target = next(
                (_target(figure) for figure in matcher_figures if figure and _target(figure)), ""
            )
            cells = [
                f"{figure['value']:.4g}" if figure else "not computed" for figure in matcher_figures
            ]
            rows.append(f"| {shown} | " + " | ".join([*cells, target]) + " |")
    return "\n".join(rows)


def speed_table() -> str:
    """Milliseconds per stage and frame of the online step, as the paper's table of timing."""
    figures = _read(OUT / "bench.json")
    rows = [
        "| ms | " + " | ".join(STAGES) + " | frames/s |",
        "| --- |" + " ---: |" * (len(STAGES) + 1),
    ]
    for shown, name in SPEED_ROWS.items():
        cells = [f"{figures[name + stage]['value']:.0f}" for stage in STAGES.values()]
        rows.append(
            f"| {shown} | " + " | ".join(cells) + f" | {figures[name + '_rate']['value']:.2f} |"
        )
    return "\n".join(rows)


def domains_table() -> str:
    """Tabulate the output of ``python -m benchmarks.domain_validation``: a row per domain, PSNR and
    LPIPS per method.
    """
    measured = _read(OUT / "validate_domains.json")
    means, methods = measured["means"], measured["methods"]
    columns = [(metric, label) for metric in DOMAIN_METRICS if metric in means for label in methods]
    columns += [("PSNR", label) for label in means["PSNR"] if label not in methods]
    rows = ["| domain | " + " | ".join(f"{metric}, {label}" for metric, label in columns) + " |"]
    rows.append("| --- |" + " ---: |" * len(columns))
    for domain in means["PSNR"][methods[0]]:
        cells = [
            f"{means[metric][label][domain]:{DOMAIN_METRICS[metric]}}" for metric, label in columns
        ]
        rows.append(f"| {domain} | " + " | ".join(cells) + " |")
    return "\n".join([*rows, *(f"\nNot computed: {line}." for line in measured["not_computed"])])


def additions_table() -> str:
    """Tabulate the output of ``python -m benchmarks.additions``: a row per addition and domain, its
    own measure first.
    """
    gains = _read(OUT / "additions.json")["gains"]
    rows = ["| addition | domain | measure | without | with |", "| --- | --- | --- | ---: | ---: |"]
    for gain in sorted(gains, key=lambda gain: not gain["for"]):
        if gain["for"] or gain["measure"] in BESIDE_ADDITIONS.get(gain["addition"], ()):
            values = " | ".join(f"{gain[given]:.2f}" for given in ("without", "with"))
            rows.append(
                f"| `{gain['addition']}` | {gain['domain']} | {gain['measure']} | {values} |"
            )
    return "\n".join(rows)


def refinement_table() -> str:
    """Tabulate the output of ``python -m benchmarks.refinement_validation``: a row per
    calibration.
    """
    rows = [
        "| calibration | reprojection (px) | contradiction (px) | PSNR | SSIM |",
        "| --- |" + " ---: |" * 4,
    ]
    for state, means in _read(OUT / "validate_refinement.json")["means"].items():
        cells = [f"{means[name]:{form}}" for name, form in REFINEMENT_FIGURES.items()]
        rows.append(f"| {state} | " + " | ".join(cells) + " |")
    return "\n".join(rows)


def device_table() -> str:
    """Tabulate what ``make bench-device BENCH_OPTIONS="--json out/device.json"`` wrote: the step,
    learned depth, scoring.
    """
    measured = _read(OUT / "device.json")
    sizes, found = list(measured["figures"]), list(measured["figures"].values())
    depths = [
        measured["depth"][size]
        for size in sorted(measured["depth"], key=lambda size: int(size.partition("x")[0]))
    ]
    times, kernels = ([each[name] for each in found] for name in ("times", "kernels"))
    scoring = measured["scoring"]["frame_ms"]
    rows: dict[str, list[float]] = {
        "a step, median": [each["p50_ms"] for each in times],
        "– 95th percentile": [each["p95_ms"] for each in times],
        "– where the target moves at every step": [each["moving_p50_ms"] for each in times],
        "– in which kernels compute": [each["busy_ms"] for each in kernels],
        "– gaps between them": [each["gaps_ms"] for each in kernels],
        "– launches, a number": [each["launches"] for each in kernels],
        "from arrays to an 8-bit picture, median": [each["call_p50_ms"] for each in times],
        "– 95th percentile, of that": [each["call_p95_ms"] for each in times],
        "until another size is recorded": [each["recording_ms"] for each in times],
        "the step launched call by call": [sum(each["launched_ms"].values()) for each in times],
        "learned depth (larger: 1345x1008): network, both directions": [
            each["network_ms"] for each in depths
        ],
        "– a map from four partners": [each["map_ms"] for each in depths],
    }
    lines = [
        f"{measured['machine']}:",
        "",
        f"| ms | {' | '.join(sizes)} |",
        "| --- |" + " ---: |" * len(sizes),
    ]
    lines += [
        f"| {name} | {' | '.join(f'{value:.{1 + (value < 10)}f}' for value in values)} |"
        for name, values in rows.items()
    ]
    lines.append(
        f"| scoring a frame, all metrics (LPIPS) | | {scoring['all eight']:.1f} "
        f"({scoring['LPIPS']:.1f}) |"
    )
    return "\n".join(lines)


def figures_table(file: Path, names: str = "") -> str:
    """Flat figures whose names begin with a pattern, as Markdown.

    A ratio above 1 means better than the peer.
    """
    all_figures = _read(file)
    figures = {name: figure for name, figure in all_figures.items() if re.match(names, name)}
    if not figures:
        raise ResultsError(f"{file} holds no such figures")
    rows = ["| figure | value | target | peer | ratio |", "| --- | ---: | ---: | --- | ---: |"]
    for name, figure in figures.items():
        peer = f"{figure['peer']}: {figure['peer_value']:.4g}" if figure.get("peer") else ""
        ratio = f"{figure['ratio']:.3g}" if figure.get("ratio") is not None else ""
        rows.append(
            f"| {name} | {figure['value']:.4g} {figure['unit']} | {_target(figure)} | {peer} | "
            f"{ratio} |"
        )
    return "\n".join(rows)


def roofline_table(file: Path) -> str:
    """What each kernel of a step takes, beside what the machine could do, as Markdown."""
    figures = {
        name: figure["value"]
        for name, figure in _read(file).items()
        if name.startswith("roofline_")
    }
    kernels = [name.removesuffix("_share") for name in figures if name.endswith("_share")]
    rows = [
        "| kernel | CPU ms | GFLOP | MB moved | MB made | share of its roof | AVX2 |",
        "| --- |" + " ---: |" * 6,
    ]
    for kernel in kernels:
        operations, moved, made, share, avx2 = (
            figures[f"{kernel}_{what}"]
            for what in ("operations", "bytes", "results", "share", "avx2")
        )
        name = kernel.removeprefix("roofline_")
        rows.append(
            f"| {name} | {figures[kernel]:.1f} | {operations:.2f} | {moved:.0f} | {made:.0f} | "
            f"{share:.0f} % | {avx2:.2f} x |"
        )
    return "\n".join(rows)


def printed_table(measurement: str, head: str) -> str:
    """The last table that a measurement printed whose head begins so, as it is in its log."""
    file = RECORDS / f"{measurement}.log"
    found = re.findall(
        rf"^\| {re.escape(head)} \|.*\n(?:\|.*\n)+",
        file.read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )
    if not found:
        raise ResultsError(f"{file} has no table of {head}")
    return str(found[-1]).rstrip()


def learned_sentence() -> str:
    """Minutes and pixels that each network was trained for: one sentence, the same on every
    page.
    """
    first, *others, ours = _cards()
    title, minutes, pixels = first
    listed = [f"{title} {minutes} core-minutes on {pixels} million pixels"]
    listed += [f"{title} {minutes} on {pixels}" for title, minutes, pixels in others]
    on_gpu = {f"{minutes} minutes" for name in TRAINED_BASELINES if (minutes := _gpu_minutes(name))}
    besides = f" (and {' or '.join(sorted(on_gpu))} on a shared GPU)" if on_gpu else ""
    return (
        f"The baselines are reduced models trained for this comparison{besides}: "
        f"{', '.join(listed)}; GGVS {ours[1]} on {ours[2]}. Do not read these rows as the "
        "published methods' quality."
    )


def learned_table() -> str:
    """What the cards of the weights say: pixels, the first and the last validation on the same
    views, and ours with as many.
    """
    rows = [
        "| network | million pixels | PSNR before (dB) | PSNR (dB) | SSIM | ours with as many "
        "pixels (dB) |",
        "| --- |" + " ---: |" * 5,
    ]
    with_as_many = {
        f"{row['million pixels']:.0f}": f"{row['psnr_db']:.2f}"
        for row in _table_of_card("blend", AS_MANY_PIXELS)
    }
    names = [*TRAINED_BASELINES, "blend"]
    for name, (title, _, pixels) in zip(names, _cards(), strict=True):
        validated = _table_of_card(name, SAME_VIEWS)
        before = f"{validated[0]['psnr_db']:.2f}" if len(validated) > 1 else ""
        ssim = f"{validated[-1]['ssim']:.4f}" if "ssim" in validated[-1] else ""
        ours = with_as_many[pixels] if name in TRAINED_BASELINES else ""
        if name in TRAINED_BASELINES:
            title = METHODS["gps-gaussian+given-depth" if name == "gps-gaussian" else name].title
        rows.append(
            f"| {title} | {pixels} | {before} | {validated[-1]['psnr_db']:.2f} | {ssim} | {ours} |"
        )
    return "\n".join(rows)


def _table_of_card(name: str, heading: str) -> list[dict[str, float]]:
    """Rows of the table under a heading of the card of some weights."""
    section = (
        (WEIGHTS / f"{name}.md")
        .read_text(encoding="utf-8")
        .partition(heading)[2]
        .partition("\n## ")[0]
    )
    head, _, *lines = (
        row.strip("| ").split(" | ") for row in re.findall(r"^\|.*$", section, re.MULTILINE)
    )
    return [dict(zip(head, map(float, line), strict=True)) for line in lines]


def _cards() -> list[tuple[str, str, str]]:
    """Title, minutes of one core and millions of pixels of each baseline that is trained here, and
    of ours, by their cards.
    """
    titles = {name: baseline.title for name, baseline in TRAINED_BASELINES.items()} | {
        "blend": "GGVS (online)"
    }
    return [
        (title, *_costs((WEIGHTS / f"{name}.md").read_text(encoding="utf-8")))
        for name, title in titles.items()
    ]


def _gpu_minutes(name: str) -> str:
    """Minutes that a baseline learned on a GPU, by its card; empty where it did not."""
    card = (WEIGHTS / f"{name}.md").read_text(encoding="utf-8")
    found = re.search(r"^- Minutes of a GPU besides: (\d+)", card, re.MULTILINE)
    return found[1] if found else ""


def _costs(card: str) -> tuple[str, str]:
    """Minutes and millions of pixels of a card: those of the whole descent of the weights, where it
    says them.
    """
    minutes = re.search(r"^- Minutes of one core in all: (.*)$", card, re.MULTILINE) or re.search(
        r"(\d+) minutes of one core$", card, re.M
    )
    pixels = re.search(r"^- Pixels of target views: (.*?) million", card, re.MULTILINE)
    return minutes[1] if minutes else "unknown", pixels[1] if pixels else "unknown"


def _read(file: Path) -> Figures:
    figures: Figures = json.loads(file.read_text(encoding="utf-8"))
    return figures


def _target(figure: dict[str, Any]) -> str:
    sign = "≥" if figure["higher_is_better"] else "≤"
    return "" if figure.get("target") is None else f"{sign} {figure['target']:.4g}"
