"""Tables and figure of a metric study: verdicts of several captures, and what is said where there
is nothing.
"""

import pytest

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
from ggvs_eval.files.images import read_image
from ggvs_eval.run_folder import write_json


def answered(correlation, verdict, low=None, least=None):
    return {
        "correlation": correlation,
        "verdict": verdict,
        "low": low,
        "high": correlation,
        "least_strength": least,
        "clips": 4,
    }


def study_of(blur, switch, metrics=("PSNR", "mute")):
    return {
        "captures": ["room"],
        "takes": 4,
        "ladders": {
            "blur": {"unit": "px", "strengths": [0.5, 1], "describe": "Gaussian blur"},
            "switch": {"unit": "switches", "strengths": [1, 3], "describe": "exchanged sources"},
        },
        "metrics": {
            name: {"higher_is_better": True, "unit": "", "group": "Image quality", "kind": "frame"}
            for name in metrics
        },
        "answers": {"blur": {"PSNR": blur}, "switch": {"PSNR": switch}},
        "not_computed": {"blur": {"mute": "no weights"}, "switch": {"mute": "no weights"}},
    }


SEES = answered(1.0, "sees", low=1.0, least=0.5)
BLIND = answered(0.25, "blind", low=-0.5)


def test_captures_agree_or_a_verdict_depends_on_them():
    """What both captures say stands in its column, what one alone says in the last."""
    table = verdict_table([study_of(SEES, BLIND), study_of(SEES, SEES)])

    assert (
        table.splitlines()[0]
        == "| metric | worse with strength | blind to | better with strength | depends on the "
        "capture |"
    )
    assert table.splitlines()[2:] == ["| `PSNR` | blur | – | – | switch |"]
    assert by_ladder_table([study_of(SEES, BLIND)]).splitlines()[2:] == [
        "| blur | 1 of 1 | – | – | – |",
        "| switch | 0 of 1 | `PSNR` | – | – |",
    ]


def test_a_wide_interval_is_shown():
    """An interval of a point is left out, a wide one stands behind the correlation; no least
    strength is a dash.
    """
    study = study_of(SEES, BLIND)

    assert (
        correlation_table(study).splitlines()[-1]
        == "| `PSNR` | 1 | 0.25 (\N{MINUS SIGN}0.5 to 0.25) |"
    )
    assert sensitivity_table(study).splitlines()[0] == "| metric | blur (px) | switch (switches) |"
    assert sensitivity_table(study).splitlines()[-1] == "| `PSNR` | 0.5 | – |"
    assert (
        ladder_table(study).splitlines()[-1] == "| switch | 1, 3 | switches | exchanged sources |"
    )
    assert absence_list(study) == "- `mute` not computed: no weights"


def test_two_studies_stand_side_by_side(tmp_path):
    """A field for each study in one figure, wider by one field; no study and no answer are
    refused.
    """
    for name in ("first", "second"):
        write_json(tmp_path / name / "study.json", study_of(SEES, BLIND))
    empty = study_of(SEES, BLIND) | {"answers": {"blur": {}, "switch": {}}}
    write_json(tmp_path / "empty" / "study.json", empty)
    one = read_image(draw_study({"room": tmp_path / "first"}, tmp_path / "one.png"))
    two = read_image(
        draw_study(
            {"room": tmp_path / "first", "garden": tmp_path / "second"}, tmp_path / "two.png"
        )
    )

    assert two.shape[0] == one.shape[0]
    assert two.shape[1] > one.shape[1]
    with pytest.raises(ResultsError, match="metric-study"):
        draw_study({"room": tmp_path / "absent"}, tmp_path / "none.png")
    with pytest.raises(ResultsError, match="to draw, got none"):
        draw_study({"room": tmp_path / "empty"}, tmp_path / "none.png")
