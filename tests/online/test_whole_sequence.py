"""The reference that is not online: it uses the future, is marked for it, and is calmer for it."""

from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.method import Instant, LookaheadMethod, SourceView
from ggvs_eval.pipelines.methods.registry import METHODS, find_method, usual_methods
from ggvs_eval.pipelines.methods.spec import OnlineMethod
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.whole_sequence import WholeSequence
from ggvs_eval.pipelines.run.evaluate import render
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from helpers.scenes import camera_at, instant
from helpers.small_runs import small_protocol, write_small_capture

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15)]
OFFLINE = "ours-geometric+offline"


def play(positions: list[float], looks_ahead: bool = True) -> list[np.ndarray]:
    method, instants = (
        WholeSequence(),
        [instant(t, TARGET, SOURCES, x, depth_noise=0.02) for t, x in enumerate(positions)],
    )
    if looks_ahead:
        method.look_ahead(reversed(instants))
    return [method.step(each).image for each in instants]


def test_every_method_that_looks_ahead_is_marked():
    """Whatever is shown the future says so in its spec and its title; nothing else that renders
    frame by frame does.
    """
    for spec in (
        each
        for each in METHODS.values()
        if isinstance(each, OnlineMethod) and "weights" not in each.takes
    ):
        assert isinstance(spec.make(), LookaheadMethod) == (not spec.online)
        assert spec.online or "offline" in spec.title.lower()
    assert not find_method(OFFLINE).online
    assert OFFLINE not in usual_methods()


def test_the_future_changes_the_present():
    """Another end of the sequence changes its beginning, which no online method may show."""
    assert not np.array_equal(play([0.0, 0.0, 0.0])[0], play([0.0, 0.4, 0.4])[0])


def test_without_a_look_ahead_it_is_the_online_method():
    """Where there is no sequence to look at, along a camera path, it renders what the online method
    renders.
    """
    online = GeometryGuided()
    for t, image in enumerate(play([0.0, 0.1], looks_ahead=False)):
        np.testing.assert_array_equal(
            image, online.step(instant(t, TARGET, SOURCES, 0.1 * t, depth_noise=0.02)).image
        )


def test_each_instant_is_mixed_with_those_behind_it():
    """Backwards by Eq. 2 with a weight of 0.6: the last instant as it is, then each with what the
    next one came to.
    """
    image, camera, ones = (
        np.full((8, 12, 3), 90, np.uint8),
        camera_at(0.0, width=12, height=8),
        np.ones((8, 12), np.float32),
    )
    depths = (2.0, 2.02, 1.99)
    instants = [
        Instant(t, TARGET, (SourceView(camera, image, depth * ones, ones),), 2.5)
        for t, depth in enumerate(depths)
    ]
    method = WholeSequence()
    method.look_ahead(reversed(instants))
    second = 0.6 * 2.02 + 0.4 * 1.99
    for moment, expected in zip(instants, (0.6 * 2.0 + 0.4 * second, second, 1.99), strict=True):
        np.testing.assert_allclose(
            method._depth(moment.index, moment.sources[0]), expected, rtol=1e-6
        )


def test_nothing_is_left_behind():
    """The folder of the backward pass goes with the method."""
    method = WholeSequence()
    method.look_ahead([instant(0, TARGET, SOURCES)])
    folder = Path(method._folder.name)

    assert len(list(folder.iterdir())) == len(SOURCES)
    del method
    assert not folder.exists()


@pytest.mark.slow
def test_a_run_shows_it_the_whole_sequence(tmp_path):
    """Rendered in a run it has looked at every frame of the protocol, and the time that took is
    told.
    """
    capture, protocol = write_small_capture(tmp_path / "room"), small_protocol(3, 0, ("PSNR",))
    prepared = prepare(tmp_path / "run", capture, protocol, labels=[OFFLINE, "ours-geometric"])

    render(prepared)

    record = read_json(RunFolder(tmp_path / "run").renders(OFFLINE, "cam00") / JOB_FILE)
    frames = [
        RunFolder(tmp_path / "run").renders(label, "cam00") / "0000.png"
        for label in (OFFLINE, "ours-geometric")
    ]
    assert [seconds > 0 for seconds in record["seconds"]["look ahead"]] == [True] * 3
    assert frames[0].read_bytes() != frames[1].read_bytes()
