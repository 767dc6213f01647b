"""Values of one method that two machines measured are compared before they are one."""

import shutil
from pathlib import Path

import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.sweep.merging.merge import join_results, same_values
from ggvs_eval.run_folder import JOB_FILE, read_json, write_json


def write_scores(folder: Path, psnr_db: float, inputs: str = "frames") -> Path:
    """Write one value of one method."""
    record = {
        "sha256": inputs,
        "identity": {"rendered": inputs},
        "files": {},
        "values": [["PSNR", 0, psnr_db]],
    }
    write_json(folder / JOB_FILE, record)
    return folder


@pytest.mark.parametrize(
    ("psnr_db", "inputs", "reason"),
    [(30.1, "frames", "values"), (30.1, "others", "other rendered")],
)
def test_other_values_of_one_method_are_refused(psnr_db, inputs, reason, tmp_path):
    """A tenth of a decibel more is named with both folders; of other frames it is said so."""
    folders = [write_scores(tmp_path / "a", 30.0), write_scores(tmp_path / "b", psnr_db, inputs)]

    with pytest.raises(ResultsError, match=f"a and .*b differ.*{reason}"):
        join_results(folders, tmp_path / "merged", shutil.copy2)


def test_equal_values_are_one_up_to_rounding(tmp_path):
    """What differs by a ten-millionth was added in another order; the first run's stays."""
    folders = [write_scores(tmp_path / "a", 30.0), write_scores(tmp_path / "b", 30.0 + 3e-7)]
    join_results(folders, tmp_path / "merged", shutil.copy2)

    assert read_json(tmp_path / "merged" / JOB_FILE)["values"] == [["PSNR", 0, 30.0]]


@pytest.mark.parametrize(
    ("first", "second", "is_same"),
    [
        ({"a": [1.0, "x"]}, {"a": [1.0 + 5e-7, "x"]}, True),
        ({"a": [1.0, "x"]}, {"a": [1.0 + 5e-6, "x"]}, False),
        ([float("nan")], [float("nan")], True),
        ([float("nan")], [1.0], False),
        ([1.0], [1.0, 2.0], False),
        ({"a": 1}, {"b": 1}, False),
        ("ab", ["a", "b"], False),
    ],
)
def test_records_are_compared_to_a_millionth(first, second, is_same):
    """Numbers up to rounding, missing ones as such, texts and lengths exactly."""
    assert same_values(first, second) is is_same
