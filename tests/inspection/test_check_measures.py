"""The measures behind the check of a capture, on inputs whose answers are known."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.finding import Finding, graded, worst
from ggvs_eval.geometry.epipolar import (
    Features,
    MatchedPair,
    consistent,
    epipolar_errors,
    find_features,
    match_features,
    neighbour_pairs,
    ray_depths,
)
from ggvs_eval.pipelines.inspection.capture.check import CaptureCheck, check_capture, check_scale
from ggvs_eval.pipelines.inspection.capture.colour import camera_gains, check_gain, check_noise
from ggvs_eval.pipelines.inspection.capture.depth_range import neighbour_spacing, seen_share
from ggvs_eval.pipelines.inspection.capture.epipolar_findings import (
    check_epipolar,
    explain_camera,
    explain_rig,
)
from ggvs_eval.pipelines.inspection.capture.frames import (
    check_frames,
    common_repeats,
    frozen_frames,
)
from ggvs_eval.pipelines.inspection.capture.pairs import (
    largest_group,
    solve_differences,
)
from ggvs_eval.pipelines.inspection.capture.poses import (
    away_angles,
    check_intrinsics,
    check_poses,
    fields_of_view_deg,
    look_at_point,
    off_centre,
    roll_angles,
    same_places,
)
from ggvs_eval.pipelines.inspection.capture.records import (
    Recorder,
    difference_sigma,
    largest_change,
    motion_energy,
    record_camera,
)
from ggvs_eval.pipelines.inspection.capture.timing import best_lag, plane_angles
from helpers.captures import make_image, make_rig, write_dynerf, write_folders, write_poses
from helpers.small_rig import make_cameras

TARGET = np.array([0.5, -0.25, 6.0])


def looking_at(name: str, centre: np.ndarray, target: np.ndarray = TARGET) -> Camera:
    forward = (target - centre) / np.linalg.norm(target - centre)
    right = np.cross([0.0, 1.0, 0.0], forward)
    right /= np.linalg.norm(right)
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = np.stack([right, np.cross(forward, right), forward])
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ centre
    K = np.array([[200.0, 0, 160], [0, 200.0, 120], [0, 0, 1]])
    return Camera(name, K, world_to_camera, 320, 240, 3.0, 10.0)


def arc(count: int = 6) -> list[Camera]:
    """Cameras around the target at several heights, turned by up to 80 degrees against each
    other.
    """
    angles = np.linspace(-0.7, 0.7, count)
    centres = [
        TARGET + np.array([6 * np.sin(a), 0.8 * (-1) ** i + 0.3 * a, -6 * np.cos(a)])
        for i, a in enumerate(angles)
    ]
    return [looking_at(f"cam{index:02d}", centre) for index, centre in enumerate(centres)]


def matched(cameras: list[Camera], i: int, j: int, count: int = 80) -> MatchedPair:
    """Exact images of points around the target in the true cameras."""
    points = TARGET + np.random.default_rng([i, j]).uniform(-1.5, 1.5, (count, 3))
    grey = np.full((count, 3), 100, np.float32)
    return MatchedPair(
        i, j, cameras[i].project(points)[0], cameras[j].project(points)[0], grey, grey
    )


def all_pairs(cameras: list[Camera]) -> list[MatchedPair]:
    return [matched(cameras, i, j) for i, j in neighbour_pairs(cameras)]


def test_differences_are_solved_and_a_wrong_pair_is_outvoted():
    """Exact differences give the values back with median 0, though one measurement is off by 5."""
    values = np.array([0.0, 2.0, -1.0, 0.0, 0.5])
    pairs = [(i, j) for i in range(5) for j in range(i)]
    differences = np.array([values[i] - values[j] for i, j in pairs])
    differences[3] += 5

    solved = solve_differences(5, pairs, differences, np.ones(len(pairs)))

    assert solved == pytest.approx(values, abs=1e-3)


def test_cameras_without_a_chain_to_the_rig_have_no_value():
    """Only the largest connected group gets values; nobody does where nothing was measured."""
    solved = solve_differences(5, [(0, 1), (1, 2), (3, 4)], np.array([1.0, 1.0, 9.0]), np.ones(3))

    assert solved[:3] == pytest.approx([1, 0, -1], abs=1e-6)
    assert np.isnan(solved[3:]).all()
    assert largest_group(3, []) == [0]


@pytest.mark.parametrize("sigma", [0.8, 1.5, 4.0])
def test_noise_is_measured_between_the_integers_and_despite_motion(sigma):
    """Noise of 8-bit frames is found within 6 %, coarse as its steps are; the tenth of the pixels
    that move adds no more.
    """
    rng = np.random.default_rng(1)
    one, other = (np.rint(120 + rng.normal(0, sigma, 200_000)) for _ in range(2))
    rounded = np.hypot(sigma, np.sqrt(1 / 12))  # rounding to 8 bit is noise too
    still = np.bincount(np.abs(one - other).astype(int), minlength=256)
    other[:20_000] += 60
    moving = np.bincount(np.abs(one - other).astype(int), minlength=256)

    assert difference_sigma(still) == pytest.approx(rounded, rel=0.06)
    # The median of all is then the 55.6th percentile of the still ones, 1.135 times as much.
    assert difference_sigma(moving) == pytest.approx(1.135 * rounded, rel=0.08)
    assert np.isnan(difference_sigma(np.zeros(256, np.int64)))


def test_change_is_that_of_the_cell_that_changes_most():
    """A cell of a 16th of the sides that turns from black to 80 counts 80, however still the rest
    is.
    """
    before = np.zeros((160, 320), np.uint8)
    after = before.copy()
    after[10:20, 20:40] = 80

    assert largest_change(after, before) == pytest.approx(80)


def test_epipolar_error_is_the_distance_from_the_line():
    """Exact matches have none; of a pair side by side, a vertical slip of 3 pixels is 3 pixels, a
    horizontal one nothing.
    """
    one = looking_at("a", np.zeros(3), np.array([0, 0, 1.0]))
    other = replace(
        one,
        name="b",
        world_to_camera=one.world_to_camera - np.array([[0, 0, 0, 0.5], [0] * 4, [0] * 4, [0] * 4]),
    )
    points = np.random.default_rng(0).uniform((-1, -1, 4), (1, 1, 8), (50, 3))
    uv_one, uv_other = one.project(points)[0], other.project(points)[0]

    assert epipolar_errors(one, other, uv_one, uv_other) == pytest.approx(0, abs=1e-9)
    assert epipolar_errors(one, other, uv_one, uv_other + np.array([0, 3.0])) == pytest.approx(3.0)
    assert epipolar_errors(one, other, uv_one, uv_other + np.array([3.0, 0])) == pytest.approx(
        0, abs=1e-9
    )


def test_depths_of_matches_are_those_of_the_points():
    """The rays of exact matches meet at the points, at the angle between them."""
    one, other = arc()[1:3]
    points = TARGET + np.random.default_rng(0).uniform(-1, 1, (20, 3))
    (uv_one, z_one), (uv_other, z_other) = one.project(points), other.project(points)

    depth_one, depth_other, angle_rad = ray_depths(one, other, uv_one, uv_other)

    assert depth_one == pytest.approx(z_one)
    assert depth_other == pytest.approx(z_other)
    rays = points - one.centre, points - other.centre
    cosine = (
        (rays[0] * rays[1]).sum(axis=1)
        / np.linalg.norm(rays[0], axis=1)
        / np.linalg.norm(rays[1], axis=1)
    )
    assert angle_rad == pytest.approx(np.arccos(cosine))


def test_mismatches_do_not_agree_with_the_others():
    """Of 100 exact and 40 random matches the exact ones are kept, and at most a few of the
    others.
    """
    pair = matched(arc(), 1, 2, 100)
    rng = np.random.default_rng(5)
    uv_one = np.concatenate([pair.uv_first, rng.uniform(0, 320, (40, 2))])
    uv_other = np.concatenate([pair.uv_second, rng.uniform(0, 320, (40, 2))])

    kept = consistent(uv_one, uv_other, 1.5)

    assert kept[:100].all()
    assert kept[100:].sum() < 8


def test_features_are_matched_by_what_they_look_like():
    """Shuffled copies find their originals; features of an image's shifted copy are found at the
    shift, to half a pixel.
    """
    rng = np.random.default_rng(2)
    descriptors = rng.random((30, 128)).astype(np.float32)
    descriptors /= np.linalg.norm(descriptors, axis=1, keepdims=True)
    order = rng.permutation(30)
    empty = np.zeros((30, 2)), np.zeros((30, 3), np.float32)
    shuffled = match_features(
        Features(empty[0], descriptors, empty[1]), Features(empty[0], descriptors[order], empty[1])
    )
    assert (order[shuffled[:, 1]] == shuffled[:, 0]).all()
    assert len(shuffled) == 30

    picture = np.kron(rng.integers(0, 255, (20, 24, 3)), np.ones((8, 8, 1))).astype(np.uint8)
    one, other = find_features(picture), find_features(np.roll(picture, 16, axis=1))
    matches = match_features(one, other)
    shifts = other.uv[matches[:, 1]] - one.uv[matches[:, 0]]
    assert len(matches) > 20
    assert np.median(shifts, axis=0) == pytest.approx([16, 0], abs=0.5)


def test_an_image_without_structure_has_no_features():
    """A plain image gives none, and matching with it gives none."""
    plain = find_features(np.full((60, 80, 3), 90, np.uint8))

    assert len(plain.uv) == 0
    assert len(match_features(plain, plain)) == 0


def test_half_planes_through_both_centres_are_seen_at_equal_angles():
    """A point's half-plane about the baseline has the same angle in both cameras, whatever its
    depth.
    """
    one, other = arc()[2:4]
    angles = plane_angles(one, other)
    for depth in (3.0, 6.0, 9.0):
        point = one.unproject(np.array([[100.5, 80.5]]), np.array([depth]))
        (u, v) = other.project(point)[0][0]
        assert 1 < u < 319
        assert 1 < v < 239
        column, row = int(u), int(v)
        block = angles[1][row - 1 : row + 2, column - 1 : column + 2]
        assert block.min() <= angles[0][80, 100] <= block.max()


@pytest.mark.parametrize("shift", [0.0, 2.0, -3.0, 1.5])
def test_the_lag_of_shifted_signals_is_found_with_its_fraction(shift):
    """Signals that are the same function of time, sampled `shift` frames apart, have that lag."""
    rng = np.random.default_rng(3)
    frequency, phase, time = (
        rng.uniform(0.3, 0.9, (12, 1)),
        rng.uniform(0, 6, (12, 1)),
        np.arange(40),
    )
    one, other = (np.sin(frequency * (time - s) + phase) for s in (0, shift))

    lag = best_lag(one, other, 8)

    assert lag is not None
    assert lag.frames == pytest.approx(shift, abs=0.1)
    assert lag.correlation > 0.9
    assert not lag.at_edge


def test_constant_signals_have_no_lag_and_noise_no_energy():
    """Where nothing happens there is no lag; frames that differ by noise alone have hardly any
    motion energy.
    """
    rng = np.random.default_rng(4)
    noisy = np.clip(120 + rng.normal(0, 2, (6, 60, 80)), 0, 255).astype(np.uint8)
    moving = noisy.copy()
    moving[3:, 20:30, 20:30] += 60

    assert best_lag(np.ones((4, 20)), np.ones((4, 20)), 5) is None
    assert motion_energy(noisy).mean() < 0.02
    assert motion_energy(moving)[2, 22:28, 22:28].min() > 5


def test_gains_are_solved_over_the_rig():
    """Pairs whose colours differ by the cameras' gains give them back with median 1; clipped
    colours take no part.
    """
    gains = np.array([[1.0, 1, 1], [1.35, 1.35, 1.35], [0.93, 1, 1], [1, 1, 1.05], [1, 1, 1]])
    rng = np.random.default_rng(6)
    pairs = []
    for i, j in [(0, 1), (1, 2), (2, 3), (3, 4), (0, 4), (1, 3)]:
        colours = rng.uniform(40, 180, (60, 3))
        colours[:10] = 250
        one, other = (np.minimum(colours * gains[k], 255).astype(np.float32) for k in (i, j))
        pairs.append(MatchedPair(i, j, np.zeros((60, 2)), np.zeros((60, 2)), one, other))

    assert camera_gains(5, pairs).factors == pytest.approx(gains, abs=1e-3)
    assert camera_gains(5, pairs).half_widths.max() < 0.01
    verdicts = [finding.verdict for finding in check_gain("abcde", pairs)]
    assert verdicts == ["ok", "ok", "bad", "warn", "warn", "ok"]
    assert {finding.verdict for finding in check_gain("ab", [])} == {"unknown"}


def test_frames_are_frozen_only_while_others_move():
    """A still frame of one camera is frozen when the others change, not when all pause or nothing
    ever moves there.
    """
    change = np.full((4, 8), 20, np.float32)
    change[:, 0] = np.nan
    change[1, 3] = 0.2
    change[:, 5] = 0.1
    change[2, 1:] = 0.3  # sees nothing move

    frozen = frozen_frames(change)

    assert [tuple(index) for index in np.argwhere(frozen)] == [(1, 3)]
    assert list(np.flatnonzero(common_repeats(change))) == [5]


def test_the_common_point_is_where_most_axes_meet():
    """Axes that meet give the point, one camera that looks away does not move it and is told by its
    angle.
    """
    cameras = arc()
    cameras[2] = looking_at("cam02", cameras[2].centre, cameras[2].centre - TARGET)

    point = look_at_point(cameras)

    assert point == pytest.approx(TARGET, abs=0.02)
    away = away_angles(cameras, point)
    assert np.delete(away, 2).max() < 0.01
    assert away[2] > 1.5
    verdicts = {finding.subject: finding.verdict for finding in check_poses(cameras)}
    assert [name for name, verdict in verdicts.items() if verdict == "bad"] == ["cam02"]


def test_parallel_cameras_have_no_common_point_and_are_judged_by_direction():
    """A plane of parallel cameras is fine; one that is turned by 60 degrees is not."""
    cameras = [
        looking_at(f"cam{i}", np.array([i, 0, 0.0]), np.array([i, 0, 5.0])) for i in range(5)
    ]

    assert look_at_point(cameras) is None
    assert {finding.verdict for finding in check_poses(cameras)} == {"ok"}
    cameras[1] = looking_at("cam1", np.array([1.0, 0, 0]), np.array([1 + 5 * np.sqrt(3), 0, 5.0]))
    assert [finding.subject for finding in check_poses(cameras) if finding.verdict != "ok"] == [
        "cam1"
    ]


def test_roll_is_the_turn_about_the_axis_only():
    """Cameras that look down from all sides are not rolled; one turned by 180 degrees about its
    axis is upside down.
    """
    centres = [
        TARGET + np.array([5 * np.cos(a), -4.0, 5 * np.sin(a)]) for a in np.linspace(0, 5.2, 6)
    ]
    cameras = [looking_at(f"cam{index}", centre) for index, centre in enumerate(centres)]
    assert roll_angles(cameras) == pytest.approx(np.zeros(6), abs=0.03)

    cameras[4] = replace(
        cameras[4], world_to_camera=np.diag([-1.0, -1, 1, 1]) @ cameras[4].world_to_camera
    )

    assert roll_angles(cameras)[4] == pytest.approx(np.pi, abs=0.2)
    found = next(finding for finding in check_poses(cameras) if finding.subject == "cam4")
    assert (found.verdict, "upside down" in found.measured) == ("warn", True)


def test_doubled_places_are_found():
    """Two cameras at one place know each other; all others are alone. Spacing is the distance to
    the nearest.
    """
    cameras = arc(4)
    cameras[3] = replace(cameras[1], name="cam03")

    assert same_places(cameras) == [[], [3], [], [1]]
    assert neighbour_spacing(cameras)[[1, 3]] == pytest.approx([0, 0])
    assert neighbour_spacing(cameras[:1]) == np.inf


def test_intrinsics_are_judged_by_their_closed_forms():
    """Field of view, centring and aspect follow from K; each fault is named, and only for the
    camera that has it.
    """
    cameras = arc(9)
    assert fields_of_view_deg(cameras[0]) == pytest.approx(
        (2 * np.degrees(np.arctan(0.8)), 2 * np.degrees(np.arctan(0.6)))
    )

    def with_K(index: int, **entries: float) -> None:
        K = cameras[index].K.copy()
        for place, value in entries.items():
            K[{"fx": (0, 0), "fy": (1, 1), "cx": (0, 2)}[place]] = value
        cameras[index] = replace(cameras[index], K=K)

    with_K(1, cx=0.9 * 320)
    with_K(2, fy=206.0)
    with_K(3, fx=2000.0, fy=2000.0)
    with_K(4, fx=210.0, fy=210.0)
    verdicts = {
        finding.subject: (finding.verdict, finding.measured)
        for finding in check_intrinsics(cameras)
    }

    assert off_centre(cameras[1]) == pytest.approx(0.4)
    assert verdicts["cam01"] == ("bad", "principal point 40 % of the side off centre")
    assert verdicts["cam02"] == ("warn", "fx / fy = 0.971")
    assert verdicts["cam03"] == ("warn", "horizontal field of view 9 deg")
    assert verdicts["cam04"] == ("warn", "focal length x 1.050 of the rig's median")
    assert [verdicts[name][0] for name in ("cam00", "cam05")] == ["ok", "ok"]


def test_overlap_is_all_for_twins_and_none_back_to_back():
    """Cameras at one place see all of each other's picture, cameras back to back none of it; half a
    picture to the side, half.
    """
    camera = looking_at("a", np.zeros(3), np.array([0, 0, 1.0]))
    twins = [camera, *(replace(camera, name=name) for name in "bcd")]
    turned = [
        replace(camera, name=name, world_to_camera=np.diag([-1.0, 1, -1, 1])) for name in "ef"
    ]
    flat = replace(camera, near=5.0, far=5.0001)
    aside = np.eye(4)
    aside[0, 3] = -0.5 * 5 * 320 / 200  # half the picture's width at depth 5
    beside = [replace(flat, name=name, world_to_camera=aside) for name in "gh"]

    assert seen_share(camera, twins) == 1.0
    assert seen_share(camera, [camera, *turned]) == 0.0
    assert seen_share(flat, [flat, *beside]) == pytest.approx(0.5, abs=0.05)


def test_a_random_pose_has_no_explanation():
    """A camera that simply stands elsewhere is not explained away."""
    true = arc()
    given = [*true]
    given[3] = looking_at("cam03", true[3].centre + np.array([0.8, -0.7, 0.3]))

    assert explain_camera(given, all_pairs(true), 3, [0, 1, 2, 4, 5]) is None


def test_inverse_poses_of_all_cameras_are_recognised():
    """Camera-to-world given for world-to-camera is said of the whole rig; a sound rig needs no
    explanation.
    """
    true = arc()
    given = [
        replace(camera, world_to_camera=np.linalg.inv(camera.world_to_camera)) for camera in true
    ]

    repair = explain_rig(given, all_pairs(true))

    assert repair is not None
    assert "camera-to-world" in repair.meaning
    assert explain_rig(true, all_pairs(true)) is None


def test_neighbours_are_near_in_place_and_in_direction():
    """A camera beside another but back to back with it comes after one farther off that looks its
    way.
    """
    row = [looking_at(f"cam{i}", np.array([i, 0, 0.0]), np.array([i, 0, 5.0])) for i in range(4)]
    back = looking_at("back", np.array([-0.4, 0, 0]), np.array([-0.4, 0, -5.0]))

    # the last is back's own choice
    assert set(neighbour_pairs([*row, back], 1)) == {(0, 1), (1, 2), (2, 3), (0, 4)}
    assert len(neighbour_pairs(row, 3)) == 6


class BreakingSource:
    """Frames of which some cannot be read."""

    def __init__(self, n_frames: int, broken: set[int]) -> None:
        self.n_frames, self.broken, self.digest = n_frames, broken, ""
        self.n_started = 0

    def frames(self, start: int, stop: int):
        self.n_started += 1
        for index in range(start, stop):
            if index in self.broken:
                raise CaptureError(f"room/{index:04d}.png: damaged")
            yield make_image(0, index % 10)


def capture_of(source: BreakingSource) -> Capture:
    camera = make_rig()[0]
    return Capture(
        "room",
        "test",
        Path("room"),
        (camera,),
        (source,),
        source.n_frames,
        30.0,
        1.0,
        "given by the user",
    )


def test_reading_goes_on_after_damage():
    """A frame that cannot be read is noted with its message and the frames after it are read."""
    record = record_camera(capture_of(BreakingSource(20, {7})), "cam00")

    assert [(damage.frame, damage.message) for damage in record.damage] == [
        (7, "room/0007.png: damaged")
    ]
    assert record.n_read == 19
    assert np.flatnonzero(np.isnan(record.change)).tolist() == [0, 7, 8]
    assert sorted(record.energy) == [*range(1, 7), *range(9, 20)]


def test_a_ruined_source_ends_soon():
    """Where nothing can be read, a few tries are made, not one per frame."""
    source = BreakingSource(1000, set(range(1000)))

    record = record_camera(capture_of(source), "cam00")

    assert source.n_started < 10
    assert (record.n_read, dict(record.instants), len(record.energy)) == (0, {}, 0)


def test_memory_of_a_record_does_not_grow_with_the_frames():
    """A long capture keeps the motion of its first and last frames, and the colours of a few
    instants all over it.
    """
    picture = np.kron(
        np.random.default_rng(2).integers(30, 220, (6, 8, 3)), np.ones((8, 8, 1))
    ).astype(np.uint8)
    recorder = Recorder("cam00", 1000)
    for frame in range(1000):
        recorder.add(frame, picture)
    record = recorder.record()

    assert list(record.energy) == [*range(1, 384), *range(616, 1000)]
    assert record.sampled == tuple(range(0, 1000, 32))
    assert len(record.colours) == 32
    assert sorted(record.instants) == [0, 500, 999]


def test_units_that_are_guessed_or_absurd_are_remarked_on():
    """A guess is a warning, a number that makes the scene kilometres wide too; a plausible given
    one is ok.
    """
    capture = capture_of(BreakingSource(1, set()))
    four = replace(capture, cameras=tuple(make_rig()), sources=capture.sources * 4)

    (given,), (guess,), (absurd,) = (
        check_scale(four, {}),
        check_scale(replace(four, units_origin="guess: median scene depth taken for 2 m"), {}),
        check_scale(replace(four, units_per_metre=1e-4), {}),
    )

    assert (given.verdict, guess.verdict, absurd.verdict) == ("ok", "warn", "warn")
    assert given.values["median_depth_m"] == pytest.approx(4.0)
    assert given.values["spacing_m"] == pytest.approx(np.hypot(0.3, 0.1), abs=1e-3)


def test_noise_out_of_the_ordinary_is_remarked_on(tmp_path):
    """A camera with three times the rig's noise is warned of, one above the limit is bad."""
    record = record_camera(open_capture(write_dynerf(tmp_path / "room")), "cam00")
    records = [
        replace(record, name=f"cam{i}", noise_sigma_255=sigma)
        for i, sigma in enumerate((1.0, 1.1, 3.2, 1.0, 14.0))
    ]

    assert [finding.verdict for finding in check_noise(records)] == [
        "ok",
        "ok",
        "ok",
        "warn",
        "ok",
        "bad",
    ]


def test_verdicts_are_ordered_by_harm():
    """Bad outweighs warn, which outweighs unknown, which outweighs ok; limits belong to the better
    side.
    """
    findings = tuple(Finding("rig", "q", verdict, "") for verdict in ("ok", "unknown", "warn"))

    assert worst(findings) == "warn"
    assert worst(findings[:2]) == "unknown"
    assert worst(()) == "ok"
    assert [graded(value, 1, 2) for value in (1.0, 1.5, 2.0, 2.1)] == ["ok", "warn", "warn", "bad"]


def test_the_table_names_only_cameras_that_deviate():
    """One line per question with its worst verdict; below it the odd cameras, those with one answer
    together.
    """
    check = CaptureCheck(
        Path("room"),
        (
            Finding("rig", "frames", "ok", "3 cameras"),
            *(
                Finding(name, "frames", "ok", "24 frames read")
                for name in ("cam00", "cam01", "cam02")
            ),
            Finding("rig", "time offset", "ok", "largest 2 frames"),
            Finding("cam00", "time offset", "unknown", "no motion"),
            Finding("cam01", "time offset", "unknown", "no motion"),
            Finding("cam02", "time offset", "bad", "2 frames ahead", {}, "shift it"),
        ),
    )

    lines = [line.split() for line in check.table().splitlines()[2:]]

    assert lines == [
        ["frames", "ok", "3", "cameras"],
        ["time", "offset", "BAD", "largest", "2", "frames"],
        ["bad", "cam02", "2", "frames", "ahead", "shift", "it"],
        ["unknown", "cam00,", "cam01", "no", "motion"],
    ]
    assert not check.is_usable


def test_a_damaged_image_in_a_folder_is_named(tmp_path):
    """An image file full of zeros becomes a finding with its name; the frames after it are read."""
    folder = tmp_path / "room"
    write_folders(folder)
    write_poses(folder, make_rig())
    file = folder / "cam01" / "images" / "0002.png"
    content = bytearray(file.read_bytes())
    content[60:] = bytes(len(content) - 60)
    file.write_bytes(bytes(content))

    found = {finding.subject: finding for finding in check_capture(folder).of("frames")}

    assert found["cam01"].verdict == "bad"
    assert "0002.png" in found["cam01"].measured
    assert found["cam01"].values == {"n_read": 4, "damaged": [2]}
    assert [found[name].verdict for name in ("cam00", "cam02", "cam03")] == ["ok"] * 3


def test_black_frames_are_named(tmp_path):
    """A frame without light is a warning of its camera."""
    folder = write_folders(tmp_path / "room")
    write_poses(folder, make_rig())
    capture = open_capture(folder)
    name = capture.camera_names[1]
    file = folder / name / "images" / "0000.png"
    write_image(file, np.zeros_like(make_image(1, 0)))

    records = [record_camera(capture, each) for each in capture.camera_names]
    findings = {finding.subject: finding for finding in check_frames(capture, records)}

    assert [record.black for record in records] == [
        (0,) if each == name else () for each in capture.camera_names
    ]
    assert (findings[name].verdict, findings[name].measured) == ("warn", "frame 0 all zero")
    assert findings[capture.camera_names[0]].verdict == "ok"


@pytest.mark.slow
def test_few_scattered_matches_accuse_no_camera():
    """Clean small views whose features scatter by .8 px: no camera of 10 rigs is warned of; one
    turned by 3 px is.
    """
    cameras = [camera.resized(80, 60) for camera in make_cameras()]
    turn = np.eye(4)
    turn[1:3, 1:3] = [[np.cos(0.06), -np.sin(0.06)], [np.sin(0.06), np.cos(0.06)]]
    turned = [
        *cameras[:2],
        replace(cameras[2], world_to_camera=turn @ cameras[2].world_to_camera),
        *cameras[3:],
    ]

    def warned_of(rig: list[Camera], seed: int, scatter_px: float) -> set[str]:
        rng, pairs = np.random.default_rng(seed), []
        for first, second in neighbour_pairs(cameras):
            points = rng.uniform((-3, -2, 5), (3, 2, 10), (25, 3))
            uv = [
                cameras[index].project(points)[0] + rng.normal(0, scatter_px, (25, 2))
                for index in (first, second)
            ]
            pairs.append(MatchedPair(first, second, *uv, *np.full((2, 25, 3), 100, np.float32)))
        findings = check_epipolar(rig, [None] * len(rig), pairs).findings
        return {finding.subject for finding in findings if finding.verdict in ("warn", "bad")}

    assert set().union(*(warned_of(cameras, seed, 0.8) for seed in range(10))) == set()
    assert warned_of(turned, 0, 0.5) == {"cam02"}
