"""Domains: what each option of their captures does, and that training and validation film what they
say.
"""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.samples.capture_source import held_back_halves, overlap
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind, InstantKind
from ggvs_eval.contrib.training.samples.samples import SamplePool
from ggvs_eval.contrib.training.samples.training_data import (
    RoomPlan,
    choose_views,
    domain_plans,
    draw_window,
    film_room,
    room_options,
)
from ggvs_eval.contrib.worlds.demo import _description, write_demo
from ggvs_eval.contrib.worlds.domains import DOMAINS, VALIDATION_SEEDS, domain_options
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room, measured, misplaced
from ggvs_eval.contrib.worlds.film.options import LATER, DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import UNITS_PER_METRE, render_depth
from ggvs_eval.contrib.worlds.film.shots import (
    defocus,
    denoise,
    hand_held_shots,
    mosaic_and_back,
    rig_of,
    rig_sensors,
    sharpen,
)
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError, TrainingError
from helpers.refusals import refused
from helpers.scenes import render_view

pytestmark = pytest.mark.usefixtures("lit_quickly")
SMALL = DemoOptions(
    width=96,
    height=72,
    n_frames=3,
    cameras_per_row=2,
    path_poses=0,
    supersampling=1,
    depth_stride=0,
)
# At 3326e7f, before there were domains.
PLAIN_NOISE, PLAIN_SPREAD = 0.7496200160267352, 0.012452947166492987
WALK = replace(SMALL, layout="rgbd", n_frames=4, fps=3.0, noise_sigma_255=0.0, exposure_spread=0.0)


def spacing_of(options: DemoOptions) -> float:
    """Median distance of neighbouring cameras of the top row, world units."""
    n = options.cameras_per_row
    x = np.sort([camera.centre[0] for camera in rig_of(options)[:n]])
    return float(np.median(np.diff(x)))


def grey_card(size: int = 64, level: float = 0.5) -> np.ndarray:
    return np.full((size, size, 3), level, np.float32)


def developed(image: np.ndarray, **options: float) -> np.ndarray:
    """What the first camera of a capture makes of a picture."""
    sensor = rig_sensors(replace(SMALL, noise_sigma_255=0.0, exposure_spread=0.0, **options))[0]
    return sensor.expose(image, sensor.noise(3))


@pytest.mark.parametrize("name", DOMAINS)
def test_every_domain_is_filmed_as_it_says_in_validation_and_at_random_in_training(
    name: str,
) -> None:
    """Validation has the strengths that are written; training draws them within their limits,
    another for each seed.
    """
    domain, usual = DOMAINS[name], domain_options(name, VALIDATION_SEEDS[0])
    assert (usual.width, usual.height) == domain.size
    for option, value in domain.options.items():
        assert getattr(usual, option) == value
    drawn = [domain_options(name, seed) for seed in (1000, 1001)]
    for option, (least, most) in domain.strengths.items():
        assert all(least <= getattr(options, option) <= most for options in drawn)
        assert option in ("jpeg_quality",) or getattr(drawn[0], option) != getattr(drawn[1], option)
        assert least <= getattr(usual, option) <= most
    assert domain_options(name, 1000) == drawn[0]


def test_the_plain_domain_is_the_room_that_networks_have_always_learned_from() -> None:
    """Seed 1000 keeps the noise and the exposure that it had before there were domains; samples of
    each domain have a folder.
    """
    room = room_options(1000, RoomPlan())
    assert (room.noise_sigma_255, room.exposure_spread) == (PLAIN_NOISE, PLAIN_SPREAD)
    folders = {BlendKind().folder(RoomPlan(domain=name)) for name in DOMAINS}
    assert len(folders) == len(DOMAINS)


def test_options_that_came_later_do_not_change_the_description_of_old_demos() -> None:
    """demo.json of usual options names none of them, of others those that differ."""
    usual, closer = (
        json.loads(_description(options))["options"]
        for options in (SMALL, replace(SMALL, spacing=0.5))
    )
    assert not set(LATER) & set(usual)
    assert set(LATER) & set(closer) == {"spacing"}


@pytest.mark.parametrize(
    "wrong",
    [
        {"spacing": 0.0},
        {"defocus_px": -1.0},
        {"jpeg_quality": 101},
        {"shutter_s": 0.01},
        {"scene": "sea"},
    ],
)
def test_options_that_cannot_be_filmed_are_refused(wrong: dict[str, float]) -> None:
    """Each by a message that names it."""
    with pytest.raises(CaptureError, match=next(iter(wrong))):
        replace(SMALL, **wrong)


@pytest.mark.parametrize("rig", ["rows", "grid"])
def test_spacing_scales_the_distances_between_cameras(rig: str) -> None:
    """A third of the spacing is a third of the distance, but for how exactly cameras are
    mounted.
    """
    options = replace(SMALL, cameras_per_row=12, rig=rig)
    assert spacing_of(replace(options, spacing=0.33)) == pytest.approx(
        0.33 * spacing_of(options), rel=0.08
    )


@pytest.mark.slow
def test_a_camera_that_stands_still_does_not_blur() -> None:
    """With a shutter so short that nothing moves, the mean of all poses is the sharp picture; with
    a long one it is smoother.
    """
    sharp, still, moving = (
        _first_picture(replace(WALK, width=48, height=36, shutter_s=shutter_s, sway=6.0))
        for shutter_s in (0.0, 1e-7, 0.06)
    )
    assert np.abs(sharp.astype(int) - still).max() <= 1
    detail = [cv2.Laplacian(image, cv2.CV_64F).var() for image in (sharp, moving)]
    assert detail[1] < 0.7 * detail[0]


def _first_picture(options: DemoOptions) -> np.ndarray:
    room = lit_room(options.seed).at(0.0)
    return next(Footage(options, hand_held_shots(options)[1], lambda index: room).frames()).image


def test_poses_during_an_exposure_lie_around_the_pose_that_is_noted() -> None:
    """Their mean centre is the noted one, and they span the shutter's share of the way."""
    shot = hand_held_shots(replace(WALK, shutter_s=0.02))[2]
    centres = np.array([pose.centre for pose in shot.poses])
    np.testing.assert_allclose(centres.mean(axis=0), shot.camera.centre, atol=2e-3)
    fastest = 0.7 * UNITS_PER_METRE * 1.3  # the walk's speed, all three swings at their fastest
    assert 0 < np.linalg.norm(centres[-1] - centres[0]) <= fastest * 0.02


@pytest.mark.parametrize("level", [0.1, 0.5, 0.9])
def test_a_grey_card_stays_grey(level: float) -> None:
    """Mosaic, white balance, demosaicing, denoising, sharpening and JPEG change the mean of no
    colour by more than a level.
    """
    made = developed(
        grey_card(level=level), processing=1.0, defocus_px=1.0, jpeg_quality=90
    ).astype(float)
    np.testing.assert_allclose(made.mean(axis=(0, 1)), 255 * level, atol=1.2)
    assert made.std() > 0.2


def test_colours_survive_the_mosaic() -> None:
    """Without noise a smooth picture of any colour comes back: the pattern of the mosaic is the one
    that demosaicing assumes.
    """
    colour = np.array([0.6, 0.3, 0.1], np.float32)
    back = mosaic_and_back(np.broadcast_to(colour, (32, 32, 3)), 0.0, np.random.default_rng(0))
    np.testing.assert_allclose(back, np.broadcast_to(colour, back.shape), atol=2e-4)


def test_raw_noise_grows_with_the_root_of_light() -> None:
    """Shot noise: four times the light has about twice the noise."""
    rng = np.random.default_rng(0)
    spread = [
        mosaic_and_back(np.full((128, 128, 3), level, np.float32), 1.0, rng)[..., 1].std()
        for level in (0.15, 0.6)
    ]
    assert spread[1] / spread[0] == pytest.approx(2.0, rel=0.15)


def test_denoising_smooths_and_keeps_edges() -> None:
    """Noise on both sides of an edge falls, the edge's height stays."""
    rng = np.random.default_rng(1)
    step = np.full((48, 48, 3), 0.3, np.float32)
    step[:, 24:] = 0.7
    noisy = step + rng.normal(0, 0.02, step.shape).astype(np.float32)
    clean = denoise(noisy, 1.0)
    assert (clean - step)[:, :20].std() < 0.7 * (noisy - step)[:, :20].std()
    assert clean[:, 26:].mean() - clean[:, :22].mean() == pytest.approx(0.4, abs=0.01)


def test_sharpening_overshoots_at_an_edge_only() -> None:
    """Halos beside the edge, nothing far from it."""
    step = np.full((32, 32, 3), 0.3, np.float32)
    step[:, 16:] = 0.7
    sharp = sharpen(step, 1.0)
    assert sharp.max() > 0.75
    assert sharp.min() < 0.25
    np.testing.assert_allclose(sharp[:, :8], 0.3, atol=1e-3)


def test_defocus_spreads_a_point_into_a_disc() -> None:
    """Light is kept, nothing lands beyond the disc, and a sharp lens changes nothing."""
    point = np.zeros((21, 21, 3), np.float32)
    point[10, 10] = 1.0
    disc = defocus(point, 3.0)
    y, x = np.mgrid[-10:11, -10:11]
    assert disc.sum(axis=(0, 1)) == pytest.approx([1, 1, 1], rel=1e-5)
    assert (disc[np.hypot(x, y) > 3.5] < 1e-6).all()
    assert (defocus(point, 0.0) == point).all()


@pytest.mark.slow
def test_depth_is_shifted_by_the_pixels_that_are_asked_for() -> None:
    """Phase correlation of the misplaced with the exact depth map measures the offset; written down
    is the exact sensor.
    """
    options = replace(WALK, width=192, height=144, depth_offset_px=6.0)
    room, camera = lit_room(options.seed).at(0.0), hand_held_shots(options)[0].camera
    exact, shifted = (
        1 / render_depth(room, each) for each in (camera, misplaced(options, camera, options.width))
    )
    window = cv2.createHanningWindow((192, 144), cv2.CV_32F)
    (dx, dy), _ = cv2.phaseCorrelate(exact, shifted, window)
    assert np.hypot(dx, dy) == pytest.approx(6.0, abs=0.3)


def test_a_turned_sensor_of_depth_looks_elsewhere_by_its_angle() -> None:
    """Rotation about its own centre, by the angle that is asked for."""
    camera = hand_held_shots(WALK)[0].camera
    turned = misplaced(replace(WALK, depth_rotation_rad=0.02), camera, WALK.width)
    cosine = (np.trace(turned.rotation @ camera.rotation.T) - 1) / 2
    assert np.arccos(cosine) == pytest.approx(0.02, rel=1e-6)
    np.testing.assert_allclose(turned.centre, camera.centre, atol=1e-9)


def test_a_late_sensor_of_depth_measures_from_an_earlier_pose() -> None:
    """One frame of delay is the pose of the frame before."""
    shots = hand_held_shots(replace(WALK, depth_delay_s=1 / WALK.fps))
    np.testing.assert_allclose(
        shots[2].depth_pose.world_to_camera, shots[1].camera.world_to_camera, atol=1e-9
    )


def test_noise_of_measured_depth_grows_with_its_square_and_edges_are_lost() -> None:
    """On a wall at 1 m the standard deviation is the one asked for, at 2 m four times as much; a
    step is unknown.
    """
    options = replace(WALK, depth_noise=0.004)
    for metres in (1.0, 2.0):
        wall = np.full((80, 80), metres * UNITS_PER_METRE, np.float32)
        spread = (measured(options, wall, 0) - wall).std() / UNITS_PER_METRE
        assert spread == pytest.approx(0.004 * metres**2, rel=1e-3)
    wall[:, 40:] *= 2
    assert (measured(options, wall, 0)[:, 39:41] == 0).all()
    assert (measured(WALK, wall, 0) == wall).all()


@pytest.mark.slow
def test_a_garden_has_thin_foliage_before_a_far_background() -> None:
    """Depth spans more than a factor of eight, near things are thin, and every ray ends
    somewhere.
    """
    camera = rig_of(replace(SMALL, width=160, height=120))[0]
    garden = lit_room(101, "garden").at(0.0)
    image, depth = render_view(garden, camera, 1)
    metres = depth / UNITS_PER_METRE
    assert metres.min() > 0
    near, far = np.percentile(metres, [2, 98])
    assert far / near > 8
    close = (metres < 2.2) & (np.arange(120)[:, None] < 70)
    assert 0.01 < close.mean() < 0.3
    assert cv2.erode(close.astype(np.uint8), np.ones((9, 9))).mean() < 0.1 * close.mean()
    assert 0.25 < image.mean() < 0.7


TINY_DOMAINS = ("narrow", "handheld", "misplaced_depth")


@pytest.mark.proof
def test_samples_of_many_domains_are_one_lot(tmp_path: Path) -> None:
    """Each domain is rendered into its own folder, and its samples stand one after another,
    sensors' depth included.
    """
    plans = [
        replace(plan, width=96, height=72)
        for plan in domain_plans(TINY_DOMAINS, rooms=1, targets=1, matcher="sgbm")
    ]
    pool = SamplePool(tmp_path, BlendKind(), plans)
    assert len(pool) == 3
    for job in pool.jobs():
        job()
    samples = [pool.read(index) for index in range(3)]
    assert {sample.truth.shape for sample in samples} == {(72, 96, 3)}
    for sample in samples[1:]:
        assert (sample.views.fused_depth > 0).mean() > 0.3
    assert "domain handheld" in pool.data


@pytest.mark.proof
def test_of_large_images_a_window_is_kept(tmp_path: Path) -> None:
    """It shows what the whole sample shows there, for the network and for the baselines, whose
    sources are cut to it.
    """
    whole = replace(
        domain_plans(["large"], rooms=1, targets=1)[0], width=96, height=72, window=None
    )
    part = replace(whole, window=(64, 48))
    kinds = (BlendKind(), whole), (BlendKind(), part), (InstantKind(), part)
    pools = [SamplePool(tmp_path, kind, [plan]) for kind, plan in kinds]
    for job in (job for pool in pools for job in pool.jobs()):
        job()
    sample, window, instant = (pool.read(0) for pool in pools)
    left, top, width, height = draw_window(part, 1000, 0)
    assert (width, height) == (64, 48)
    assert (window.truth == sample.truth[top : top + 48, left : left + 64]).all()
    assert (window.views.fused_depth == sample.views.cropped(left, top, 64, 48).fused_depth).all()
    np.testing.assert_allclose(
        window.views.target.K[:2, 2], sample.views.target.K[:2, 2] - (left, top)
    )
    assert (instant.truth == window.truth).all()
    assert part.least_size == (64, 48)


@pytest.mark.proof
def test_sources_of_a_hand_held_camera_follow_the_rule_of_sequences(tmp_path: Path) -> None:
    """They lie within the domain's span, beyond its gap, and equal seeds give equal views."""
    plan = RoomPlan(width=64, height=48, views=3, other_share=0.0, domain="misplaced_depth")
    capture, domain = film_room(tmp_path, 1000, plan), DOMAINS["misplaced_depth"]
    target, sources = choose_views(capture, plan, 1000, 0)
    apart = [abs(int(source.name) - int(target.name)) for source in sources]
    assert all(domain.gap < each <= domain.span for each in apart)
    assert _names(choose_views(capture, plan, 1000, 0)) == _names((target, sources))


def _names(views: tuple[Camera, list[Camera]]) -> list[str]:
    return [views[0].name, *(source.name for source in views[1])]


@pytest.fixture(scope="module")
def walk(tmp_path_factory) -> Capture:
    options = replace(WALK, width=32, height=24, n_frames=12)
    return open_capture(write_demo(tmp_path_factory.mktemp("walk") / "walk", options, workers=1))


@pytest.mark.slow
def test_a_sequence_is_split_so_that_no_view_is_in_both_parts(walk: Capture) -> None:
    """Frames of one part are further than the span from those of the other, and keep their
    depth.
    """
    capture = walk
    first, last = held_back_halves(capture, span=3, most_overlap=1.0)
    assert [camera.name for camera in first.cameras] == [f"{number:06d}" for number in range(6)]
    assert [camera.name for camera in last.cameras] == ["000009", "000010", "000011"]
    kept, whole = (next(each.extras_of("000009").depth.depths(0, 1)) for each in (last, capture))
    assert (kept == whole).all()
    assert (last.frame("000010", 0) == capture.frame("000010", 0)).all()
    with refused(TrainingError, "12 frames", "rgbd", "0 after"):
        held_back_halves(capture, span=6)


@pytest.mark.slow
def test_what_the_camera_comes_back_to_is_not_held_back(walk: Capture) -> None:
    """Frames of which a learned frame sees more than the share are in neither part; a walk around
    one place has no other.
    """
    capture = walk
    first, last = held_back_halves(capture, 3, most_overlap=1.0)
    shares = {
        camera.name: max(overlap(camera, learned) for learned in first.cameras)
        for camera in last.cameras
    }
    middle = sorted(shares.values())[1]
    kept = held_back_halves(capture, 3, most_overlap=middle)[1]
    assert list(kept.camera_names) == [name for name, share in shares.items() if share <= middle]
    assert len(kept.cameras) < 3
    with refused(TrainingError, "3 after", "0 of them new"):
        held_back_halves(capture, 3, most_overlap=0.1)
