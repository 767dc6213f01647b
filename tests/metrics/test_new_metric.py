"""A metric that nobody knew takes its module, a line in the registry and its test: everything else
follows from the object.
"""

import ast
import csv
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ggvs_eval import reports, statistics
from ggvs_eval.metrics.metric import CONSISTENCY, QUALITY, TruthFrame, Value, ViewMetric
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.pipelines import run as run_room
from ggvs_eval.pipelines.run import score_view
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.reports.report import write_report
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.statistics.intervals import intervals, measure_spread
from ggvs_eval.statistics.paired import compare
from ggvs_eval.statistics.pooled import PooledScene
from ggvs_eval.statistics.pooling import powers_of_means
from helpers.render_folders import FRAMES, VIEWS, make_run, rendered, truth, write_folders

PARTS = ("sum_of_errors", "sum_of_values")  # what a part is called is up to the metric
SORTED_VIEWS = tuple(sorted(VIEWS))


def relative_error(images: np.ndarray, truths: np.ndarray) -> float:
    """Sum of the absolute errors of a view over the sum of its true values."""
    return sum_of_errors(images, truths) / sum_of_values(images, truths)


def sum_of_errors(image: np.ndarray, captured: np.ndarray) -> float:
    return float(np.abs(image.astype(float) - captured).sum())


def sum_of_values(_image: np.ndarray, captured: np.ndarray) -> float:
    return float(captured.sum(dtype=float))


class RelativeErrorScorer:
    """Keeps both sums of each frame, and writes them beside the number of the view."""

    def __init__(self, names: Sequence[str], _options, _colour_map) -> None:
        self.names = names
        self._sums: list[tuple[float, float]] = []

    def add(self, index: int, image: np.ndarray, captured: TruthFrame) -> list[Value]:
        self._sums.append(
            (sum_of_errors(image, captured.image), sum_of_values(image, captured.image))
        )
        return [(part, index, value) for part, value in zip(PARTS, self._sums[-1], strict=True)]

    def finish(self) -> list[Value]:
        above, below = np.sum(self._sums, axis=0)
        return [(self.names[0], None, float(above / below))]


def worst_error(images: np.ndarray, truths: np.ndarray) -> float:
    """Largest sum of absolute errors of a frame."""
    return max(map(sum_of_errors, images, truths))


class WorstErrorScorer:
    """Writes one value per view, and nothing of the single frames."""

    def __init__(self, names: Sequence[str], _options, _colour_map) -> None:
        self.names = names
        self._errors: list[float] = []

    def add(self, index: int, image: np.ndarray, captured: TruthFrame) -> list[Value]:
        self._errors.append(sum_of_errors(image, captured.image))
        return []

    def finish(self) -> list[Value]:
        return [(self.names[0], None, max(self._errors))]


RELATIVE_ERROR = ViewMetric(
    name="Relative_error",
    kind="view",
    function=relative_error,
    unit="of the truth",
    higher_is_better=False,
    group=QUALITY,
    decimals=5,
    pooling=lambda _: powers_of_means({PARTS[0]: 1, PARTS[1]: -1}),
    describe="sum of the absolute errors over the sum of the true values",
    reference="this test",
    scorer=RelativeErrorScorer,
)
WORST_ERROR = ViewMetric(
    name="Worst_error",
    kind="view",
    function=worst_error,
    higher_is_better=False,
    group=CONSISTENCY,
    describe="largest error of a frame",
    reference="this test",
    scorer=WorstErrorScorer,
)


@pytest.fixture(scope="module")
def scored_run(tmp_path_factory) -> Iterator[RunFolder]:
    """Two renderings of two views and three frames, scored with both metrics beside PSNR."""
    folder = tmp_path_factory.mktemp("new_metric")
    with pytest.MonkeyPatch.context() as patch:
        for metric in (RELATIVE_ERROR, WORST_ERROR):
            patch.setitem(METRICS.shipped, metric.name, metric)
        run = make_run(folder / "run", ("PSNR", "Relative_error", "Worst_error"))
        import_renders(run, "whole", write_folders(folder / "whole"))
        import_renders(run, "late", write_folders(folder / "late", [3, 3, 4], list(FRAMES)))
        score(run)
        yield run


def stacked(view: str) -> tuple[np.ndarray, np.ndarray]:
    rows = [(rendered(view, frame), truth(view, frame)) for frame in FRAMES]
    return tuple(np.stack(images) for images in zip(*rows, strict=True))


def test_its_number_is_what_its_function_says(scored_run):
    """The number of each view is the ratio of sums over all its frames, and stands in the results
    with its parts.
    """
    table = score(scored_run).table
    mine = table[(table["method"] == "whole") & (table["metric"] == "Relative_error")].set_index(
        "view"
    )["value"]
    assert mine.to_dict() == pytest.approx(
        {view: relative_error(*stacked(view)) for view in VIEWS}, rel=1e-12
    )
    assert set(table["metric"]) == {"PSNR", "Relative_error", *PARTS, "Worst_error"}


def test_its_interval_is_that_of_a_ratio(scored_run):
    """The interval is that of the ratio itself, also of the difference of two methods, and not that
    of a mean.
    """
    results = score(scored_run)
    sums = {
        part: np.array(
            [
                [function(rendered(view, frame), truth(view, frame)) for frame in FRAMES]
                for view in SORTED_VIEWS
            ]
        )
        for part, function in (("above", sum_of_errors), ("below", sum_of_values))
    }
    by_hand = PooledScene(
        "room",
        SORTED_VIEWS,
        tuple(FRAMES),
        lambda views, frames: (
            views * ((frames @ sums["above"].T) / (frames @ sums["below"].T))
        ).sum(axis=1),
    )
    per_frame = sums["above"] / sums["below"]
    of_a_mean = PooledScene(
        "room", SORTED_VIEWS, tuple(FRAMES), lambda v, f: (v * (f @ per_frame.T)).sum(axis=1)
    )
    found = intervals(results, "Relative_error", "Tiny room")["whole"]
    assert found.value == pytest.approx(by_hand.value, rel=1e-12)
    assert found.half_width == pytest.approx(measure_spread([by_hand]).half_width(), rel=1e-9)
    assert found.half_width != pytest.approx(measure_spread([of_a_mean]).half_width(), rel=1e-3)
    assert compare(results, "Relative_error", "whole", "late", "Tiny room").p_value is not None


def test_what_has_no_parts_gets_no_interval_by_a_guess(scored_run):
    """A maximum over frames is one value per view: two views say nothing of its spread, and the
    note says so.
    """
    found = intervals(score(scored_run), "Worst_error", "Tiny room")["whole"]
    assert found.value == pytest.approx(np.mean([worst_error(*stacked(view)) for view in VIEWS]))
    assert (found.half_width, found.note.partition(";")[0]) == (
        None,
        "one value for each of 2 views",
    )


@pytest.mark.slow
def test_it_stands_in_its_tables(scored_run, tmp_path):
    """The report has its column in the table of its group, with unit, direction, digits and
    interval.
    """
    page = write_report([scored_run.root], tmp_path / "report", with_figures=False)
    rows = list(csv.DictReader((page.parent / "tables.csv").open(encoding="utf-8")))
    (mine,) = [row for row in rows if (row["method"], row["column"]) == ("whole", "Relative_error")]
    found = intervals(score(scored_run), "Relative_error", "Tiny room")["whole"]
    assert (mine["table"], mine["unit"], mine["higher_is_better"]) == (
        "quality",
        "of the truth",
        "False",
    )
    assert (float(mine["value"]), float(mine["lo"]), float(mine["hi"])) == (
        found.value,
        found.low,
        found.high,
    )
    assert mine["shown"] == f"{found.value:.5f}"
    assert {row["table"] for row in rows if row["column"] == "Worst_error"} == {"consistency"}
    assert "sum of the absolute errors over the sum of the true values" in page.read_text(
        encoding="utf-8"
    )


def test_its_values_stand_while_another_metric_is_scored_again(scored_run, monkeypatch):
    """Where the code of one metric changes, the numbers and parts of the others stand, whatever
    they are called.
    """
    before = score(scored_run).table
    original = score_view.metric_code
    monkeypatch.setattr(
        score_view,
        "metric_code",
        lambda metric: "new" if metric.name == "PSNR" else original(metric),
    )
    monkeypatch.setattr(RelativeErrorScorer, "add", None)  # is not asked again
    after = score(scored_run).table
    order = ["method", "view", "metric", "frame"]
    pd.testing.assert_frame_equal(
        *(table.sort_values(order, ignore_index=True) for table in (before, after))
    )


def test_it_says_what_its_values_depend_on():
    """A metric names the modules that define it, also where its scorer is a partial of a function
    elsewhere.
    """
    assert RELATIVE_ERROR.modules == (__name__,)
    assert METRICS["PSNR_moving"].modules == tuple(
        f"ggvs_eval.metrics.{module}" for module in ("image.psnr", "image.regions", "metric")
    )


@pytest.mark.parametrize(
    "room",
    [
        Path(str(statistics.__file__)).parent,
        Path(str(run_room.__file__)).parent,
        Path(str(reports.__file__)).parent / "model",
    ],
    ids=["statistics", "run", "model"],
)
def test_no_room_that_scores_or_pools_knows_a_metric_by_name(room):
    """What is true of one metric stands in its object: no string of these rooms is the name of a
    metric.
    """
    files = [*room.glob("*.py"), *room.parent.glob("tables/report_tables.py")]
    named = [
        f"{file.name}: {node.value}"
        for file in files
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))
        if isinstance(node, ast.Constant) and node.value in METRICS
    ]
    assert files
    assert named == []
