"""One capture under several calibrations or depths: planted errors cost what they cost, and unlike
frames are refused.
"""

import csv
import re
import shutil

import numpy as np
import pytest

from ggvs_eval.contrib.given_depth.calibrations import parse_variants
from ggvs_eval.contrib.given_depth.depth_files import z_per_distance
from ggvs_eval.contrib.worlds.film.film import read_exact_depth
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CommandError
from ggvs_eval.pipelines.commands.main import run_command
from helpers.packed_films import unpack_film
from helpers.refusals import refused

PROTOCOL = (
    '[views]\ntest = ["cam01"]\n[measurement]\nmetrics = ["PSNR"]\nceilings = '
    "false\n[path]\nposes = 0\n"
)
COMMAND = ("calibrations", "out", "given=room")
TERMS = ("--protocol", "p.toml", "--depth-scale", "1", "--matcher", "live", "--jobs", "1")


@pytest.fixture(scope="module")
def rooms(tmp_path_factory):
    """A folder with a capture, exact depth 5 % too large, and exact lengths of rays; and a protocol
    of one view.
    """
    root = tmp_path_factory.mktemp("calibrations")
    capture = open_capture(unpack_film("deep", root / "room"))
    for name in capture.camera_names:
        z = np.stack(
            [
                read_exact_depth(capture.path, name, frame).astype(np.float32)
                for frame in range(capture.n_frames)
            ]
        )
        along = z_per_distance(capture.camera(name), z.shape[1:]).astype(np.float32)
        for folder, values in (("exact", z), ("scaled", 1.05 * z), ("rays", z / along)):
            (root / folder).mkdir(exist_ok=True)
            np.save(root / folder / f"{name}.npy", values)
    (root / "p.toml").write_text(PROTOCOL, encoding="utf-8")
    return root


@pytest.mark.slow
def test_planted_errors_of_depth_cost_quality(rooms, monkeypatch, capsys):
    """A scale 5 % off costs some, lengths of rays more, each against the first variant's exact
    depth; verdicts name variants.
    """
    monkeypatch.chdir(rooms)
    run_command(
        [
            "calibrations",
            "out",
            "first=room",
            "--depths",
            "first=exact",
            "second=scaled",
            "rays=rays",
            *TERMS,
        ]
    )

    printed = capsys.readouterr().out
    with (rooms / "out" / "calibrations.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    costs = {
        row["method"].rpartition(": ")[2].split()[0]: float(row["difference"])
        for row in rows
        if not row["view"]
    }
    assert costs["rays"] < costs["second"] < -0.03, costs
    assert "minus first" in printed
    assert all(name in printed for name in ("rays", "PSNR (dB)"))
    assert re.search(r"^ second .* first (?:better|ahead)", printed, re.MULTILINE)
    for row in rows:
        assert row["verdict"].startswith("first ")
        assert float(row["value"]) - float(row["value of first"]) == pytest.approx(
            float(row["difference"])
        )


def test_other_pictures_are_refused_before_anything_is_rendered(rooms, tmp_path, monkeypatch):
    """The frames of a test view must be the same, since a difference would be one of the
    reference.
    """
    monkeypatch.chdir(rooms)
    shutil.copytree(rooms / "room", tmp_path / "other")
    shutil.copy(rooms / "room" / "cam02.mp4", tmp_path / "other" / "cam01.mp4")

    with refused(
        SystemExit, f"{tmp_path / 'other'}: wanted the frames of room, but frame 0 of cam01 differs"
    ):
        run_command([*COMMAND, f"other={tmp_path / 'other'}", *TERMS])


@pytest.mark.parametrize(
    ("variants", "depths", "message"),
    [
        ((), (), "wanted NAME=CAPTURE of at least one capture, got none"),
        (("given=room",), (), "wanted at least two variants, got given"),
        (("room",), (), "wanted NAME=PATH with a name that a folder can have, got room"),
        (
            ("../up=room",),
            (),
            "wanted NAME=PATH with a name that a folder can have, got ../up=room",
        ),
        (("a=room", "a=other"), (), "wanted each name once"),
    ],
)
def test_what_names_no_variants_is_one_line(variants, depths, message):
    """Before anything is read."""
    with pytest.raises(CommandError, match=message):
        parse_variants(variants, depths)
