"""Fitted methods in a run: one fit per fold that has seen nothing of what it renders, resumed where
it was killed.
"""

import pickle
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import CameraError, RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.jobs.shard import Shard
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.run.evaluate import measure, render
from ggvs_eval.pipelines.run.fits import FitClock
from ggvs_eval.pipelines.run.footage import fold_footage
from ggvs_eval.pipelines.run.outlook import count_work
from ggvs_eval.pipelines.run.prepare import prepare_run
from ggvs_eval.pipelines.run.run_plan import RunPlan, RunRequest, plan_run
from ggvs_eval.pipelines.run.status import describe_status
from ggvs_eval.pipelines.sweep.run_sweep import plan_cells, run_sweep
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol, Synthesis, Views
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from ggvs_eval.sweep import Sweep, SweepRow
from ggvs_eval.tasks.run_tasks import run_tasks
from helpers import nearest_camera
from helpers.nearest_camera import LABEL
from helpers.refusals import refused
from helpers.stereo_scenes import write_capture

pytestmark = pytest.mark.slow

TWIN, HELD_OUT = "cam05", "cam00"  # the twin sees what cam01 sees, pixel for pixel
PROTOCOL = Protocol(
    "folded",
    "plane",
    Views((HELD_OUT, TWIN, "cam03"), "by hand", folds=((HELD_OUT, TWIN), ("cam03",))),
    Frames(0, 2),
    Synthesis(k=2, width=100, height=75),
    Measurement(metrics=("PSNR",), ceilings=False),
    CameraPath(poses=2),
)


@pytest.fixture(scope="module", autouse=True)
def _registered():
    """The nearest camera is a method here."""
    with pytest.MonkeyPatch.context() as patch:
        nearest_camera.register(patch)
        yield


@pytest.fixture(scope="module")
def twin_plane(tmp_path_factory) -> Capture:
    """Five cameras before a plane, and a duplicate of one of them."""
    rig = write_capture(tmp_path_factory.mktemp("rig"), n_frames=2)
    twin = replace(rig.camera("cam01"), name=TWIN)
    return replace(rig, cameras=(*rig.cameras, twin), sources=(*rig.sources, rig.source("cam01")))


@pytest.fixture(scope="module")
def finished(twin_plane, tmp_path_factory) -> RunPlan:
    """A whole run of a method that steps and of one that is fitted, by two seeds."""
    plan = plan_run(
        RunRequest(
            tmp_path_factory.mktemp("run"),
            twin_plane,
            PROTOCOL,
            ("no-blending", LABEL, f"{LABEL}+seed=1"),
        )
    )
    measure(plan, 1)
    return plan


def lend(finished: RunPlan, root: Path) -> Path:
    """A folder that has the frames and the depth of a finished run."""
    for name in ("truth", "depth"):
        shutil.copytree(finished.run.root / name, root / name)
    return root


def footage_of(plan: RunPlan, view: str):
    """What the fit is shown that renders a test view."""
    fit = next(fit for fit in plan.fits if fit.label == LABEL and view in fit.fold.units)
    return fold_footage(plan.capture, fit.fold, fit.indices, DepthStore(plan.run.depth), seed=0)


def test_a_run_fits_once_per_fold_and_once_for_the_path(finished):
    """Each fold's job says what it saw and what it took; held-out views are rendered from it; every
    method has every value.
    """
    fits = {
        folder.name: read_json(folder / "job.json")
        for folder in (finished.run.root / "fits" / LABEL).iterdir()
    }
    assert {name: sorted(record["identity"]["cameras"]) for name, record in fits.items()} == {
        "fold1": ["cam01", "cam02", "cam03", "cam04"],
        "fold2": ["cam00", "cam01", "cam02", "cam04", "cam05"],
        "all": ["cam00", "cam01", "cam02", "cam03", "cam04", "cam05"],
    }
    # it looks at each instant alone, and the path stands at one
    assert fits["all"]["instants"] == 1
    assert fits["fold1"]["instants"] == 2
    assert fits["fold1"]["size_bytes"] > 0
    assert fits["fold1"]["seconds"] > 0
    assert fits["fold1"]["machine"]
    rendered = read_json(finished.run.renders(LABEL, "cam03") / "job.json")
    assert rendered["fit"]["cameras"] == 5
    assert rendered["seconds"] == {"look up": [0.002, 0.002]}
    assert not Results.read(finished.run.root).per_view("PSNR").isna().any(axis=None)
    assert len(list(finished.run.path(LABEL).glob("*.png"))) == 2
    names = read_json(finished.run.root / "methods.json")["names"]
    assert names == {
        "no-blending": "No Blending",
        LABEL: "Nearest Camera",
        f"{LABEL}+seed=1": "Nearest Camera, seed 1",
    }
    # The leak detector: held out together, the twin of a training camera is as good as its noise,
    # the other is not near.
    psnr_db = Results.read(finished.run.root).per_view("PSNR").loc[(LABEL, "")]
    assert psnr_db[TWIN] > 45
    assert psnr_db[HELD_OUT] < psnr_db[TWIN] - 15


def test_the_detector_tells_a_leak(finished, tmp_path):
    """A fit that is given the target's frames, by a plan that no protocol can ask for, is as good
    there as in the twin.
    """
    leaking = tuple(
        replace(fit, fold=replace(fit.fold, jobs=finished.fits[2].fold.jobs))
        if fit.fold.name == "fold1"
        else fit
        for fit in finished.fits[:3]
    )
    shutil.copytree(finished.run.root, tmp_path / "run")
    plan = replace(
        finished,
        run=RunFolder(tmp_path / "run"),
        request=replace(finished.request, root=tmp_path / "run"),
    )
    prepared = replace(prepare_run(plan), fits=leaking, methods={LABEL: plan.methods[LABEL]})
    assert {
        fit.fold.name for fit in leaking if TWIN in fit.fold.cameras and TWIN in fit.fold.held_out
    } == {"fold1"}
    measure_again = render(prepared)
    assert measure_again > 0
    truth, leaked = (
        read_image(folder / "0000.png")
        for folder in (plan.run.truth(HELD_OUT), plan.run.renders(LABEL, HELD_OUT))
    )
    assert np.abs(truth.astype(float) - leaked).mean() < 2


def test_footage_holds_nothing_of_a_held_out_camera(finished):
    """Neither its name nor its frames can be asked for, they do not travel with the job, and no
    depth was matched with it.
    """
    footage = footage_of(finished, HELD_OUT)
    assert footage.views == ("cam01", "cam02", "cam03", "cam04")
    for view in (HELD_OUT, TWIN):
        with refused(RenderError, f"'{view}'", "cam01, cam02"):
            footage.image(view, 0)
        with pytest.raises(RenderError, match="not a training camera"):
            footage.depth(view, 0)
        assert view.encode() not in pickle.dumps(footage)
        assert b"cam01" in pickle.dumps(footage)
    for key in footage.depth_keys.values():
        spec = read_json(footage.depths.folder(key) / JOB_FILE)["identity"]
        matched = {spec["camera"]["name"], *(partner["name"] for partner in spec["partners"])}
        assert matched
        assert matched <= set(footage.views)
    with refused(RenderError, "0..1", "got 2"):
        footage.image("cam01", 2)


def test_a_fit_does_not_depend_on_the_frames_that_it_shall_render(finished, twin_plane, tmp_path):
    """Other frames in the held-out cameras: the same jobs, so the same scenes; other frames in a
    training camera: another job.
    """
    for frame in range(2):
        write_image(
            tmp_path / "black" / f"{frame:04d}.png", np.zeros_like(twin_plane.frame(HELD_OUT, 0))
        )
    black = ImageFrames(tmp_path / "black")
    sources = tuple(
        black if name == HELD_OUT else source
        for name, source in zip(twin_plane.camera_names, twin_plane.sources, strict=True)
    )
    other = plan_run(
        RunRequest(tmp_path / "run", replace(twin_plane, sources=sources), PROTOCOL, (LABEL,))
    )
    before, after = (
        {fit.folder.name: fit.sha256 for fit in plan.fit_tasks if fit.label == LABEL}
        for plan in (finished, other)
    )
    assert before["fold1"] == after["fold1"]
    assert before["fold2"] != after["fold2"]
    assert before["all"] != after["all"]


def test_a_fit_that_was_killed_goes_on(finished, twin_plane, tmp_path):
    """An attempt that dies leaves what it has done; the next go on from it, and the scene is the
    one of a fit in one go.
    """
    protocol = replace(PROTOCOL, path=CameraPath(0))
    label = f"{LABEL}+dies_after=1"
    plan = prepare_run(
        plan_run(RunRequest(lend(finished, tmp_path), twin_plane, protocol, (label,)))
    )
    (task,) = (fit for fit in plan.fit_tasks if "cam03" in fit.units)
    for attempt in range(4):
        with pytest.raises(KeyboardInterrupt):
            run_tasks([task], 1, "fitting")
        assert not task.is_done()
        (left,) = (tmp_path / "fits" / label).glob(".fold2.*.unfinished")
        assert len(list(left.glob("*/last"))) == attempt + 1
    assert run_tasks([task], 1, "fitting") == 1
    assert task.is_done()
    assert not list((tmp_path / "fits" / label).glob(".*"))
    whole = tmp_path / "whole"
    whole.mkdir()
    (fit,) = (fit for fit in plan.fits if "cam03" in fit.fold.units)
    find_method(LABEL).make_fitter().fit(
        fold_footage(plan.capture, fit.fold, fit.indices, DepthStore(plan.run.depth), 0),
        whole,
        lambda *_: None,
    )
    for file in sorted(whole.rglob("*.png")):
        assert file.read_bytes() == (task.folder / file.relative_to(whole)).read_bytes()


def test_time_and_progress_count_from_the_beginning(tmp_path, monkeypatch, capsys):
    """Seconds of earlier attempts are added; the time left follows from this attempt's pace."""
    now_s = [100.0]
    monkeypatch.setattr("ggvs_eval.pipelines.run.fits.time.monotonic", lambda: now_s[0])
    first = FitClock("4dgs, fold1", tmp_path, now_s[0])
    first.note(0, 1000)
    now_s[0] += 60
    first.note(100, 1000)
    assert capsys.readouterr().err == "4dgs, fold1: 100 of 1000 steps in 60 s, about 9 min left\n"
    now_s[0] += 1000  # it was killed, and nobody counts that
    second = FitClock("4dgs, fold1", tmp_path, now_s[0])
    second.note(100, 1000)
    now_s[0] += 61
    second.note(200, 1000)
    assert second.seconds == pytest.approx(121)
    assert "200 of 1000 steps in 2 min, about 8 min left" in capsys.readouterr().err


def test_a_scene_may_go_when_its_frames_are_there(finished, tmp_path):
    """Without its fits a run is still done; a frame that is missing wants its own fold fitted
    again, and no other.
    """
    shutil.copytree(finished.run.root, tmp_path / "run")
    shutil.rmtree(tmp_path / "run" / "fits")
    request = replace(finished.request, root=tmp_path / "run")
    assert not count_work([plan_run(request)], tmp_path).left
    assert render(prepare_run(plan_run(request))) == 0
    shutil.rmtree(tmp_path / "run" / "renders" / LABEL / "cam03")
    assert render(prepare_run(plan_run(request))) == 1
    assert [
        folder.relative_to(tmp_path / "run" / "fits").as_posix()
        for folder in (tmp_path / "run" / "fits").glob("*/*")
    ] == [f"{LABEL}/fold2"]


def test_the_plan_counts_fits(twin_plane, tmp_path):
    """Before anything is done: three scenes; for one view, its own fold alone. Nothing is
    written.
    """
    request = RunRequest(tmp_path / "run", twin_plane, PROTOCOL, (LABEL,))
    assert "3 scenes to fit" in count_work([plan_run(request)], tmp_path / "run").describe()
    assert (
        "1 scene to fit"
        in count_work([plan_run(replace(request, views=["cam03"]))], tmp_path / "run").describe()
    )
    assert not (tmp_path / "run").exists()


def test_folds_by_rule_are_stated_in_the_run_that_needs_them(finished, twin_plane, tmp_path):
    """A run of methods that step states none; with a fitted one it does, in the same folder, and
    keeps them from then on.
    """
    protocol = PROTOCOL.with_folds(())
    before = plan_run(RunRequest(lend(finished, tmp_path), twin_plane, protocol, ("no-blending",)))
    prepare_run(before)
    assert RunFolder(tmp_path).protocol() == protocol
    after = plan_run(RunRequest(tmp_path, twin_plane, protocol, ("no-blending", LABEL)))
    assert after.protocol.views.folds == ((HELD_OUT,), (TWIN,), ("cam03",))
    prepare_run(replace(after, fits=()))
    assert RunFolder(tmp_path).protocol() == after.protocol
    prepare_run(plan_run(RunRequest(tmp_path, twin_plane, protocol, ("no-blending",))))
    assert RunFolder(tmp_path).protocol() == after.protocol


def test_nobody_sees_more_than_the_sources(twin_plane, tmp_path):
    """Neither as a source view, nor in depth, nor in footage; a protocol that leaves too few is
    refused.
    """
    views = replace(PROTOCOL.views, sources=("cam01", "cam02", "cam03"), folds=())
    plan = plan_run(RunRequest(tmp_path, twin_plane, replace(PROTOCOL, views=views), (LABEL,)))
    assert plan.protocol.views.folds == ((HELD_OUT, TWIN, "cam03"),)
    shown = {
        name
        for each in (*plan.plans.values(), *plan.path)
        for job in each.jobs
        for name in (job.camera_name, *job.partner_names)
    }
    assert shown <= {"cam01", "cam02", "cam03"}
    assert [fit.fold.cameras for fit in plan.fits] == [
        ("cam01", "cam02"),
        ("cam01", "cam02", "cam03"),
    ]
    one_fold = (HELD_OUT, "cam02", "cam03")
    few = replace(PROTOCOL, views=replace(views, test=one_fold, folds=(one_fold,)))
    with refused(CameraError, "fold1", "cam00, cam02, cam03", "1 training", "2 or more"):
        plan_run(RunRequest(tmp_path, twin_plane, few, (LABEL,)))


def test_what_is_fitted_cannot_be_shown_frame_by_frame():
    """It makes no step; options and seeds are checked when the label is read; all in one line."""
    with refused(RenderError, "Nearest Camera", "fitted"):
        find_method(LABEL).make()
    with refused(RenderError, "nois", "did you mean noise?"):
        find_method(f"{LABEL}+nois=2")
    with refused(RenderError, "seed", "1.5"):
        find_method(f"{LABEL}+seed=1.5")
    assert find_method(f"{LABEL}+noise=2.5+seed=3").settings == {"noise": 2.5}
    assert (
        find_method("4dgs+motion=linear+steps=3000").title
        == "4DGS (compact), linear motion, 3,000 steps"
    )


@pytest.mark.slow
def test_variants_of_a_sweep_share_their_fits(finished, twin_plane, tmp_path):
    """K moves no fit: two runs of a sweep, one scene per fold beside them; each has its row, and a
    shard fits what it renders.
    """
    rows = (SweepRow("Nearest", LABEL), SweepRow("No Blending", "no-blending"))
    sweep, protocol = Sweep("k", "two", rows, k=(1, 2)), replace(PROTOCOL, path=CameraPath(0))
    root = lend(finished, tmp_path)
    # k1 in the first view
    run_sweep(plan_cells(root, {"": (twin_plane, protocol)}, sweep, shard=Shard.parse("1/8")), 1)
    assert [folder.name for folder in (root / "fits" / LABEL).iterdir()] == ["fold1"]
    result = run_sweep(plan_cells(root, {"": (twin_plane, protocol)}, sweep), 1)
    assert not result.failures
    assert sorted(folder.name for folder in (root / "fits" / LABEL).iterdir()) == ["fold1", "fold2"]
    psnr_db = result.table["PSNR"]
    assert psnr_db["k1", "Nearest"] == psnr_db["k2", "Nearest"]
    assert "fit: 2 done, 0 running, 0 failed, 0 missing" in describe_status(root)
