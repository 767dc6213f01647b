"""Write measured figures into README.md, docs/ and benchmarks/RESULTS.md: ``python
tools/docs/fill_tables.py [--check]``.

`make results` measures and then fills. Tables are between ``<!-- name -->`` and ``<!-- /name:
identity -->``, the identity of the code that they came from (`result_plan`); nothing between them
is typed by hand. ``--check`` lists those older than the code.
"""

import re
import sys
from collections import defaultdict
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from figure_tables import (
    DEPTH_FIGURES,
    additions_table,
    depth_table,
    device_table,
    domains_table,
    figures_table,
    learned_sentence,
    learned_table,
    printed_table,
    refinement_table,
    roofline_table,
    speed_table,
)
from result_plan import MEASUREMENTS, OUT, ROOT, SHORT
from result_tables import (
    FRONT_METHODS,
    author_clips_colmap_table,
    author_clips_table,
    budget_rows,
    ceilings_table,
    colmap_controls_table,
    fidelity_table,
    k_table,
    report_table,
    results_table,
    stream_table,
    sweep_table,
    views_table,
)

from ggvs_eval.contrib.study.metric_study import STUDY_FILE, Study, read_study
from ggvs_eval.contrib.study.study_figure import draw_study
from ggvs_eval.contrib.study.study_tables import (
    absence_list,
    by_ladder_table,
    correlation_table,
    ladder_table,
    sensitivity_table,
    verdict_table,
)
from ggvs_eval.errors import ResultsError

README, RESULTS, PEERS = (
    ROOT / "README.md",
    ROOT / "docs" / "results.md",
    ROOT / "docs" / "baselines.md",
)
MEASURED, BENCH = ROOT / "docs" / "measurements.md", ROOT / "benchmarks" / "RESULTS.md"
# of the weights, which ship: their tables are made anew each time and have no code to be older than
CARDS = "cards"
OFFLINE_RUN, UNSEEN_RUN = OUT / "offline" / "offline", OUT / "offline_unseen" / "offline"
STUDIES = {"demo room": OUT / "metric_study", "hololens_rgbd": OUT / "metric_study_real"}
ABLATION_METRICS = (
    "PSNR",
    "LPIPS",
    "TCC",
    "STED",
    "SDT",
    "EPI_coherence",
    "EPI_line_texture",
    "EPI_slope_error",
)
OFFLINE_METRICS = (
    "PSNR",
    "PSNR_cc",
    "SSIM",
    "LPIPS",
    "TCC",
    "STED",
    "Flicker",
    "SDV",
    "EPI_coherence",
    "EPI_slope_error",
)
PRICE_METRICS = (
    "PSNR",
    "PSNR_static",
    "PSNR_moving",
    "PSNR_disoccluded",
    "LPIPS",
    "STED",
    "EPI_coherence",
)
BASELINE_METRICS = ("PSNR", "SSIM", "LPIPS", "L1", "TCC", "STED", "SDT", "SDV")
VIDEO_METRICS = (
    "PSNR",
    "PSNR_cc",
    "PSNR_moving",
    "SSIM",
    "LPIPS",
    "L1",
    "TCC",
    "STED",
    "Flicker",
    "SDT",
    "SDV",
)


@dataclass(frozen=True)
class Table:
    """A table, list or sentence of a page.

    Attributes:
        page: that it stands in.
        name: in the markers around it.
        measurement: that it is made from, or `CARDS`.
        make: gives its text.
    """

    page: Path
    name: str
    measurement: str
    make: Callable[[], str]

    @property
    def place(self) -> re.Pattern[str]:
        """Begin, text, end and identity in its page."""
        return re.compile(
            rf"(<!-- {self.name} -->\n)(.*?)(<!-- /{self.name}(?:: (\w+))? -->)", re.DOTALL
        )

    @property
    def identity(self) -> str:
        """Of the code that it says it came from; empty where it does not say.

        Raises:
            ResultsError: its page has no place for it.
        """
        found = self.place.search(self.page.read_text(encoding="utf-8"))
        if found is None:
            raise ResultsError(f"{self.page} has no place for the table {self.name}")
        return found[4] or ""


TABLES = (
    Table(
        README,
        "sparse",
        "sparse",
        lambda: printed_table("sparse", "scene | cameras | GGVS (online)"),
    ),
    Table(
        README,
        "real_frame",
        "real_frame",
        lambda: fidelity_table(OUT / "real_frame", FRONT_METHODS, usual_view=True),
    ),
    Table(PEERS, "learned", CARDS, learned_sentence),
    Table(PEERS, "learned_table", CARDS, learned_table),
    Table(PEERS, "demo_instant", "demo_instant", lambda: results_table(OUT / "demo_instant")),
    Table(
        RESULTS,
        "sparse",
        "sparse",
        lambda: printed_table("sparse", "scene | sources | GGVS (online)"),
    ),
    Table(
        BENCH,
        "sparse_measured",
        "sparse",
        lambda: printed_table("sparse", "scene | sources | PSNR of GGVS"),
    ),
    Table(RESULTS, "demo", "demo", lambda: results_table(OUT / "demo")),
    Table(RESULTS, "ceilings", "demo", lambda: ceilings_table(OUT / "demo")),
    Table(RESULTS, "depth", "depth", depth_table),
    Table(RESULTS, "real_frame", "real_frame", lambda: results_table(OUT / "real_frame")),
    Table(BENCH, "real_frame_views", "real_frame", lambda: views_table(OUT / "real_frame")),
    Table(
        BENCH,
        "real_frame_small",
        "real_frame_small",
        lambda: results_table(OUT / "real_frame_small"),
    ),
    Table(
        BENCH,
        "real_frame_small_views",
        "real_frame_small",
        lambda: views_table(OUT / "real_frame_small"),
    ),
    Table(
        BENCH,
        "real_frame_folds",
        "real_frame_folds",
        lambda: results_table(OUT / "real_frame_folds"),
    ),
    Table(
        BENCH,
        "real_frame_folds_views",
        "real_frame_folds",
        lambda: views_table(OUT / "real_frame_folds"),
    ),
    Table(BENCH, "llff", "llff", lambda: printed_table("llff", "scene | measured as")),
    Table(
        BENCH, "llff_paired", "llff", lambda: printed_table("llff", "scene | PSNR minus that of")
    ),
    Table(
        BENCH,
        "real_frame_coverage",
        "real_frame_coverage",
        lambda: results_table(OUT / "real_frame_coverage"),
    ),
    Table(
        BENCH,
        "real_frame_coverage_views",
        "real_frame_coverage",
        lambda: views_table(OUT / "real_frame_coverage"),
    ),
    Table(
        RESULTS, "real_video", "real_video", lambda: sweep_table(OUT / "real_video", VIDEO_METRICS)
    ),
    Table(
        BENCH, "real_video_views", "real_video", lambda: views_table(OUT / "real_video" / "dome")
    ),
    Table(
        BENCH,
        "real_video_itermvs",
        "real_video_itermvs",
        lambda: results_table(OUT / "real_video_itermvs"),
    ),
    Table(RESULTS, "speed", "speed", speed_table),
    Table(
        MEASURED,
        "ablations",
        "rooms_ablations",
        lambda: sweep_table(OUT / "rooms_ablations", ABLATION_METRICS),
    ),
    Table(
        BENCH, "noise", "rooms_noise", lambda: sweep_table(OUT / "rooms_noise", ABLATION_METRICS)
    ),
    Table(
        BENCH,
        "switches",
        "rooms_switches",
        lambda: sweep_table(OUT / "rooms_switches", BASELINE_METRICS),
    ),
    Table(BENCH, "over_k", "rooms_k", lambda: k_table(OUT / "rooms_k", BASELINE_METRICS)),
    Table(
        BENCH,
        "real_fits",
        "real_fits",
        lambda: report_table(OUT / "real_fits", ("quality", "consistency")),
    ),
    Table(
        BENCH, "real_fits_costs", "real_fits", lambda: report_table(OUT / "real_fits", ("costs",))
    ),
    Table(
        BENCH,
        "real_fits_price",
        "real_fits",
        lambda: report_table(OUT / "real_fits", ("price",), PRICE_METRICS),
    ),
    Table(BENCH, "real_path", "real_path", lambda: report_table(OUT / "real_path", ("path",))),
    Table(BENCH, "stream", "stream", lambda: stream_table(OUT / "stream")),
    Table(BENCH, "stream_real", "stream_real", lambda: stream_table(OUT / "stream_real")),
    Table(BENCH, "drift", "long_room", lambda: report_table(OUT / "long", ("drift",))),
    Table(
        BENCH,
        "offline",
        "offline",
        lambda: report_table(OFFLINE_RUN, ("quality", "consistency", "path"), OFFLINE_METRICS),
    ),
    Table(
        BENCH,
        "offline_price",
        "offline",
        lambda: report_table(OFFLINE_RUN, ("price",), PRICE_METRICS),
    ),
    Table(BENCH, "refinement", "refinement", refinement_table),
    Table(BENCH, "domains", "domains", domains_table),
    Table(BENCH, "device", "device", device_table),
    Table(BENCH, "additions", "additions", additions_table),
    Table(BENCH, "verdicts", "metric_study", lambda: verdict_table(_studies())),
    Table(BENCH, "learned", CARDS, learned_sentence),
    Table(BENCH, "real_frame_budget", "real_frame", lambda: budget_rows(OUT / "real_frame")),
    Table(
        BENCH,
        "baselines",
        "rooms_baselines",
        lambda: sweep_table(OUT / "rooms_baselines", BASELINE_METRICS),
    ),
    Table(BENCH, "offline_costs", "offline", lambda: report_table(OFFLINE_RUN, ("costs",))),
    Table(
        BENCH,
        "offline_seeds",
        "offline",
        lambda: report_table(OFFLINE_RUN, ("seeds",), OFFLINE_METRICS),
    ),
    Table(
        BENCH,
        "offline_unseen",
        "offline_unseen",
        lambda: report_table(UNSEEN_RUN, ("quality", "consistency", "path"), OFFLINE_METRICS),
    ),
    Table(
        BENCH,
        "offline_unseen_seeds",
        "offline_unseen",
        lambda: report_table(UNSEEN_RUN, ("seeds",), OFFLINE_METRICS),
    ),
    Table(BENCH, "held", "real_frame_held", lambda: results_table(OUT / "real_frame_held")),
    Table(
        BENCH,
        "calibration",
        "validate",
        lambda: figures_table(OUT / "validate.json", r"calibration\."),
    ),
    Table(
        BENCH,
        "real_frame_refined",
        "real_frame_refined",
        lambda: results_table(OUT / "real_frame_refined"),
    ),
    Table(
        BENCH,
        "real_frame_refined_coverage",
        "real_frame_refined_coverage",
        lambda: results_table(OUT / "real_frame_refined_coverage"),
    ),
    Table(
        BENCH,
        "depth",
        "depth",
        lambda: figures_table(OUT / "depth_validation" / "figures.json", DEPTH_FIGURES),
    ),
    Table(
        BENCH,
        "validate",
        "validate",
        lambda: figures_table(OUT / "validate.json", r"(?!calibration|depth)"),
    ),
    Table(BENCH, "intervals", "intervals", lambda: printed_table("intervals", "frames | clip")),
    Table(
        BENCH,
        "intervals_package",
        "intervals",
        lambda: printed_table("intervals", "frames | views"),
    ),
    Table(
        BENCH,
        "bench",
        "bench",
        lambda: figures_table(OUT / "bench.json", r"(?!roofline|step_memory)"),
    ),
    Table(BENCH, "roofline", "bench", lambda: roofline_table(OUT / "bench.json")),
    Table(
        BENCH,
        "ceiling_accuracy",
        "ceiling_accuracy",
        lambda: printed_table("ceiling_accuracy", "room"),
    ),
    Table(
        BENCH,
        "colmap_controls",
        "colmap_controls",
        lambda: colmap_controls_table(OUT / "colmap_controls.json"),
    ),
    Table(
        BENCH, "author_clips", "author_clips", lambda: author_clips_table(OUT / "author_clips.json")
    ),
    Table(
        BENCH,
        "author_clips_colmap",
        "author_clips",
        lambda: author_clips_colmap_table(OUT / "author_clips.json"),
    ),
    Table(BENCH, "ladders", "metric_study", lambda: ladder_table(read_study(STUDIES["demo room"]))),
    Table(BENCH, "by_ladder", "metric_study", lambda: by_ladder_table(_studies())),
    Table(
        BENCH,
        "correlations",
        "metric_study",
        lambda: correlation_table(read_study(STUDIES["demo room"])),
    ),
    Table(
        BENCH,
        "correlations_real",
        "metric_study_real",
        lambda: correlation_table(read_study(STUDIES["hololens_rgbd"])),
    ),
    Table(
        BENCH,
        "sensitivity",
        "metric_study",
        lambda: sensitivity_table(read_study(STUDIES["demo room"])),
    ),
    Table(
        BENCH,
        "absent",
        "metric_study",
        lambda: absence_list(read_study(STUDIES["demo room"])) or "Nothing.",
    ),
)


def main() -> None:
    """Fill every table whose figures have been computed, or list those that are older than the
    code.
    """
    if "--check" in sys.argv[1:]:
        for table in older_tables():
            came = f"of {table.identity}" if table.identity else "of unknown code"
            wanted = MEASUREMENTS[table.measurement].identity[:SHORT]
            place = f"{table.page.relative_to(ROOT)}: {table.name}"
            print(f"{place} is {came}, the code is {wanted}: make results ONLY={table.measurement}")
        return
    fill()
    _draw_metric_study()


def fill(measurement: str = "") -> None:
    """Fill the tables of one measurement, or all.

    Those whose figures are not here stay as they are.
    """
    for table in TABLES:
        if measurement in ("", table.measurement):
            _fill(table)


def older_tables() -> list[Table]:
    """Tables that came from other code than there is now, or do not say from which."""
    measured = [table for table in TABLES if table.measurement != CARDS]
    return [
        table
        for table in measured
        if table.identity != MEASUREMENTS[table.measurement].identity[:SHORT]
    ]


def tables_by_measurement() -> dict[str, list[Table]]:
    """Name of a measurement -> what it fills."""
    found = defaultdict(list)
    for table in TABLES:
        found[table.measurement].append(table)
    return dict(found)


def _fill(table: Table) -> None:
    made_from = (
        CARDS if table.measurement == CARDS else MEASUREMENTS[table.measurement].made_from[:SHORT]
    )
    try:
        if not made_from:
            raise ResultsError(
                f"{table.measurement} was not made here, or nobody noted by which code"
            )
        text = table.make()
    except (OSError, ResultsError) as error:
        print(f"{table.page.name}: {table.name} is left as it is: {error}")
        return
    page = table.page.read_text(encoding="utf-8")
    _ = table.identity  # which says so where there is no place for it
    end = f"<!-- /{table.name}: {made_from} -->"
    table.page.write_text(
        table.place.sub(lambda match: f"{match[1]}{text}\n{end}", page), encoding="utf-8"
    )


def _draw_metric_study() -> None:
    """Draw what metrics answered to planted degradations."""
    try:
        print(draw_study(_present_studies(), ROOT / "docs" / "images" / "metric_study.png"))
    except ResultsError as error:
        print(f"the figure of the metric study is left as it is: {error}")


def _present_studies() -> dict[str, Path]:
    """The studies that were made; the first one must have been."""
    title, first = next(iter(STUDIES.items()))
    return {title: first} | {
        name: folder for name, folder in STUDIES.items() if (folder / STUDY_FILE).is_file()
    }


def _studies() -> list[Study]:
    return [read_study(folder) for folder in _present_studies().values()]


if __name__ == "__main__":
    main()
