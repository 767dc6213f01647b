"""The demo in three layouts: rigs like those of the data sets, each with its protocol, evaluated
together on one page.
"""

import dataclasses
import json
import re
import shutil
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.demo import DEMO_ROOMS, MAIN, write_demo
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import (
    AIM_M,
    ARC_YAW_RAD,
    UNITS_PER_METRE,
    arc_rig,
    eye_in_room,
)
from ggvs_eval.contrib.worlds.film.shots import rig_shots
from ggvs_eval.contrib.worlds.room.room import build_room
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import CaptureError
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.methods.registry import usual_methods
from ggvs_eval.pipelines.run.render import note_labels
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.pipelines.sweep import demo_runs
from ggvs_eval.pipelines.sweep.demo_runs import (
    capture_beside,
    demo_plans,
    demo_root,
    evaluate_demos,
)
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis, Views, load_protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, read_json
from helpers.captures import make_rig
from helpers.packed_films import unpack_film
from helpers.refusals import refused

pytestmark = pytest.mark.usefixtures("no_figures")

SMALL_ROOMS = [name for name in DEMO_ROOMS if name != MAIN]
TINY = DemoOptions(
    width=64,
    height=48,
    n_frames=2,
    cameras_per_row=3,
    path_poses=0,
    supersampling=1,
    depth_stride=0,
)


def camera_names(options: DemoOptions) -> list[str]:
    return [
        name.removeprefix("cam") if options.layout == "enerf-outdoor" else name
        for name in options.camera_names
    ]


def test_the_main_demo_is_as_it_always_was(tmp_path):
    """24 cameras of DyNeRF's layout, 24 frames, seed 0; demo.json of such a rig does not speak of
    other rigs.
    """
    assert DEMO_ROOMS[MAIN] == DemoOptions(depth_stride=0)
    notes = unpack_film("small", tmp_path / "rows") / DEMO_NOTES

    assert "rig" not in json.loads(notes.read_text())["options"]


def test_the_other_rooms_are_rigs_like_the_data_sets():
    """18 cameras on an arc as ENeRF-Outdoor's, 10 in two rows as D3DMV's, in rooms of their own,
    long enough for every metric.
    """
    outdoor, mask_volume = (DEMO_ROOMS[name] for name in ("demo-enerf-outdoor", "demo-d3dmv"))

    assert (len(outdoor.camera_names), outdoor.rig, outdoor.layout) == (18, "arc", "enerf-outdoor")
    assert (len(mask_volume.camera_names), mask_volume.rig, mask_volume.layout) == (
        10,
        "grid",
        "d3dmv",
    )
    assert len({options.seed for options in DEMO_ROOMS.values()}) == len(DEMO_ROOMS)
    assert min(outdoor.n_frames, mask_volume.n_frames) >= 6


@pytest.mark.parametrize("name", DEMO_ROOMS)
def test_every_room_has_its_protocol(name):
    """The protocol that is suggested for a demo room is the one of its name, as its data set's but
    for parts that cost.
    """
    options, protocol = DEMO_ROOMS[name], load_protocol(name)
    cameras = tuple(make_rig(camera_names(options), options.width, options.height))
    capture = Capture(
        "room", options.layout, Path("room"), cameras, (), options.n_frames, 30.0, 1.0, DEMO_NOTES
    )

    assert suggest_protocol(capture) == protocol
    assert protocol.frames.count == options.n_frames
    paper = load_protocol(options.layout)
    assert protocol.synthesis.k == paper.synthesis.k
    dear = {
        f"{name}_{part}" for name in ("SSIM", "LPIPS", "L1", "TCC") for part in ("static", "moving")
    }
    assert protocol.measurement.metrics == tuple(
        name for name in paper.measurement.metrics if name not in dear
    )
    if paper.measurement.width:
        assert (
            protocol.measurement.width / options.width
            == paper.measurement.width / paper.synthesis.width
        )


def test_a_real_capture_never_gets_a_demos_protocol():
    """A capture of D3DMV with as many cameras and frames as the demo's is evaluated by rule, not as
    a demo.
    """
    cameras = tuple(make_rig(camera_names(DEMO_ROOMS["demo-d3dmv"]), 64, 48))
    capture = Capture("scene", "d3dmv", Path("scene"), cameras, (), 8, 30.0, 1.0, "guess")

    assert suggest_protocol(capture).name == "scene by rule"


def test_the_arc_stands_around_what_it_films():
    """Cameras are named from left to right along an arc of the stated width, and look at what is in
    its middle.
    """
    cameras = arc_rig(1, 384, 216, 18)
    eyes = np.array([eye_in_room(camera) for camera in cameras])
    centre = np.array([0.0, AIM_M[1]])
    yaw = np.arctan2(eyes[:, 0], centre[1] - eyes[:, 1])

    assert [camera.name for camera in cameras] == [f"cam{number:02d}" for number in range(18)]
    assert (np.diff(yaw) > 0).all()
    np.testing.assert_allclose(yaw[[0, -1]], [-ARC_YAW_RAD, ARC_YAW_RAD], atol=0.02)
    np.testing.assert_allclose(np.linalg.norm(eyes[:, :2] - centre, axis=1), AIM_M[1], atol=0.03)
    aim = np.array(
        [0.0, (eyes[:, 2].mean() - AIM_M[2]) * UNITS_PER_METRE, AIM_M[1] * UNITS_PER_METRE]
    )
    for camera in cameras:
        uv, depth = camera.project(aim)
        assert depth > 0
        assert np.abs(uv - np.array(camera.size) / 2).max() < 0.06 * camera.width


def test_the_grid_looks_almost_straight_ahead():
    """Cameras of the grid stand where the rows' do along their rows, but turn by a few degrees
    only.
    """
    options = replace(TINY, seed=2, cameras_per_row=5)
    rows, grid = (
        [shot.camera for shot in rig_shots(replace(options, rig=rig))] for rig in ("rows", "grid")
    )
    turns = [
        [np.degrees(np.arctan2(camera.rotation[2, 0], camera.rotation[2, 2])) for camera in rig]
        for rig in (rows, grid)
    ]

    assert 30 < np.abs(turns[0]).max() < 38
    assert 6 < np.abs(turns[1]).max() < 11
    assert [camera.name for camera in grid] == [camera.name for camera in rows]
    assert (
        np.argsort([c.centre[0] for c in grid[:5]]) == np.argsort([c.centre[0] for c in rows[:5]])
    ).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", SMALL_ROOMS)
def test_cameras_stand_in_the_free(name):
    """No camera of a demo room stands within 15 cm of furniture or of what moves."""
    options, room = DEMO_ROOMS[name], build_room(DEMO_ROOMS[name].seed)
    points = np.concatenate([surface.vertices for surface in [*room.static, *room.at(0.0)]])

    for shot in rig_shots(options):
        assert np.linalg.norm(points - eye_in_room(shot.camera), axis=1).min() > 0.15


def test_an_unknown_rig_is_refused():
    """The message lists the rigs there are."""
    with refused(CaptureError, "rows, arc, grid", "'ring'"):
        DemoOptions(rig="ring")


@pytest.fixture(scope="module")
def small_protocols():
    """The packaged protocols of the rooms, cut to what makes a test quick."""

    def shrunken(name: str) -> Protocol:
        base = load_protocol(name)
        measurement = dataclasses.replace(
            base.measurement, metrics=("PSNR", "L1"), width=0, height=0, ceilings=False
        )
        views, path = Views(("cam00", "cam01"), "test"), CameraPath(0)
        return replace(
            base,
            views=views,
            frames=Frames(0, 2),
            synthesis=Synthesis(2),
            measurement=measurement,
            path=path,
        )

    return shrunken


@pytest.mark.proof
def test_all_rooms_stand_on_one_page(tmp_path, small_protocols, monkeypatch):
    """Each room is evaluated next to the main one, whose first frames have a page before; a second
    call computes nothing.
    """
    monkeypatch.setattr(demo_runs, "load_protocol", small_protocols)
    monkeypatch.setattr(demo_runs, "FIRST_FRAMES", 1)
    monkeypatch.setattr(demo_runs, "PAGE_EVERY_S", 0.0)
    maps, write = [], DepthStore.write
    monkeypatch.setattr(DepthStore, "write", lambda *call: maps.append(call[1:3]) or write(*call))
    rooms = {MAIN: TINY, "demo-d3dmv": replace(TINY, layout="d3dmv", cameras_per_row=2)}

    def film(folder: Path, name: str) -> Capture:
        return open_capture(write_demo(folder, rooms[name], 1))

    root, told, shown, in_store = tmp_path / "out", [], [], []

    def announced(each):
        told.append(each)
        in_store.append(len([*(root / "depth").rglob("*.npz")]))
        return each

    def run() -> Path:
        labels = {MAIN: ["no-blending", "distance-based"], "demo-d3dmv": ["no-blending"]}
        planned = demo_plans(root, labels, film, rooms=tuple(rooms))
        return evaluate_demos(map(announced, planned), 1, keep)

    def keep(page: Path) -> None:
        shown.append(page.read_text())

    page = run()

    # of the main room's six cameras one is synthesised
    over_k = [tmp_path / "out-k" / f"k{k}" for k in (2, 3, 4, 5)]
    assert page == root / "report" / "index.html"
    assert [plan.run.root for plan in (*told[:2], *told[2].plans)] == [
        root,
        tmp_path / "out-d3dmv",
        *over_k,
    ]
    assert len(Results.read(root).summary()) == 2
    assert len(Results.read(demo_root(root, "demo-d3dmv")).summary()) == 1
    assert (capture_beside(demo_root(root, "demo-d3dmv")) / "scene000.h5").is_file()
    text = page.read_text()
    assert all(load_protocol(name).dataset.replace("'", "&#39;") in text for name in rooms)
    assert all(folder.joinpath("depth").resolve() == root / "depth" for folder in over_k)
    assert text.index('id="group1"') < text.index("Quality and time over K <")
    # the runs over K lie beside, in out-k
    assert 'class="group-name">Demo room <span class="on">demo-k' not in text
    datasets = [load_protocol(name).dataset.replace("'", "&#39;") for name in rooms]
    first, *later = shown
    assert f"<h1>{datasets[0]}: first 1 of 2 frames, the others are being evaluated</h1>" in first
    assert "1 frame each" in first
    # one after the other
    assert [[dataset in text for dataset in datasets] for text in later] == [
        [True, False],
        [True, True],
    ]
    assert not any("being evaluated" in text for text in (*later, text))
    assert not (root / "first_frames").exists()
    assert len(maps) == len(set(maps))  # depth of the first frames is the run's own
    kept = {job.key for plan in (told[0], *told[2].plans) for job in plan.view_jobs}
    stored = {file.parent for file in (root / "depth").rglob("*.npz")}
    # what was found for checks alone is gone, ...
    assert stored == {DepthStore(root / "depth").folder(key) for key in kept}
    # ... after the runs over K, which read it
    assert in_store[2] > 2 * len({job.key for job in told[0].view_jobs})
    before = {
        file: file.stat().st_mtime_ns
        for file in tmp_path.rglob("*.png")
        if "report" not in file.parts
    }
    written_ns = page.stat().st_mtime_ns
    run()
    assert len(shown) == 1 + len(rooms)
    assert page.stat().st_mtime_ns == written_ns
    assert {
        file: file.stat().st_mtime_ns
        for file in tmp_path.rglob("*.png")
        if "report" not in file.parts
    } == before
    monkeypatch.setattr(demo_runs, "PAGE_EVERY_S", 1e9)
    for name in rooms:
        shutil.rmtree(demo_root(root, name) / "scores")
    run()
    # both rooms were scored again, and the second page would have come too early
    assert len(shown) == 2 + len(rooms)


@pytest.mark.slow
def test_learned_baselines_come_last(tmp_path, small_protocols, monkeypatch):
    """They are rendered after the runs over K; a dry run plans each room once."""
    monkeypatch.setattr(demo_runs, "load_protocol", small_protocols)
    captures = {}

    def film(folder: Path, name: str) -> Capture:
        if folder not in captures:
            captures[folder] = open_capture(unpack_film("small", folder, with_depth=False))
        return captures[folder]

    labels = {
        MAIN: ["no-blending", "ours", "ibrnet"],
        "demo-d3dmv": ["no-blending", "ibrnet", "ours+no-tsdf"],
    }

    def planned(in_stages: bool) -> list[Sequence[str]]:
        plans = demo_plans(tmp_path / "out", labels, film, rooms=tuple(labels), in_stages=in_stages)
        return [plan.request.labels if isinstance(plan, RunPlan) else "K" for plan in plans]

    small = labels["demo-d3dmv"]
    assert planned(in_stages=True) == [
        ["no-blending", "ours"],
        ["no-blending", "ours+no-tsdf"],
        "K",
        labels[MAIN],
        small,
    ]
    assert planned(in_stages=False) == [labels[MAIN], small, "K"]


def test_methods_are_shown_in_the_order_of_the_call_that_names_all(tmp_path):
    """A later call with more methods sets it; one with other methods adds them behind."""
    run, orders = RunFolder(tmp_path), []
    for asked in (["a", "c"], ["a", "b", "c"], ["c"], ["d", "a"]):
        note_labels(run, asked)
        orders.append("".join(read_json(run.root / "methods.json")["labels"]))
    assert orders == ["ac", "abc", "abc", "abcd"]


@pytest.mark.slow
def test_a_dry_run_leaves_nothing(tmp_path, capsys):
    """Without a capture the plan says for each room how much is to be done; nothing is written."""
    run_command(["run", str(tmp_path / "out"), "--dry-run"])

    told = [
        line
        for line in capsys.readouterr().out.splitlines()
        if line.startswith(("plan: ", "disk: "))
    ]
    assert [line.split(":")[0] for line in told] == ["plan", "disk"] * 4
    assert "3 views x 24 frames x 7 methods at 480 x 360, K = 4" in told[0]
    assert "2 views x 8 frames x 3 methods at 384 x 216, K = 4" in told[2]
    assert "2 views x 8 frames x 7 methods at 320 x 180, K = 2" in told[4]
    assert "5 runs of 2 views x 6 frames x 2 methods at 480 x 360, K = 2, 3, 4, 5, 6" in told[6]
    assert str(tmp_path / "out-k") + "," in told[7]
    assert list(tmp_path.iterdir()) == []


def test_the_outlook_follows_the_machine(tmp_path):
    """A machine that is three times slower is told three times as long; once the page is there
    nothing is told.
    """
    labels = demo_runs.room_labels(usual_methods())
    slow, slower = (
        demo_runs.describe_outlook(tmp_path, labels, 2, partial(float, factor)) for factor in (2, 6)
    )
    minutes = [
        [int(number) for number in re.findall(r"about (\d+) min", text)] for text in (slow, slower)
    ]
    assert minutes[0]
    assert [3 * number for number in minutes[0]] == pytest.approx(minutes[1], abs=2)
    (tmp_path / "report").mkdir()
    (tmp_path / "report" / "index.html").touch()
    assert not demo_runs.describe_outlook(tmp_path, labels, 2)
