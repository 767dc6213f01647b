"""Values of one method that two machines measured are compared before they are one."""

import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.pipelines.sweep.merging.merge import merge_scores, same_values
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json


def write_scores(folder, psnr, identity="frames"):
    """A run with one value of one method."""
    run = RunFolder(folder)
    method = {"identity": identity, "values": [["PSNR", 0, psnr]]}
    write_json(run.scores("cam00") / JOB_FILE, {"methods": {"ours": method}})
    return run


@pytest.mark.parametrize(("psnr", "identity", "reason"), [(30.1, "frames", "values"), (30.1, "others", "frames or metrics")])
def test_other_values_of_one_method_are_refused(psnr, identity, reason, tmp_path):
    """A tenth of a decibel more is named with both files; of other frames it is said so."""
    runs = [write_scores(tmp_path / "a", 30.0), write_scores(tmp_path / "b", psnr, identity)]

    with pytest.raises(ResultsError, match=f"differ in the {reason} of ours"):
        merge_scores(runs, tmp_path / "merged")


def test_equal_values_are_one_up_to_rounding(tmp_path):
    """What differs by a ten-millionth was added in another order; the first run's stays."""
    merge_scores([write_scores(tmp_path / "a", 30.0), write_scores(tmp_path / "b", 30.0 + 3e-7)], tmp_path / "merged")

    record = read_json(RunFolder(tmp_path / "merged").scores("cam00") / JOB_FILE)
    assert record["methods"]["ours"]["values"] == [["PSNR", 0, 30.0]]


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
