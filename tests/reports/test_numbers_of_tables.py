"""Numbers of tables and pictures against those that they are made of, computed here by hand."""

import cv2
import numpy as np
import pytest

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.page.pictures import error_map
from ggvs_eval.reports.tables.worst_frames import worst_frames_table
from helpers.run_folders import RunShape, write_run

SHAPE = RunShape(
    frames=Frames(0, 21),
    width=16,
    height=16,
    labels=("ours-geometric",),
    metrics=("PSNR", "LPIPS"),
    poses=0,
)


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Two views of 21 frames by one method."""
    return read_run(write_run(tmp_path_factory.mktemp("numbers") / "run", SHAPE))


@pytest.mark.parametrize(
    ("metric", "column", "worst_is_least"), [("PSNR", 0, True), ("LPIPS", 2, False)]
)
def test_the_worst_twentieth_ends_at_the_third_worst_of_42_frames(
    run, metric, column, worst_is_least
):
    """Of 42 frames 2.1 are a twentieth, so the third worst is shown; next to it the worst."""
    values = np.sort(
        np.concatenate(
            [run.results.per_frame(metric, view).to_numpy().ravel() for view in SHAPE.views]
        )
    )
    worst_first = values if worst_is_least else values[::-1]
    (row,) = worst_frames_table(run).rows

    assert len(values) == 42
    assert [cell.value for cell in row.cells[column : column + 2]] == pytest.approx(
        [worst_first[2], worst_first[0]]
    )


def test_an_error_map_is_brightest_from_64_levels_on():
    """A difference of 32 levels has half the scale of magma, 64 and more its end, none is
    black's.
    """
    truth = np.full((2, 4, 3), 100, np.uint8)
    rendered = truth + np.array([0, 32, 64, 120], np.uint8)[None, :, None]
    scale = np.array([[0, 128, 255, 255]], np.uint8)
    colours = cv2.cvtColor(cv2.applyColorMap(scale, cv2.COLORMAP_MAGMA), cv2.COLOR_BGR2RGB)

    assert np.abs(error_map(rendered, truth, SHAPE.views[0]).astype(int) - colours).max() <= 2
