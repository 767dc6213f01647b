"""Results: tidy table, order of means, refusal to mix protocols."""

import numpy as np
import pytest

from ggvs_eval.errors import ResultsError
from ggvs_eval.merged_results import merge_results
from ggvs_eval.results import Results, make_table


def make_results(values, digest="a" * 64, scene="room", method="ours") -> Results:
    rows = [
        ("Demo", scene, method, "", view, frame, "PSNR", value)
        for (view, frame), value in values.items()
    ]
    return Results(
        make_table(rows),
        {"protocol_sha256": digest, "inputs": {f"{scene}/cam00": f"frames of {scene}"}},
    )


def test_means_are_taken_over_frames_then_views_then_scenes():
    """A view with more frames, or a scene with more views, weighs no more; a value without a view
    counts over frames.
    """
    # views 15 and 31: scene 23
    first = make_results({("a", 0): 10.0, ("a", 1): 20.0, ("b", 0): 31.0})
    second = make_results({("a", 0): 3.0}, scene="hall")

    summary = merge_results([first, second]).summary()

    assert summary.loc[("Demo", "ours", ""), "PSNR"] == pytest.approx((23 + 3) / 2)
    rows = [("Demo", "room", "ours", "", None, frame, "SDV", float(frame)) for frame in range(3)]
    results = Results(make_table(rows), {"protocol_sha256": "a", "inputs": {}})

    assert results.summary().iloc[0]["SDV"] == 1.0


def test_results_survive_the_disk(tmp_path):
    """What is written is read back: values to the last bit, provenance, reasons."""
    results = make_results({("a", 0): np.pi, ("b", 0): 1 / 3})
    results = Results(results.table, results.provenance, {"LPIPS": "no weights"})
    results.write(tmp_path)

    back = Results.read(tmp_path)

    assert back.table.equals(results.table)
    assert (back.provenance, back.not_computed) == (results.provenance, results.not_computed)


def test_different_protocols_do_not_share_a_table():
    """Merging results of two protocols is refused, naming both hashes."""
    with pytest.raises(ResultsError, match=r"aaaaaaaaaaaa, bbbbbbbbbbbb"):
        merge_results(
            [make_results({("a", 0): 1.0}), make_results({("a", 0): 1.0}, digest="b" * 64)]
        )


def test_damaged_results_are_refused(tmp_path):
    """Absent ones name the files and the command; a truncated table is an error of the family, not
    a crash of the reader.
    """
    with pytest.raises(ResultsError, match=r"results.parquet.*ggvs-eval score"):
        Results.read(tmp_path)
    make_results({("a", 0): 1.0}).write(tmp_path)
    file = tmp_path / "results.parquet"
    file.write_bytes(file.read_bytes()[:100])

    with pytest.raises(ResultsError, match=r"results.parquet"):
        Results.read(tmp_path)
