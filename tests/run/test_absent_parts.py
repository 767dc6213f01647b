"""A run does without the parts that are not installed; a method that wants one of them is refused
in a line that names both.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval import plugins
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import AbsentPartError
from ggvs_eval.pipelines.offline.depth.matchers import MATCHERS
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Views
from ggvs_eval.run_folder import frame_path
from helpers.refusals import refused
from helpers.small_runs import small_protocol, write_small_capture
from helpers.tasks_left import tasks_left

OFFLINE = "ggvs_eval.pipelines.offline"
DEPTH = f"{OFFLINE}.depth"
PREPARATIONS = tuple(
    f"ggvs_eval.pipelines.run.{name}"
    for name in ("camera_path", "disocclusion", "fits", "live_depth")
)


@pytest.fixture(scope="module")
def small_capture(tmp_path_factory):
    """Six cameras in two rows."""
    return write_small_capture(tmp_path_factory.mktemp("room") / "small")


@pytest.fixture
def remove(monkeypatch):
    """Let parts count as not installed."""

    def without(*parts: str) -> None:
        monkeypatch.setattr(
            plugins, "missing_part", lambda module: next(filter(module.startswith, parts), None)
        )

    return without


@pytest.mark.slow
def test_methods_that_want_no_depth_render_the_same_without_it(small_capture, tmp_path, remove):
    """Their sources are the nearest cameras, whose depth is unknown; pictures are equal to those of
    a run with depth.
    """
    protocol = replace(small_protocol(2, 0, ("PSNR",)), views=Views(("cam04",), "in the middle"))
    runs = []
    for name in ("with", "without"):
        plan = plan_run(RunRequest(tmp_path / name, small_capture, protocol, ("interpolation",)))
        assert not measure(plan, 1).table.empty
        assert not tasks_left(plan)
        runs.append(plan.run)
        remove(DEPTH)

    first, second = (
        frame_path(run.renders("interpolation", "cam04"), 1).read_bytes() for run in runs
    )
    assert first == second
    assert not runs[1].depth_record.exists()
    unknown = DepthStore(runs[1].depth).read(plan.view_jobs[0].key, 1)
    assert not np.any([unknown.depth, unknown.confidence])


@pytest.mark.parametrize(
    ("part", "label", "depth"),
    [
        (DEPTH, "no-blending", None),
        (DEPTH, "interpolation", DepthRunOptions("sgbm")),
        (PREPARATIONS[2], "4dgs", None),
    ],
)
def test_what_wants_an_absent_part_is_refused(small_capture, tmp_path, remove, part, label, depth):
    """The line names the method, or the option, and the part; nothing is written."""
    remove(part)
    asker = "--matcher" if depth else label
    with refused(AbsentPartError, f"{asker}: ", f"is part of {part}", "reinstall"):
        plan_run(
            RunRequest(
                tmp_path / "run", small_capture, small_protocol(1, 0, ("PSNR",)), (label,), depth
            )
        )
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_a_run_without_preparations_is_scored(small_capture, tmp_path, remove):
    """It has no camera path and no masks, says so, and the same values otherwise."""
    protocol, results = small_protocol(2, 2, ("PSNR", "PSNR_disoccluded", "reprojection")), []
    for name in ("with", "without"):
        plan = plan_run(RunRequest(tmp_path / name, small_capture, protocol, ("no-blending",)))
        results.append(measure(plan, 1))
        remove(*PREPARATIONS)

    first, second = (result.per_frame("PSNR", "cam00") for result in results)
    assert first.equals(second)
    assert "no masks" in results[1].not_computed["PSNR_disoccluded"]
    assert "camera path" in results[1].not_computed["reprojection"]
    assert not plan.path


@pytest.mark.parametrize(
    ("part", "matcher"),
    [
        ("stereo.sgbm", "sgbm"),
        ("stereo.live", "live"),
        ("plane_sweep", "sweep"),
        ("stereo.raft_matcher", "sgbm+raft"),
        ("itermvs", "itermvs:weights.ckpt"),
    ],
)
def test_a_matcher_that_is_absent_is_refused(remove, part, matcher):
    """In a line that names its part; the others are still known."""
    remove(f"{OFFLINE}.{part}")
    with refused(AbsentPartError, f"is part of {OFFLINE}.{part}", "reinstall"):
        DepthRunOptions(matcher).options()
    assert len(MATCHERS) == len(MATCHERS.known()) - 1
