"""A run is planned before it starts: what is counted is what is made, what cannot fit is refused, what was tried is kept."""

import dataclasses
import shutil
import time
from collections import namedtuple
from pathlib import Path

import pytest

from ggvs_eval.errors import ProtocolError
from ggvs_eval.jobs.shard import WHOLE, Shard
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.network_options import AS_SHIPPED
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.offline.depth.depth_choice import DepthRunOptions
from ggvs_eval.pipelines.planning import plan as run_plan
from ggvs_eval.pipelines.planning import probe as trial
from ggvs_eval.pipelines.planning.estimate import DEPTH_BYTES, Portion
from ggvs_eval.pipelines.planning.plan import RunPlan, duration, plan_runs
from ggvs_eval.pipelines.planning.rates import Rates
from ggvs_eval.pipelines.planning.run_request import RunRequest
from ggvs_eval.pipelines.planning.work_left import WorkLeft, plan_frames
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.sweep.cells import run_requests
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.sweep import Sweep, SweepRow
from helpers.command_line import refusal
from helpers.small_runs import LABELS, small_protocol, write_small_capture

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 3)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return small_protocol(3, 3, ("PSNR", "L1", "PSNR_disoccluded"))


@pytest.fixture(scope="module")
def tried(capture, protocol, tmp_path_factory):
    """A run that was planned with a trial, and its plan, before anything else is done."""
    root = tmp_path_factory.mktemp("tried") / "run"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)
        plan = plan_runs([RunRequest(root, capture, protocol, LABELS)], 1, root)
    return root, plan


@pytest.fixture(scope="module")
def finished(tried, capture, protocol, tmp_path_factory):
    """The same run, done after its trial."""
    root = tmp_path_factory.mktemp("finished") / "run"
    shutil.copytree(tried[0], root)
    measure(root, capture, protocol, LABELS, 1)
    return root


def n_files(folder: Path, pattern: str) -> int:
    return sum(1 for _ in folder.rglob(pattern))


def test_what_is_counted_is_what_is_made(capture, protocol, finished, tmp_path):
    """Before a run the plan counts exactly the frames, depth maps, masks and renders that the run then leaves."""
    left = plan_runs([RunRequest(tmp_path / "run", capture, protocol, LABELS)], 1, tmp_path).portions[0].left
    run = RunFolder(finished)

    assert sum(left.truth.values()) == n_files(run.root / "truth", "*.png")
    assert left.n_depth == n_files(run.depth, "*.npz")
    assert sum(left.disoccluded.values()) == n_files(run.root / "disoccluded", "*.png")
    assert left.path_depth == n_files(run.path_depth, "*.npy")
    assert sum(left.renders.values()) == n_files(run.root / "renders", "*.png")
    assert sum(left.path_renders.values()) == n_files(run.root / "path", "*.png")
    assert {folder.name for folder in left.scores} == {"cam00", "cam01"}


def test_nothing_is_said_where_everything_is_done(capture, protocol, finished):
    """A finished run has no plan; one more method has that method's frames alone."""
    assert plan_runs([RunRequest(finished, capture, protocol, LABELS)], 1, finished).describe() == ""

    more = plan_runs([RunRequest(finished, capture, protocol, (*LABELS, "ours-geometric"))], 1, finished)

    assert more.portions[0].left.n_rendered == 2 * 3 + 3
    assert more.portions[0].left.n_depth == 0
    assert "9 frames to render, 0 depth maps" in more.describe()


def test_a_small_run_is_not_tried(capture, protocol, tmp_path):
    """A run of a few seconds is told in two lines, and nothing is written for it."""
    text = plan_runs([RunRequest(tmp_path / "run", capture, protocol, LABELS)], 1, tmp_path / "run").describe()

    assert [line.split(":")[0] for line in text.splitlines()] == ["plan", "disk"]
    assert "2 views x 3 frames x 2 methods at 64 x 48, K = 2" in text
    assert list(tmp_path.iterdir()) == []


def test_a_trial_tells_memory_and_time(tried):
    """After a trial of every stage the plan says what a process holds and how long the run takes."""
    _, plan = tried

    assert plan.rates is not None
    assert min(plan.rates.depth_s, plan.rates.score_s, plan.rates.mask_s, plan.rates.pose_depth_s, plan.rates.truth_s) > 0
    assert set(plan.rates.step_s) == set(LABELS)
    assert min(plan.rates.step_s.values()) > 0
    assert 5e7 < plan.rates.memory_bytes < 5e9
    assert [line.split(":")[0] for line in plan.describe().splitlines()] == ["plan", "disk", "memory", "time"]
    assert all(seconds > 0 for seconds in plan.stage_seconds().values())


def test_a_trial_is_not_wasted(tried, finished):
    """Frames and depth of a trial are those of the run, bit for bit and not made again; of its renders nothing stays."""
    root, _ = tried
    kept = [file for folder in ("truth", "depth") for file in (root / folder).rglob("*.*") if file.is_file()]

    assert n_files(root / "depth", "*.npz") >= 4
    assert not (root / "renders").exists()
    assert not (root / ".probe.tmp").exists()
    assert all((finished / file.relative_to(root)).read_bytes() == file.read_bytes() for file in kept)


def test_a_tried_run_equals_one_that_was_not(finished, capture, protocol, tmp_path):
    """Depth and captured frames of the first instants are the same bytes with and without a trial."""
    from ggvs_eval.pipelines.run.prepare import prepare

    prepare(tmp_path / "run", capture, dataclasses.replace(protocol, frames=Frames(0, 1), path=CameraPath(0)))
    made = [file for folder in ("truth", "depth") for file in (tmp_path / "run" / folder).rglob("*.*") if file.is_file()]

    assert made
    for file in made:
        assert (finished / file.relative_to(tmp_path / "run")).read_bytes() == file.read_bytes()


def test_a_dry_run_leaves_nothing(capture, protocol, tmp_path, monkeypatch, capsys):
    """`--dry-run` prints the plan, with a trial, and leaves no trace."""
    monkeypatch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)
    (tmp_path / "p.toml").write_text(dataclasses.replace(protocol, frames=Frames(0, 2), path=CameraPath(0)).to_toml())
    arguments = ["--capture", str(capture.path), "--protocol", str(tmp_path / "p.toml"), "--jobs", "1", "--dry-run"]

    run_command(["prepare", str(tmp_path / "run"), *arguments])

    assert "time: about" in capsys.readouterr().out
    assert [item.name for item in tmp_path.iterdir()] == ["p.toml"]


def test_a_run_that_cannot_fit_is_refused(capture, protocol, tmp_path, monkeypatch):
    """Where the disk has less room than the run needs, one line says both and what to do; nothing is begun."""
    monkeypatch.setattr(run_plan.shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 1000))
    (tmp_path / "p.toml").write_text(protocol.to_toml())

    message = refusal("run", tmp_path / "run", "--capture", capture.path, "--protocol", tmp_path / "p.toml")

    assert "the disk has 0.0 MB free" in message
    assert "choose a folder on another disk" in message
    assert not (tmp_path / "run").exists()


def test_disk_is_what_the_run_leaves(finished, capture, protocol, tmp_path):
    """The estimate of depth alone is right within 15 %, headers included; all of it within a factor of two."""
    plan = plan_runs([RunRequest(tmp_path / "run", capture, protocol, LABELS)], 1, tmp_path)
    left = plan.portions[0].left
    depth = sum(file.stat().st_size for file in (finished / "depth").rglob("*.npz"))
    everything = sum(file.stat().st_size for file in finished.rglob("*") if file.is_file())

    assert left.n_depth * 64 * 48 * DEPTH_BYTES == pytest.approx(depth, rel=0.15)
    assert everything / 2 < plan.disk_bytes < everything * 2


def test_time_is_that_of_jobs_in_several_processes(tmp_path):
    """Jobs of 3, 3 and 3 frames at 2 s in two processes that need 1 s to start take 13 s; runs that share depth find it once."""
    jobs = {(label, tmp_path / label): 3 for label in "abc"}
    depth = {tmp_path / "depth": 4}
    left = WorkLeft({}, depth, {}, {}, 0, jobs)
    rates = Rates(start_s=1.0, depth_s=5.0, step_s=dict.fromkeys("abc", 2.0))
    plan = RunPlan("", (Portion(left, 100, 2), Portion(left, 100, 4)), rates, 2, 2, tmp_path)

    seconds = plan.stage_seconds()

    assert seconds["frames and depth"] == 1 + 4 * 5
    assert seconds["rendering"] == (1 + 2 * 6) + (1 + 2 * 12)
    assert plan.disk_bytes >= 4 * 100 * DEPTH_BYTES


def test_a_sweep_is_planned_as_one(capture, protocol, tmp_path):
    """Variants that share frames count them once; a shard has its own views alone, and one that prepares renders nothing."""
    sweep = Sweep("s", "", (SweepRow("A", "no-blending"),), k=(2, 3))
    captures = {"": (capture, protocol)}
    whole, half, first = (
        plan_runs(run_requests(tmp_path, captures, sweep, None, AS_SHIPPED, shard), 1, tmp_path)
        for shard in (WHOLE, Shard(1, 2), Shard(0, 2))
    )

    assert whole.title.startswith("2 runs of ")
    assert sum(each.left.n_rendered for each in whole.portions) == 2 * (2 * 3 + 3)
    assert sum(each.left.n_rendered for each in half.portions) == pytest.approx(9, abs=3)
    assert sum(each.left.n_rendered for each in first.portions) == 0
    alone = plan_runs(run_requests(tmp_path, captures, sweep, None, AS_SHIPPED, WHOLE)[:1], 1, tmp_path)
    assert alone.disk_bytes < whole.disk_bytes < 2 * alone.disk_bytes
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_another_run_is_refused_before_a_trial(finished, capture, protocol, monkeypatch):
    """A trial writes nothing into a folder that belongs to another protocol."""
    monkeypatch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)
    other = dataclasses.replace(protocol, synthesis=Synthesis(3))

    with pytest.raises(ProtocolError, match="another protocol or capture"):
        plan_runs([RunRequest(finished, capture, other, LABELS)], 1, finished)


@pytest.mark.parametrize(("seconds", "text"), [(7.2, "7 s"), (119, "119 s"), (600, "10 min"), (9000, "2.5 h")])
def test_durations_are_told_in_their_unit(seconds, text):
    """Seconds below two minutes, minutes below two hours, then hours."""
    assert duration(seconds) == text


def test_a_trial_asks_what_is_left_alone(capture, protocol, finished, tmp_path, monkeypatch):
    """Methods that have all their frames cost a trial nothing."""
    root = tmp_path / "run"
    shutil.copytree(finished, root)
    monkeypatch.setattr(run_plan, "PROBED_FROM_PIXELS", 0)

    plan = plan_runs([RunRequest(root, capture, protocol, (*LABELS, "ours-geometric"))], 1, root)

    assert plan.rates is not None
    assert set(plan.rates.step_s) == {"ours-geometric"}


def test_a_slow_method_is_tried_once(capture, protocol, tmp_path, monkeypatch):
    """Where the first frame takes long a second one would double the trial; scoring is tried all the same."""
    spec, asked = find_method("no-blending"), []

    class Slow:
        def __init__(self) -> None:
            self.method = spec.make()

        def step(self, instant):
            asked.append(instant.index)
            return self.method.step(instant)

    monkeypatch.setattr(trial, "SLOW_S", 0.0)
    options = DepthRunOptions().options()
    planned, _ = plan_frames(tmp_path, capture, protocol, options, None)
    rates = trial.probe(planned, options, {"slow": dataclasses.replace(spec, make=Slow)}, tmp_path, time.time())

    assert asked == [protocol.frames.start]
    assert rates.step_s["slow"] > 0
    assert rates.score_s > 0
