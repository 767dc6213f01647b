"""A run is planned before it starts: what is counted is what is made, what cannot fit is refused,
one key serves all.
"""

import dataclasses
import shutil
from collections import Counter, namedtuple
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.baselines.registry import LEARNED_BASELINES
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import ProtocolError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.jobs.machine import estimate
from ggvs_eval.jobs.shard import WHOLE, Shard
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods import registry, spec
from ggvs_eval.pipelines.methods.stage_costs import N_BYTES, render_cost
from ggvs_eval.pipelines.offline.depth import fill_store
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.run import outlook
from ggvs_eval.pipelines.run.derived_files import digest_folder
from ggvs_eval.pipelines.run.evaluate import measure, render
from ggvs_eval.pipelines.run.outlook import Workload, count_work
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.sweep.run_sweep import plan_cells, run_sweep
from ggvs_eval.progress import duration
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, write_json
from ggvs_eval.sweep import Sweep, SweepRow
from ggvs_eval.tasks.task import Made, Result
from ggvs_eval.tasks.task_list import TaskList
from helpers.command_line import refusal
from helpers.refusals import refused
from helpers.small_runs import LABELS, small_protocol, write_small_capture
from helpers.tasks_left import tasks_left

pytestmark = [pytest.mark.usefixtures("no_figures")]

Usage = namedtuple("Usage", "total used free")


@pytest.fixture(scope="module")
def demo_capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 3)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return small_protocol(3, 3, ("PSNR", "L1", "PSNR_disoccluded"))


@pytest.fixture(scope="module")
def finished(demo_capture, protocol, tmp_path_factory) -> Path:
    """A run that is done."""
    root = tmp_path_factory.mktemp("finished") / "run"
    measure(planned(root, demo_capture, protocol), 1)
    return root


def planned(root: Path, capture, protocol: Protocol, labels=LABELS) -> RunPlan:
    return plan_run(RunRequest(root, capture, protocol, labels))


def n_files(folder: Path, pattern: str) -> int:
    return sum(1 for _ in folder.rglob(pattern))


def counts(plan: RunPlan) -> Counter[str]:
    """How much of each kind is left."""
    left: Counter[str] = Counter()
    for task in tasks_left(plan):
        left[task.kind] += task.count
    return left


def test_what_is_counted_is_what_is_made(demo_capture, protocol, finished, tmp_path):
    """Before a run the plan counts exactly the frames, depth maps, masks and renders that the run
    then leaves.
    """
    plan, run = planned(tmp_path / "run", demo_capture, protocol), RunFolder(finished)
    left = counts(plan)

    assert left["truth"] == n_files(run.root / "truth", "*.png")
    # those that were found for the checks are gone
    assert left["checked depth"] == n_files(run.depth, "*.npz")
    assert left["mask"] == n_files(run.root / "disoccluded", "*.png")
    assert left["path depth"] == n_files(run.path_depth, "*.npy")
    assert left["render"] == n_files(run.root / "renders", "*.png")
    assert left["path render"] == n_files(run.root / "path", "*.png")
    assert {task.folder.name for task in tasks_left(plan) if task.kind == "score"} == {
        "cam00",
        "cam01",
    }


def test_depth_for_checks_alone_goes_and_is_found_again_where_a_check_is_lost(
    demo_capture, protocol, tmp_path, monkeypatch
):
    """A finished store has checked maps only; a lost one costs its own sources at its own instant,
    with the same bytes.
    """
    plan = planned(
        tmp_path / "run", demo_capture, dataclasses.replace(protocol, path=CameraPath(0))
    )
    prepare_run(plan)
    store, (job, *_) = (
        DepthStore(plan.run.depth),
        [job for job in plan.view_jobs if job.checked_with],
    )
    whole = {file: file.read_bytes() for file in plan.run.depth.rglob("*.npz")}
    assert whole.keys() == {
        store.path(each.key, frame) for each in plan.view_jobs for frame in plan.frames
    }
    prepare_run(plan)
    assert {file: file.read_bytes() for file in plan.run.depth.rglob("*.npz")} == whole

    store.path(job.key, 1).unlink()
    assert (counts(plan)["depth"], counts(plan)["checked depth"]) == (1 + len(job.checked_with), 1)
    written, write = [], DepthStore.write
    monkeypatch.setattr(DepthStore, "write", lambda *call: written.append(call[2]) or write(*call))
    prepare_run(plan)
    assert written == [1] * (2 + len(job.checked_with))
    assert {file: file.read_bytes() for file in plan.run.depth.rglob("*.npz")} == whole


@pytest.mark.slow
def test_a_shared_store_keeps_depth_for_checks_until_all_runs_are_done(
    demo_capture, protocol, tmp_path
):
    """The next variant of a sweep finds what the first one has found; after the sweep nothing of it
    is left.
    """
    sweep = Sweep("s", "", (SweepRow("A", "no-blending"),), k=(2, 3))
    short = dataclasses.replace(protocol, frames=Frames(0, 1), path=CameraPath(0))
    planned_cells = plan_cells(tmp_path, {"": (demo_capture, short)}, sweep)
    first, second = planned_cells.plans
    alone = counts(second)["depth"]
    prepare_run(first)
    assert counts(second)["depth"] < alone
    run_sweep(planned_cells, 1)
    kept = {job.key for plan in planned_cells.plans for job in plan.view_jobs}
    store = DepthStore(tmp_path / "depth")
    assert set((tmp_path / "depth").rglob("*.npz")) == {store.path(key, 0) for key in kept}
    assert not {"depth", "checked depth"} & {*counts(first), *counts(second)}


def test_a_key_is_made_once(demo_capture, protocol, tmp_path, monkeypatch):
    """Planning describes each depth job once; counting and preparing take the key from the plan."""
    described = []
    describe = fill_store.describe_depth
    monkeypatch.setattr(
        fill_store,
        "describe_depth",
        lambda camera, partners, *rest: (
            described.append((camera.name, *(each.name for each in partners)))
            or describe(camera, partners, *rest)
        ),
    )
    short = dataclasses.replace(protocol, frames=Frames(0, 1), path=CameraPath(0))

    plan = planned(tmp_path / "run", demo_capture, short)
    by_planning = list(described)
    tasks_left(plan)
    prepare_run(plan)

    assert len(by_planning) == len(set(by_planning)) > 0
    assert described == by_planning
    assert {job.key for job in plan.view_jobs} <= {
        job.key for each in plan.plans.values() for job in each.jobs
    }
    assert not {"depth", "checked depth"} & counts(plan).keys()


def test_nothing_is_said_where_everything_is_done(demo_capture, protocol, finished):
    """A finished run has no plan; one more method has that method's frames alone, and nobody knows
    how long they take.
    """
    assert count_work([planned(finished, demo_capture, protocol)], finished).describe() == ""

    more = count_work(
        [planned(finished, demo_capture, protocol, (*LABELS, "ours-geometric"))], finished
    )

    assert more.count("render", "path render") == 2 * 3 + 3
    assert more.count("depth", "checked depth") == 0
    assert "9 frames to render, 0 depth maps" in more.describe()
    assert "time:" not in more.describe()


@pytest.mark.slow
def test_a_source_frame_that_was_changed_is_work(
    demo_capture, protocol, finished, tmp_path, capsys
):
    """`run --dry-run` names it, `run` writes it again as captured, and nothing is left then; its
    renders stay.
    """
    shutil.copytree(finished, tmp_path / "run")
    file = frame_path(tmp_path / "run" / "truth" / "cam02", 1)  # no test view
    pixels, renders = read_image(file), digest_folder(tmp_path / "run" / "renders")
    write_image(file, 255 - pixels)
    (tmp_path / "p.toml").write_text(protocol.to_toml())
    arguments = [
        "run",
        str(tmp_path / "run"),
        "--capture",
        str(demo_capture.path),
        "--protocol",
        str(tmp_path / "p.toml"),
    ]
    arguments += ["--jobs", "1", "--methods", *LABELS]

    run_command([*arguments, "--dry-run"])
    assert "1 captured frame to decode" in capsys.readouterr().out
    run_command(arguments)

    np.testing.assert_array_equal(read_image(file), pixels)
    assert digest_folder(tmp_path / "run" / "renders") == renders
    assert (
        count_work([planned(tmp_path / "run", demo_capture, protocol)], tmp_path / "run").describe()
        == ""
    )


def test_tasks_are_made_once(demo_capture, protocol, tmp_path, monkeypatch):
    """From the plan to the last frame each method is found once, and a file of weights read once,
    whoever renders with it.
    """
    labels, found = ("no-blending", "ours", "ours+no-temporal"), []
    find = registry._as_shipped
    monkeypatch.setattr(registry, "_as_shipped", lambda label: found.append(label) or find(label))
    spec._digest_of.cache_clear()

    plan = planned(
        tmp_path / "run", demo_capture, dataclasses.replace(protocol, frames=Frames(0, 1)), labels
    )
    renders = plan.renders
    count_work([plan], tmp_path)
    assert render(prepare_run(plan)) == len(renders) == len(labels) * 3
    count_work([plan], tmp_path)

    assert found == list(labels)
    assert plan.renders is renders
    # of the weights that both networks of ours share
    assert spec._digest_of.cache_info().misses == 1


def test_a_plan_names_the_tasks_that_are_then_done(demo_capture, protocol, finished):
    """What is listed before anything is prepared is what the list of the finished run has, by name,
    folder and hash.
    """
    before = planned(finished.with_name("absent"), demo_capture, protocol).renders
    done = TaskList(finished, "render").read()

    assert [(task.name, task.sha256) for task in before] == [
        (made.name, made.sha256) for made in done
    ]
    assert all(made.is_done() for made in done)
    assert {(task.label, task.unit) for task in before} == {
        (label, unit) for label in LABELS for unit in ("cam00", "cam01", "path")
    }


@pytest.mark.slow
def test_a_dry_run_says_what_the_run_then_does(
    demo_capture, protocol, tmp_path, capsys, monkeypatch
):
    """The counts of the plan are the frames that the run renders, the maps that it makes and the
    views that it scores.
    """
    maps, write = [], DepthStore.write
    monkeypatch.setattr(DepthStore, "write", lambda *call: maps.append(call[1:3]) or write(*call))
    (tmp_path / "p.toml").write_text(protocol.to_toml())
    words = [
        "run",
        str(tmp_path / "run"),
        "--capture",
        str(demo_capture.path),
        "--protocol",
        str(tmp_path / "p.toml"),
    ]
    words += ["--jobs", "1", "--methods", *LABELS]
    run_command([*words, "--dry-run"])
    told = capsys.readouterr().out
    run_command(words)

    frames = n_files(tmp_path / "run" / "renders", "????.png") + len(
        list((tmp_path / "run" / "path").glob("*-*/*.png"))
    )
    assert f"left are {frames} frames to render, {len(maps)} depth maps" in told
    assert f"{len(list((tmp_path / 'run' / 'scores').iterdir()))} views to score" in told
    run_command([*words, "--dry-run"])
    assert "no work left" in capsys.readouterr().out.splitlines()[-1]


def test_time_is_that_of_frames_that_are_rendered(demo_capture, protocol, finished, tmp_path):
    """A view more of methods that have rendered others takes as long as those; frames of which
    nothing is known are counted.
    """
    write_json(
        tmp_path / "other" / JOB_FILE, {"seconds": {"render": [2.0, 2.0], "blend": [0.5, 0.5]}}
    )
    done = (Made("other", tmp_path / "other", sha256="", kind="render", pace="a", count=2),)
    left = (
        Result("a", tmp_path / "a", kind="render", pace="a", count=300, cost_s=9.0),
        Result("b", tmp_path / "b", kind="render", pace="b", count=3),
    )
    text = Workload("", left, done, tmp_path, jobs=2).describe()

    assert text.splitlines()[2].startswith(
        "time: about 6 min on 2 cores, and 3 pieces of unknown time; mostly rendering"
    )
    assert "  rendering: 303, 1.2 s each, 6 min" in text
    root = Path(shutil.copytree(finished, tmp_path / "run"))
    shutil.rmtree(RunFolder(root).renders(LABELS[0], protocol.views.test[0]))
    work = count_work([planned(root, demo_capture, protocol)], root)
    of_method = [task for task in work.left if task.pace == LABELS[0]]
    assert estimate(of_method, work.history, lambda: float("nan")).seconds > 0
    assert [duration(seconds) for seconds in (7.2, 119, 121, 7199, 9000)] == [
        "7 s",
        "119 s",
        "2 min",
        "120 min",
        "2.5 h",
    ]


def test_a_long_run_has_a_line_for_every_stage(demo_capture, protocol, tmp_path):
    """Seconds are those of this machine: core-seconds of each task times the pace, shared by the
    processes.
    """
    plan = planned(tmp_path / "run", demo_capture, protocol)
    left = tasks_left(plan)
    known = sum(task.cost_s * task.count for task in left)
    slow = Workload("", tuple(left), (), tmp_path, jobs=2, pace=lambda: 7200 / known)
    # a minute of a core at pace 1 is never worth a table
    assert slow.describe().splitlines()[2:] == []

    large = tuple(dataclasses.replace(task, cost_s=task.cost_s * 7200 / known) for task in left)
    lines = Workload("", large, (), tmp_path, jobs=2, pace=lambda: 3.0).describe().splitlines()
    assert lines[2].startswith("time: about 3.0 h on 2 cores; mostly ")
    assert [line.split(":")[0].strip() for line in lines[3:]] == [
        "decoding",
        "depth",
        "rendering",
        "scoring",
    ]


@pytest.mark.parametrize(
    "label",
    [
        "no-blending",
        "distance-based",
        "interpolation",
        *LEARNED_BASELINES,
        "ours",
        "ours-geometric+no-temporal",
    ],
)
def test_every_method_of_ours_has_a_cost(label):
    """What ships and is not fitted is in the estimate."""
    assert render_cost(label) > 0


def test_a_dry_run_leaves_nothing(demo_capture, protocol, tmp_path, capsys):
    """`--dry-run` prints the plan and leaves no trace."""
    (tmp_path / "p.toml").write_text(
        dataclasses.replace(protocol, frames=Frames(0, 2), path=CameraPath(0)).to_toml()
    )
    arguments = [
        "--capture",
        str(demo_capture.path),
        "--protocol",
        str(tmp_path / "p.toml"),
        "--jobs",
        "1",
        "--dry-run",
    ]

    run_command(["prepare", str(tmp_path / "run"), *arguments])

    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith(
        "plan: 2 views x 2 frames at 64 x 48, K = 2; left are 0 frames to render, "
    )
    assert [line.split(":")[0] for line in lines] == ["plan", "disk"]
    assert [item.name for item in tmp_path.iterdir()] == ["p.toml"]


def test_a_run_that_cannot_fit_is_refused(demo_capture, protocol, tmp_path, monkeypatch):
    """Where the disk has less room than the run needs, one line says both and what to do; nothing
    is begun.
    """
    monkeypatch.setattr(outlook.shutil, "disk_usage", lambda _: Usage(10**9, 10**9, 1000))
    (tmp_path / "p.toml").write_text(protocol.to_toml())

    message = refusal(
        "run", tmp_path / "run", "--capture", demo_capture.path, "--protocol", tmp_path / "p.toml"
    )

    assert "the disk has 0.0 MB free" in message
    assert "choose a folder on another disk" in message
    assert not (tmp_path / "run").exists()


def test_disk_is_what_the_run_leaves(finished, demo_capture, protocol, tmp_path):
    """The estimate of depth alone is right within 15 %, headers included; all of it within a factor
    of two.
    """
    work = count_work([planned(tmp_path / "run", demo_capture, protocol)], tmp_path)
    depth = sum(file.stat().st_size for file in (finished / "depth").rglob("*.npz"))
    everything = sum(file.stat().st_size for file in finished.rglob("*") if file.is_file())

    assert work.count("checked depth") * 64 * 48 * N_BYTES["checked depth"] == pytest.approx(
        depth, rel=0.15
    )
    assert everything / 2 < work.disk_bytes < everything * 2


def test_the_plan_states_which_frames_lpips_measures(demo_capture, protocol, tmp_path):
    """One frame in four of LPIPS is in the plan's first line, and scoring is estimated to take
    less.
    """
    works = []
    for every in (1, 4):
        measurement = dataclasses.replace(
            protocol.measurement, metrics=("PSNR", "LPIPS"), lpips_every=every
        )
        plan = planned(
            tmp_path, demo_capture, dataclasses.replace(protocol, measurement=measurement)
        )
        works.append(count_work([plan], tmp_path))
    assert [", LPIPS of one frame in 4; left are" in each.describe() for each in works] == [
        False,
        True,
    ]
    whole, few = (
        sum(task.cost_s * task.count for task in work.left if task.kind == "score")
        for work in works
    )
    assert few < 0.5 * whole


def test_passing_depth_makes_room_for_renders(tmp_path):
    """At once on disk are the depth for checks or the renders, whichever is larger, and all the
    rest.
    """
    depth = [
        Result(name, tmp_path / name, kind="depth", n_bytes=10.0) for name in ("kept", "passing")
    ]
    renders = [
        Result(name, tmp_path / name, kind="render", n_bytes=4.0) for name in ("a", "b", "c")
    ]
    passing = frozenset({tmp_path / "passing"})
    assert Workload("", (*depth, *renders[:1]), (), tmp_path, passing).disk_bytes == 20
    assert Workload("", (*depth, *renders), (), tmp_path, passing).disk_bytes == 22


def test_a_sweep_is_planned_as_one(demo_capture, protocol, tmp_path):
    """Variants that share frames count them once; a shard has its own views alone, and one that
    prepares renders nothing.
    """
    sweep = Sweep("s", "", (SweepRow("A", "no-blending"),), k=(2, 3))
    captures = {"": (demo_capture, protocol)}
    plans = [
        plan_cells(tmp_path, captures, sweep, shard=shard).plans
        for shard in (WHOLE, Shard(1, 2), Shard(0, 2))
    ]
    whole, half, first = (count_work(each, tmp_path) for each in plans)

    assert whole.title.startswith("2 runs of ")
    assert whole.count("render", "path render") == 2 * (2 * 3 + 3)
    assert half.count("render", "path render") == pytest.approx(9, abs=3)
    assert first.count("render", "path render") == 0
    assert (
        count_work(plans[0][:1], tmp_path).disk_bytes
        < whole.disk_bytes
        < 2 * count_work(plans[0][:1], tmp_path).disk_bytes
    )
    assert list(tmp_path.iterdir()) == []


def test_a_folder_of_another_run_is_refused(finished, demo_capture, protocol):
    """Another protocol, or two cameras whose frames were exchanged: refused when it is planned,
    hence by a dry run, too.
    """
    with refused(ProtocolError, "another protocol", "synthesis.k: "):
        planned(finished, demo_capture, dataclasses.replace(protocol, synthesis=Synthesis(3)))
    first, second = demo_capture.cameras[:2]
    sources = (
        demo_capture.source(second.name),
        demo_capture.source(first.name),
        *demo_capture.sources[2:],
    )
    with refused(ProtocolError, "frames", f"{first.name}, {second.name} "):
        planned(finished, dataclasses.replace(demo_capture, sources=sources), protocol)


def test_partners_are_chosen_once_for_a_source_and_the_camera_it_must_not_see(
    demo_capture, protocol, monkeypatch
):
    """A camera path of many poses asks for no more pairs than the rig has."""
    asked = []
    choose = DepthOptions.choose_partners

    def counted(options, camera, candidates, excluded):
        asked.append((camera.name, *excluded))
        return choose(options, camera, candidates, excluded)

    monkeypatch.setattr(DepthOptions, "choose_partners", counted)
    plan = planned(
        Path("nowhere"), demo_capture, dataclasses.replace(protocol, path=CameraPath(poses=40))
    )
    assert len(plan.path) == 40
    assert len(asked) == len(set(asked))
    assert len(asked) <= len(demo_capture.cameras) * (1 + len(protocol.views.test))
