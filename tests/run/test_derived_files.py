"""Masks and path depth are made anew when the code or the depth that they come from changes, and
only then.
"""

import os
from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions
from ggvs_eval.pipelines.run import path_depth
from ggvs_eval.pipelines.run.derived_files import digest_folder
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.run_folder import JOB_FILE, frame_path, read_json, write_json
from helpers.other_code import change_code
from helpers.small_runs import small_protocol, write_small_capture
from helpers.tasks_left import tasks_left


@pytest.fixture(scope="module")
def plan(tmp_path_factory) -> RunPlan:
    """A run that has been prepared."""
    folder = tmp_path_factory.mktemp("derived")
    protocol = small_protocol(2, 3, ("PSNR", "PSNR_disoccluded"))
    made = plan_run(RunRequest(folder / "run", write_small_capture(folder / "demo", 2), protocol))
    prepare_run(made)
    return made


def test_path_depth_is_fused_at_the_lengths_of_the_online_method():
    """The same two numbers, which a run without that method keeps."""
    options = OnlineOptions()

    assert (options.tau_m, options.depth_noise_m) == (path_depth.TAU_M, path_depth.NOISE_M)


def damage(plan: RunPlan) -> tuple[Path, Path]:
    """Write something else into one mask and one depth map."""
    mask, pose = frame_path(plan.run.disoccluded("cam00"), 1), plan.run.path_depth / "0002.npy"
    write_image(mask, np.full_like(read_image(mask), 77))
    pose.write_bytes(b"damaged")
    return mask, pose


def files_left(plan: RunPlan) -> Counter[str]:
    """How much of each kind is missing."""
    left: Counter[str] = Counter()
    for task in tasks_left(plan):
        left[task.kind] += task.count
    return left


@pytest.mark.parametrize(
    ("module", "masks", "poses"),
    [
        ("geometry.splat", True, True),
        ("pipelines.run.disocclusion", True, True),
        ("camera", True, True),
        ("metrics.stream", False, False),
    ],
)
def test_what_the_code_has_made_otherwise(module, masks, poses, plan, monkeypatch):
    """The code that made them has changed: they are counted as missing, and made anew; what other
    code made stays.
    """
    prepare_run(plan)
    change_code(monkeypatch, module)

    # Depth keys depend on cameras too, but a plan that is made keeps its own.
    left = files_left(plan)
    assert (left["mask"], left["path depth"]) == (4 if masks else 0, 3 if poses else 0)

    prepare_run(plan)
    left = files_left(plan)
    assert (left["mask"], left["path depth"]) == (0, 0)


def test_what_was_changed_is_made_anew(plan):
    """A mask and a pose's depth that somebody wrote over count as missing, alone, and come back; a
    mask of other depth, too.
    """
    prepare_run(plan)
    mask, pose = damage(plan)

    left = files_left(plan)
    assert (left["mask"], left["path depth"]) == (1, 1)

    prepare_run(plan)
    assert 77 not in read_image(mask)
    assert np.load(pose).dtype == np.float32
    record = plan.run.disoccluded("cam00") / JOB_FILE
    write_json(record, read_json(record) | {"sha256": "of other depth"})

    assert {task.folder.name: task.count for task in tasks_left(plan) if task.kind == "mask"} == {
        "cam00": 2
    }


def test_a_folder_is_known_by_what_it_holds(tmp_path):
    """Records that are written again as they were change nothing; a picture that is, a new file and
    a new value do.
    """
    record, picture = tmp_path / "a.json", tmp_path / "deep" / "b.png"
    picture.parent.mkdir()
    record.write_text("1")
    picture.write_bytes(b"x")
    known = {digest_folder(tmp_path)}
    record.write_text("1")
    assert digest_folder(tmp_path) in known
    os.utime(picture, ns=(1, 1))
    known.add(digest_folder(tmp_path))
    record.write_text("2")
    known.add(digest_folder(tmp_path))
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "c.png").touch()
    assert digest_folder(tmp_path, without=["report"]) in known
    known.add(digest_folder(tmp_path))
    assert len(known) == 4
