"""Sparse protocols over the scenes of a data set: one command plans them all, and its table has the
authors' values.
"""

import dataclasses
import shutil
from contextlib import suppress
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.sweep.run_sweep import SweepResult, plan_cells, run_sweep
from ggvs_eval.protocol import Frames, load_protocol
from ggvs_eval.reports.tables.published import published_lines
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.sweep import load_sweep
from helpers.captures import FPS, make_image, make_rig, write_poses

SCENES = (
    "coffee_martini",
    "cook_spinach",
    "cut_roasted_beef",
    "flame_salmon_1",
    "flame_steak",
    "sear_steak",
)
SPARSE = load_protocol("n3v_sparse2")


def write_scenes(root: Path, scenes: tuple[str, ...], n_frames: int) -> list[Path]:
    """Scenes in the layout of Neural 3D Video: a video per camera, of the target and its named
    sources, and poses.
    """
    videos = []
    for index in range(3):
        videos.append(root / f"{index}.mp4")
        write_video(videos[-1], (make_image(index, frame % 5) for frame in range(n_frames)), FPS)
    for scene in scenes:
        names = sorted(["cam00", *SPARSE.views.sources_of(scene)])
        write_poses(root / scene, make_rig(names))
        for name, video in zip(names, videos, strict=True):
            shutil.copy(video, root / scene / f"{name}.mp4")
    return [root / scene for scene in scenes]


@pytest.mark.slow
def test_one_command_plans_the_table_of_a_supplement(tmp_path, capsys):
    """Six scenes of the published layout, 300 frames each: a dry run finds each scene's own
    sources.
    """
    scenes = write_scenes(tmp_path / "n3v", SCENES, 300)
    words = [
        "sweep",
        "sparse",
        str(tmp_path / "out"),
        "--protocol",
        "n3v_sparse2",
        "--jobs",
        "1",
        "--dry-run",
    ]

    # the plan is printed, then refused by a disk that is too small for it
    with suppress(SystemExit):
        run_command([*words, "--capture", *map(str, scenes)])

    printed = capsys.readouterr().out
    assert "6 runs of 1 views x 300 frames x 6 methods at 1352 x 1014, K = 2" in printed
    assert not (tmp_path / "out").exists()


def test_the_table_has_the_authors_values_of_each_scene_and_their_mean():
    """Lines of RF-DeRF stand below ours of each scene, and the mean over six scenes is the
    published one.
    """
    index = pd.MultiIndex.from_tuples(
        [(scene, "n3v_sparse2", "GGVS (online)") for scene in SCENES],
        names=["capture", "variant", "method"],
    )
    measured = pd.DataFrame({"PSNR": np.arange(6.0), "s/frame": 1.0}, index=index)
    result = SweepResult(measured, {}, {f"{scene}/n3v_sparse2": Path(scene) for scene in SCENES})

    lines, notes = published_lines({scene: (scene, SPARSE) for scene in SCENES}, measured.columns)
    table = result.with_lines(lines)["PSNR"]

    assert list(table["flame_steak"].index) == [
        ("n3v_sparse2", "GGVS (online)"),
        ("published", "RF-DeRF"),
    ]
    assert table["flame_steak", "published", "RF-DeRF"] == 22.70
    assert table["mean", "n3v_sparse2", "GGVS (online)"] == 2.5
    assert table["mean", "published", "RF-DeRF"] == pytest.approx(lines["PSNR"].mean())
    (source,) = notes
    assert "NagabhushanSN95/RF-DeRF at 2c40e477" in source


@pytest.mark.slow
def test_each_scene_is_rendered_from_its_own_cameras_under_one_protocol(tmp_path):
    """Two scenes in small: their sources differ, their protocol does not; other terms have no
    published line, but the reason.
    """
    protocol = dataclasses.replace(
        SPARSE,
        frames=Frames(0, 2),
        synthesis=dataclasses.replace(SPARSE.synthesis, width=64, height=48),
        measurement=dataclasses.replace(SPARSE.measurement, metrics=("PSNR",)),
    )
    scenes = write_scenes(tmp_path / "n3v", ("coffee_martini", "flame_steak"), 2)
    captures = {scene.name: (open_capture(scene), protocol) for scene in scenes}
    rows = dataclasses.replace(load_sweep("sparse"), row=load_sweep("sparse").row[:2])

    planned = plan_cells(tmp_path / "out", captures, rows)
    result = run_sweep(planned, workers=1)

    assert len({RunFolder(root).protocol().sha256 for root in result.runs.values()}) == 1
    sources = [sorted(plan.plans["cam00"].shares) for plan in planned.plans]
    assert sources == [["cam05", "cam11"], ["cam07", "cam14"]]
    lines, notes = published_lines(
        {scene.name: (scene.name, protocol) for scene in scenes}, ["PSNR"]
    )
    assert lines.empty
    assert list(notes) == [
        "published: this run differs from the packaged protocol in frames, synthesis"
    ]
    assert len(result.with_lines(lines)) == len(result.table)
