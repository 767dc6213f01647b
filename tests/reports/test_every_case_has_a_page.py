"""A page in every case: whatever a run lacks, all outputs are written, and the headline says what
happened and what to do.
"""

import html
import importlib.util
import re
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from itertools import combinations

import pytest

from ggvs_eval.contrib.export.tracking import track_results
from ggvs_eval.errors import GgvsError
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.figures.paper_figures import write_figure
from ggvs_eval.reports.page.leaderboard import write_leaderboard
from ggvs_eval.reports.report import write_report
from ggvs_eval.results import Results
from helpers.run_folders import RunShape, write_run
from helpers.small_runs import leave_out_pixels

LABELS = ("late", "ours-geometric")
NAMES = (("late", "late"), ("ours-geometric", "GGVS (online), geometric weights"))
WHOLE = RunShape(
    frames=Frames(0, 4), labels=LABELS, names=NAMES, metrics=("PSNR", "SSIM", "TCC", "SDT", "SDV")
)
LATE = (
    "frame offset",
    "certain",
    "frame t shows instant t-1: motion",
    "renumber the frames by -1: counted from 0?",
    "late",
)


def mark_faulty(results: Results) -> Results:
    """Every method with a certain fault."""
    faults = [[label, "room", "cam00", *LATE] for label in dict.fromkeys(results.row_labels)]
    return replace(results, provenance=results.provenance | {"faults": faults})


def mark_partial(results: Results) -> Results:
    """Every method without some frames."""
    marks = {
        label: "partial in room: 1 of 2 views complete"
        for label in dict.fromkeys(results.row_labels)
    }
    return replace(results, provenance=results.provenance | {"partial": marks})


def measure_nothing(results: Results) -> Results:
    """No value of any metric."""
    reasons = dict.fromkeys(WHOLE.metrics, "its weights are absent")
    return replace(results, table=results.table.iloc[:0], not_computed=reasons)


def keep(results: Results) -> Results:
    return results


@dataclass(frozen=True)
class Case:
    """What a run lacks: its shape, what is done to its results, and what the headline must say."""

    shape: dict[str, object]
    edit: Callable[[Results], Results] = keep
    headline: str = ""


CASES = {
    "all at fault": Case(
        {}, mark_faulty, "Nothing is ranked: late shows every frame one instant late"
    ),
    "all partial": Case(
        {}, mark_partial, "Nothing is ranked: late is partial in room: 1 of 2 views complete"
    ),
    "one frame": Case({"frames": Frames(0, 1)}),
    "one view": Case({"views": ("cam00",)}),
    "one method": Case({"labels": ("late",)}),
    "nothing measured": Case(
        {}, measure_nothing, "Nothing is ranked: PSNR was not computed, its weights are absent"
    ),
    "no path": Case({"poses": 0}),
}
EDITS = ("all at fault", "all partial", "nothing measured")


STILLS = [("one frame", "one view", "one method", "no path", *each) for each in ((), *zip(EDITS))]
PAIRS = [pair for pair in combinations(CASES, 2) if not {*pair} <= {*EDITS}]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("drawn", "names"),
    [
        *(("nothing", names) for names in (*((name,) for name in CASES), *STILLS)),
        *(pytest.param("nothing", names, marks=pytest.mark.proof) for names in PAIRS),
        *(pytest.param("all", (name,), marks=pytest.mark.proof) for name in CASES),
    ],
    ids=lambda value: value if isinstance(value, str) else " + ".join(value),
)
def test_every_output_is_written_and_says_what_happened(tmp_path, monkeypatch, drawn, names):
    """Page, Markdown, LaTeX, CSV, Excel, leaderboard, trackers; a figure is drawn, or refused with
    a reason in one line.

    Each case alone and a still of one view by one method, figures whole but for their pixels; the
    proof draws them, and has each two cases that can meet.
    """
    if drawn == "nothing":
        leave_out_pixels(monkeypatch)
    shape = WHOLE
    for name in names:
        shape = replace(shape, **CASES[name].shape)
    root = write_run(tmp_path / "run", shape)
    results = Results.read(root)
    for name in names:
        results = CASES[name].edit(results)
    results.write(root)

    page = write_report([root])
    text = html.unescape(page.read_text(encoding="utf-8"))
    headline = re.search(r'<p class="headline">(.*?)</p>', text, re.DOTALL)[1]
    assert headline
    for name in names:
        assert CASES[name].headline in headline
    if "all at fault" in names:
        assert re.search(r'<p class="margin">late\b[^<]*: renumber the frames by -1\.</p>', text)
        assert "is best" not in headline
    for kind in ("md", "tex", "csv"):
        assert (page.parent / f"tables.{kind}").stat().st_size > 0
    if importlib.util.find_spec("openpyxl"):
        assert (page.parent / "tables.xlsx").stat().st_size > 0
    board = html.unescape(
        write_leaderboard([root], tmp_path / "board.html").read_text(encoding="utf-8")
    )
    assert (
        "Nothing is ranked" in board
        if headline.startswith("Nothing is ranked")
        else "<table" in board
    )
    if importlib.util.find_spec("tensorboardX"):
        track_results([root], "tensorboard", tmp_path / "tracked")
    for kind in ("crops", "failures", "epi", "time"):
        with refused_in_one_line():
            assert write_figure(root, kind, tmp_path / f"{kind}.png", rule="worst")[0].is_file()


@contextmanager
def refused_in_one_line() -> Iterator[None]:
    """What cannot be done is refused in one line with something to do."""
    refusal = ""
    try:
        yield
    except GgvsError as error:
        refusal = str(error)
    assert re.fullmatch(r"(.+[;.] .+)?", refusal)
