"""Ladders of degradations: strength 0 changes nothing, equal seeds give equal bits, and the
strength is what it is called.
"""

from itertools import pairwise

import numpy as np
import pytest

from ggvs_eval.camera import Camera, translated_path
from ggvs_eval.contrib.study import frame_ladders
from ggvs_eval.contrib.study.clips import Clip, SourceClip, Take, write_take
from ggvs_eval.contrib.study.ladders import LADDERS, select_ladders
from ggvs_eval.contrib.study.rendered_ladders import render, sources_at
from ggvs_eval.contrib.study.takes import fill_take
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.time.flicker import flicker
from helpers.noise_scenes import clean_video
from helpers.refusals import refused

T, HEIGHT, WIDTH, DEPTH = 6, 48, 64, 2.0


def wall(camera: Camera) -> np.ndarray:
    """What a camera sees of a textured wall that stands across its view, (H, W, 3)."""
    columns = (np.arange(WIDTH) + 0.5 - WIDTH / 2) / camera.K[0, 0] * DEPTH + camera.centre[0]
    rows = (np.arange(HEIGHT) + 0.5 - HEIGHT / 2) / camera.K[1, 1] * DEPTH
    waves = np.sin(40 * columns)[None, :, None] + np.cos(30 * rows)[:, None, None] * np.array(
        [1.0, 0.8, 0.6]
    )
    return np.rint(128 + 40 * waves).astype(np.uint8)


@pytest.fixture(scope="module")
def path() -> Clip:
    """A camera that moves along a wall, with four cameras beside the way, nearest first."""
    camera = Camera(
        "cam",
        np.array([[60.0, 0, WIDTH / 2], [0, 60.0, HEIGHT / 2], [0, 0, 1]]),
        np.eye(4),
        WIDTH,
        HEIGHT,
        1.0,
        4.0,
    )
    poses, rig = translated_path(camera, 0.12, T), translated_path(camera, 0.3, 4)
    depth = np.full((1, HEIGHT, WIDTH), DEPTH, np.float32)
    sources = [
        SourceClip(each, wall(each)[None], depth, np.ones_like(depth))
        for each in (rig[1], rig[2], rig[0], rig[3])
    ]
    truth = np.stack([wall(pose) for pose in poses])
    return Clip("path", truth, tuple(poses), np.repeat(depth, T, axis=0), tuple(sources))


@pytest.mark.parametrize("name", LADDERS)
def test_strength_0_changes_nothing(path, name):
    """At strength 0 a ladder gives the undegraded frames bit for bit: the truth, or the rendering
    of undisturbed inputs.
    """
    ladder = LADDERS[name]
    frames = ladder.frames(path, 0.0, seed=4)

    if not ladder.is_rendered:
        assert np.array_equal(frames, path.truth)
    if name == "boiling":
        assert np.array_equal(frames, render(path))
    assert np.array_equal(frames, ladder.frames(path, 0.0, seed=6))


@pytest.mark.parametrize("name", LADDERS)
def test_equal_seeds_give_equal_bits_and_every_strength_other_frames(path, name):
    """A ladder is a pure function of clip, strength and seed, and all its steps differ."""
    ladder = LADDERS[name]
    strengths = ladder.strengths[: 2 if ladder.is_rendered else None]
    steps = [ladder.frames(path, strength, seed=2) for strength in strengths]

    assert len(ladder.strengths) >= 5
    assert list(ladder.strengths) == sorted(ladder.strengths)
    assert np.array_equal(steps[0], ladder.frames(path, strengths[0], seed=2))
    assert all(each.shape == path.truth.shape and each.dtype == np.uint8 for each in steps)
    # six frames cannot be frozen in five shares
    assert len({each.tobytes() for each in steps}) >= min(len(steps), T - 1)


def test_psnr_falls_with_noise(path):
    """The noise of twice the strength takes 6 dB, but for rounding and clipping."""
    scores = [
        np.mean(
            [
                psnr(*pair)
                for pair in zip(frame_ladders.noise(path.truth, s, 1), path.truth, strict=True)
            ]
        )
        for s in (2, 4, 8)
    ]

    assert np.diff(scores) == pytest.approx([-6, -6], abs=0.2)


def test_a_shift_of_a_pixel_is_a_shift_of_a_pixel():
    """Interpolated displacement is what it is called: three thirds of a pixel are the neighbouring
    pixel.
    """
    ramp = np.repeat(
        np.repeat(np.arange(60, 180, 4, dtype=np.uint8)[None, None, :, None], 20, axis=1), 3, axis=3
    )
    moved = frame_ladders.shift(ramp, 1.0, seed=0).astype(float) - ramp
    angle = np.random.default_rng(0).uniform(0.0, 2 * np.pi)

    assert moved[0, 5:-5, 5:-5] == pytest.approx(-4 * np.cos(angle), abs=0.5)


def test_wobble_depends_on_the_angle_alone(path):
    """Poses of one angle are displaced alike, those of another angle not."""
    still = np.repeat(path.truth[:1], 3, axis=0)
    swum = frame_ladders.wobble(still, 1.0, 0, np.array([0.0, 0.0, 0.7]))

    assert np.array_equal(swum[0], swum[1])
    assert not np.array_equal(swum[0], swum[2])


def test_flicker_has_the_strength_that_it_is_called():
    """The gains of a uniform clip deviate by exactly 5 %, but for rounding; the drift rises by 16 %
    from end to end.
    """
    grey = np.full((12, 8, 8, 3), 100, np.uint8)

    assert frame_ladders.flicker(grey, 5.0, 3).mean(axis=(1, 2, 3)).std() == pytest.approx(
        5.0, abs=0.15
    )
    assert np.ptp(frame_ladders.drift(grey, 16.0).mean(axis=(1, 2, 3))) == 16


def test_frozen_frames_have_no_flicker():
    """Of a scene at rest with everything frozen the flicker is exactly 0, and the share of repeated
    frames is the strength.
    """
    rest = np.repeat(clean_video(1), 11, axis=0)
    frozen = frame_ladders.freeze(rest, 100.0)
    moving = frame_ladders.freeze(clean_video(11), 40.0, seed=5)

    assert flicker(zip(frozen, rest, strict=True)).error == 0
    assert sum(np.array_equal(*pair) for pair in pairwise(moving)) == 4
    assert np.array_equal(
        frame_ladders.freeze(clean_video(11), 100.0), np.repeat(clean_video(11)[:1], 11, axis=0)
    )


def test_sources_are_exchanged_as_often_as_said(path):
    """So many switches change the pair of sources so often, always all of it."""
    for switches in (0, 1, 3, 5):
        pairs = [
            {source.camera.name for source in sources_at(path, frame, switches, 0)}
            for frame in range(T)
        ]
        changes = [before & after for before, after in pairwise(pairs) if before != after]

        assert len(changes) == switches
        assert not any(changes)


def test_a_clip_says_what_it_cannot_be_degraded_by(path):
    """Frames of one camera without sources have no wobble, no switch and no boiling; the reason is
    told.
    """
    frames = Clip("frames", path.truth)
    unfit = {name for name, ladder in LADDERS.items() if ladder.refuses(frames)}

    assert unfit == {"wobble", "switch", "jump", "boiling"}
    assert LADDERS["boiling"].refuses(frames) == "no source camera with depth"
    assert not any(ladder.refuses(path) for ladder in LADDERS.values())


def test_a_take_is_read_as_it_was_written(path, tmp_path):
    """Frames, cameras, depth and sources of a clip survive their file; an empty folder is
    no take.
    """
    write_take(tmp_path / "take", [path])
    (again,) = Take.open(tmp_path / "take", "take").clips()

    assert np.array_equal(again.truth, path.truth)
    assert np.array_equal(again.depths, path.depths)
    assert again.view_angles_deg() == pytest.approx(path.view_angles_deg())
    assert [source.camera.name for source in again.sources] == [
        source.camera.name for source in path.sources
    ]
    assert np.array_equal(render(again), render(path))


def test_degradations_may_be_planted_in_a_rendering(path, tmp_path):
    """On a rendering strength 0 is that rendering, bit for bit, and what is measured against stays
    the truth.
    """
    fill_take(lambda: [path], "rendering", tmp_path)
    (clip,) = Take.open(tmp_path, "take").clips()

    assert np.array_equal(LADDERS["noise"].frames(clip, 0.0, 1), render(path))
    assert not np.array_equal(clip.undegraded, clip.truth)
    assert np.array_equal(clip.truth, path.truth)


def test_an_unknown_ladder_names_the_nearest():
    """A mistyped ladder is refused with the right name."""
    with refused(MetricError, "did you mean blur?"):
        select_ladders(("blurr",))
