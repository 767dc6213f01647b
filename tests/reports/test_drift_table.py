"""The table of drift: a planted slope comes back, what all methods share does not count, short
clips have no table.
"""

import numpy as np
import pytest

from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.tables.drift import LEAST_FRAMES, PER_FRAMES, drift_table
from ggvs_eval.results import Results
from helpers.run_folders import RunShape, write_run

LABELS = ("fwd", "ibrnet", "enerf")
PLANTED_DB = -0.02  # per frame, of one method
HARDER_DB = -0.05  # per frame, of all


def long_run(root, frames: int, labels: tuple[str, ...] = LABELS) -> None:
    """A run whose scene gets harder for all, and in which ENeRF gets worse beside."""
    shape = RunShape(
        frames=Frames(0, frames),
        labels=labels,
        names=tuple(zip(labels, labels, strict=True)),
        metrics=("PSNR",),
        poses=0,
    )
    write_run(root, shape, paint=lambda *_: np.zeros((8, 8, 3), np.uint8))
    results, random = Results.read(root), np.random.default_rng(0)
    table = results.table
    for label in labels:
        mine = table["method"] == label
        slope = HARDER_DB + (PLANTED_DB if label == "enerf" else 0.0)
        table.loc[mine, "value"] = (
            30 + slope * table.loc[mine, "frame"] + random.normal(0, 0.1, mine.sum())
        )
    results.write(root)


def test_a_planted_drift_is_told_apart_from_the_scene(tmp_path):
    """All lose with the scene; apart from it the one that drifts does, by two thirds of its slope,
    and the others gain.
    """
    long_run(tmp_path / "run", LEAST_FRAMES)
    table = drift_table(read_run(tmp_path / "run"))
    cells = {row.name: row.cells for row in table.rows}
    assert [column.name for column in table.columns] == ["PSNR", "PSNR, apart from the scene"]
    assert cells["fwd"][0].value == pytest.approx(PER_FRAMES * HARDER_DB, abs=0.3)
    assert cells["enerf"][0].value == pytest.approx(PER_FRAMES * (HARDER_DB + PLANTED_DB), abs=0.3)
    assert cells["enerf"][1].low < PER_FRAMES * PLANTED_DB * 2 / 3 < cells["enerf"][1].high < 0
    assert cells["fwd"][1].low > 0


def test_short_clips_have_no_table(tmp_path):
    """A slope over a second of video says nothing; one method alone is all of the mean, and has no
    column apart from it.
    """
    long_run(tmp_path / "run", 8)
    assert drift_table(read_run(tmp_path / "run")) is None
    long_run(tmp_path / "alone", LEAST_FRAMES, LABELS[:1])
    assert [column.name for column in drift_table(read_run(tmp_path / "alone")).columns] == ["PSNR"]
