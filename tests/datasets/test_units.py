"""World units per metre: told, measured, known or guessed, in that order."""

import json
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.units import METRIC, choose_units, triangulate
from ggvs_eval.errors import CaptureError
from helpers.captures import make_rig
from helpers.refusals import refused

RIG = make_rig()
BASELINE = '[baseline]\ncameras = ["cam00", "cam03"]\nmetres = 0.5\n'
DISTANCE = float(np.hypot(0.9, 0.3))
A, B = np.array([-0.2, 0.1, 4.0]), np.array([0.7, -0.3, 5.0])


def points_toml(metres: float = 0.5, scale: float = 1.0, extra: str = "") -> str:
    """Marks of A in cameras 0 and 2, of B in three, where the cameras see them."""
    marks = {
        key: {RIG[index].name: (scale * RIG[index].project(point)[0]).tolist() for index in seen_by}
        for key, point, seen_by in (("a", A, (0, 2)), ("b", B, (0, 1, 3)))
    }
    tables = "".join(
        f"{key} = {{ {', '.join(f'{name} = {uv}' for name, uv in each.items())} }}\n"
        for key, each in marks.items()
    )
    return f"[points]\nmetres = {metres}\n{extra}{tables}"


def units_of(folder: Path, text: str | None = None, given: float | Path | None = None, **known):
    if text is not None:
        (folder / "units.toml").write_text(text)
    return choose_units(folder, given, RIG, **known)


def test_plain_number(tmp_path):
    """units.toml may just say it."""
    units = units_of(tmp_path, "units_per_metre = 12")
    assert (units.per_metre, units.origin) == (12.0, "units.toml")


def test_baseline(tmp_path):
    """The distance of two cameras in metres gives the units."""
    units = units_of(tmp_path, BASELINE)
    assert units.per_metre == pytest.approx(DISTANCE / 0.5)
    assert units.origin == "baseline cam00 - cam03 of 0.5 m"


@pytest.mark.parametrize(("scale", "extra"), [(1.0, ""), (2.0, "size = [128, 96]\n")])
def test_two_marked_points(tmp_path, scale, extra):
    """Two points that are marked in several images are triangulated, also where the marks are of a
    larger image.
    """
    units = units_of(tmp_path, points_toml(0.5, scale, extra))
    assert units.per_metre == pytest.approx(np.linalg.norm(A - B) / 0.5, rel=1e-9)
    assert units.origin == "two marked points 0.5 m apart, their rays meet within 0.0 px"


def test_the_origin_tells_how_well_the_marks_meet(tmp_path):
    """A mark that is 3 px off is told in the origin."""
    text = points_toml().replace(str(RIG[2].project(A)[0][1]), str(RIG[2].project(A)[0][1] + 3.0))
    origin = units_of(tmp_path, text).origin
    assert 1.0 < float(origin.split("within ")[1].removesuffix(" px")) < 3.0


def test_triangulation_of_noisy_marks():
    """With marks half a pixel off, the point lies within a few centimetres and the largest miss is
    told.
    """
    uv = np.stack([camera.project(A)[0] for camera in RIG]) + np.random.default_rng(2).normal(
        0, 0.5, (4, 2)
    )
    point, missed = triangulate(RIG, uv)
    assert np.linalg.norm(point[:2] - A[:2]) < 0.1
    assert 0.1 < missed < 2.0


def test_order_of_the_sources(tmp_path):
    """The user's number or file, units.toml, demo.json, the data set, the guess."""
    (tmp_path / "mine.toml").write_text("units_per_metre = 7")
    assert units_of(tmp_path).origin.startswith("guess")
    assert units_of(tmp_path, of_data_set=METRIC) == METRIC
    (tmp_path / "demo.json").write_text(json.dumps({"units_per_metre": 3.25}))
    assert units_of(tmp_path, of_data_set=METRIC).origin == "demo.json"
    assert units_of(tmp_path, BASELINE, of_data_set=METRIC).origin.startswith("baseline")
    assert units_of(tmp_path, of_data_set=METRIC, given=tmp_path / "mine.toml").per_metre == 7.0
    assert units_of(tmp_path, of_data_set=METRIC, given=2.5) == units_of(tmp_path, given=2.5)
    assert units_of(tmp_path, given=2.5).origin == "given by the user"


def test_the_guess_follows_the_median_depth(tmp_path):
    """The median depth is taken for 2 m; without depths the middle of near and far counts."""
    assert units_of(tmp_path, median_depths=[3.0, 5.0, 9.0, 5.0]).per_metre == 2.5
    assert units_of(tmp_path).per_metre == pytest.approx(2.0)


def test_a_file_from_the_command_line(dynerf, tmp_path):
    """open_capture takes a file as well, wherever it lies."""
    (tmp_path / "elsewhere.toml").write_text(BASELINE)
    assert open_capture(dynerf, units=tmp_path / "elsewhere.toml").units_per_metre == pytest.approx(
        DISTANCE / 0.5
    )


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", "wanted exactly one of units_per_metre = NUMBER, or [baseline]"),
        ("units_per_metre = 2\n" + BASELINE, "got units_per_metre, baseline; keep one"),
        ("unit = 3", "got unit; keep one"),
        ("units_per_metre = ", "not valid TOML"),
        ('units_per_metre = "2"', "wanted a positive number of world units per metre, got '2'"),
        ("units_per_metre = -2", "positive number of world units per metre, got -2"),
        ("units_per_metre = nan", "positive number of world units per metre, got nan"),
        (f"units_per_metre = 1{'0' * 400}", "positive number of world units per metre, got 1000"),
        (
            BASELINE.replace("cam03", "cam07"),
            "got: no 'cam07'; the cameras are cam00, cam01, cam02, cam03",
        ),
        (BASELINE.replace('"cam00", ', ""), "got: not enough values to unpack"),
        (
            BASELINE.replace("cam03", "cam00"),
            "positive number of world units between cam00 and cam00, got 0.0",
        ),
        (BASELINE.replace("metres = 0.5", ""), "got: no 'metres'"),
        (BASELINE.replace("0.5", "0"), "positive number of metres between the cameras, got 0"),
        ("baseline = 3", "wanted units_per_metre = NUMBER"),
        (points_toml().replace("b = ", "c = "), "got: no 'b'"),
        (points_toml(-1.0), "positive number of metres between the points, got -1.0"),
        (
            "[points]\nmetres = 1\na = { cam00 = [1, 2] }\nb = { cam00 = [1, 2] }",
            "points.a wanted in at least two cameras, got 1",
        ),
        (points_toml(extra="size = [0, 0]\n"), "wanted units_per_metre = NUMBER"),
        (
            f"[points]\nmetres = 1\na = {{ cam00 = [1{'0' * 400}, 1], cam01 = [2, 1] }}\nb = 1",
            "wanted units_per_metre = NUMBER",
        ),
        (
            "[points]\nmetres = 1\na = { cam00 = [nan, 1], cam01 = [2, 1] }\nb = { cam00 = [1, 1], "
            "cam01 = [2, 1] }",
            "wanted",
        ),
        (f"a = {'[' * 5000}", "TOML"),
        ('"two\\nlines" = 1', "got two lines; keep one"),
    ],
)
def test_damaged_units_file(tmp_path, text, message):
    """Whatever a units.toml says wrongly is refused in one line that names file, expectation and
    finding.
    """
    with pytest.raises(CaptureError) as caught:
        units_of(tmp_path, text)
    told = str(caught.value)
    assert message in told
    assert "units.toml: " in told
    assert "\n" not in told


def test_bytes_that_are_no_text_and_a_file_that_is_not_there(tmp_path):
    """A units file must exist and be text."""
    (tmp_path / "units.toml").write_bytes(b"\xff\xfe\x00")
    with refused(CaptureError, "units.toml", "TOML"):
        units_of(tmp_path)
    with refused(CaptureError, "mine.toml", "no such file"):
        units_of(tmp_path, given=tmp_path / "mine.toml")


@pytest.mark.parametrize("note", ["1e999", "1" + "0" * 400, "[" * 100000, '"x"', "-1", "NaN"])
def test_damaged_note_of_a_demo(tmp_path, note):
    """Numbers beyond all measure and deep nesting in demo.json are refused, too."""
    (tmp_path / "demo.json").write_text(f'{{"units_per_metre": {note}}}')
    with pytest.raises(CaptureError, match=r"demo\.json: wanted a"):
        units_of(tmp_path)
