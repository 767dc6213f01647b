"""The choice of source views: what is never chosen, what a choice does not depend on, and how its
shares follow the target.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.contrib.worlds.film.raycast import (
    GRID_YAW_RAD,
    OUTERMOST_YAW_RAD,
    arc_rig,
    hand_held_poses,
    rig,
)
from ggvs_eval.errors import CameraError
from ggvs_eval.geometry import source_views
from ggvs_eval.geometry.source_views import LEAST_SHARE, choose_sources, sample_view, sees, turn_rad
from ggvs_eval.pipelines.play.playback import camera_loop
from helpers.refusals import refused
from helpers.scenes import camera_at

CHOICES = ("nearest", "coverage")
ALL = (*CHOICES, "triplet")
SIZE, NEAR, FAR = (64, 48), 10.0, 32.0


def covered_share(target, sources):
    """Share of the target's view, over the depths from near to far, that at least one source has in
    its image.
    """
    points = sample_view(target)
    return float(
        np.any(
            [sees(source, points) for source in sources] or [np.zeros(len(points), bool)], axis=0
        ).mean()
    )


def make_rig(shape: str, seed: int = 101) -> list[Camera]:
    """Cameras of a procedural room's rig, or poses of a camera that is carried through it
    and pans.
    """
    if shape == "arc":
        return arc_rig(seed, *SIZE, 12, NEAR, FAR)
    if shape in ("rows", "grid"):
        yaw_rad = OUTERMOST_YAW_RAD if shape == "rows" else GRID_YAW_RAD
        return rig(seed, *SIZE, 8, NEAR, FAR, yaw_rad)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("ggvs_eval.contrib.worlds.film.raycast.AIM_SWAY", 10.0)
        return hand_held_poses(seed, *SIZE, 20, 4.0, NEAR, FAR)


def k_of(how: str) -> int:
    return 3 if how == "triplet" else 4


def names(sources) -> list[str]:
    return [each.camera.name for each in sources]


def shares(sources) -> dict[str, float]:
    return {each.camera.name: each.share for each in sources}


def moved(camera: Camera, rotation: np.ndarray, shift: np.ndarray, scale: float) -> Camera:
    """The same camera in a world that is turned, shifted and scaled."""
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = camera.rotation @ rotation.T
    world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ (scale * rotation @ camera.centre + shift)
    return replace(
        camera, world_to_camera=world_to_camera, near=scale * camera.near, far=scale * camera.far
    )


def turned(camera: Camera, angle_rad: float, name: str) -> Camera:
    """A camera at the same place that looks elsewhere."""
    turn = Rotation.from_euler("y", angle_rad).as_matrix()
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = turn @ camera.rotation
    world_to_camera[:3, 3] = turn @ camera.translation
    return replace(camera, name=name, world_to_camera=world_to_camera)


def value(target: Camera, sources: list[Camera]) -> float:
    """What `coverage` maximises, for one set of sources."""
    worth = np.stack(
        [source_views._worth(target, source, sample_view(target)) for source in sources]
    )
    return float(source_views._values(np.ones((1, len(sources)), bool), worth)[0])


@pytest.mark.parametrize("how", ALL)
@pytest.mark.parametrize("shape", ["rows", "arc", "grid", "walk"])
def test_sources_are_others_nearest_first_and_few(shape, how):
    """Never the target, never twice, nearest first, at most K, shares in (0, 1], and the same
    again.
    """
    cameras = make_rig(shape)
    for target in cameras[::5]:
        chosen = choose_sources(target, cameras, k_of(how), how)
        distances = [np.linalg.norm(each.camera.centre - target.centre) for each in chosen]
        assert target.name not in names(chosen)
        assert 1 <= len(set(names(chosen))) == len(chosen) <= 4
        assert distances == sorted(distances)
        assert all(LEAST_SHARE <= each.share <= 1 for each in chosen)
        assert shares(choose_sources(target, cameras[::-1], k_of(how), how)) == shares(chosen)


def test_nearest_are_the_nearest():
    """`nearest` is the paper's rule, whatever the cameras see."""
    cameras = make_rig("walk")
    for target in cameras:
        assert names(choose_sources(target, cameras, 3)) == [
            each.name for each in nearest_cameras(target, cameras, 3)
        ]


def test_nearest_shares_fall_towards_the_first_camera_that_is_not_chosen():
    """Of cameras 1, 2.8, 3 and 9 away the second has (3 - 2.8) / (0.3 * 3) of its weight: the third
    decides.
    """
    cameras = [camera_at(x) for x in (1.0, 2.8, 3.0, 9.0)]
    chosen = choose_sources(camera_at(0.0, name="target"), cameras[::-1], 2)
    assert shares(chosen) == {"x+1.00": 1.0, "x+2.80": pytest.approx(0.2 / 0.9, abs=1e-6)}


@pytest.mark.parametrize("k", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_coverage_covers_what_nearest_covers(k):
    """By the measure that it maximises it is never worse; by the plain one it is better on average
    and never much worse.
    """
    plain = []
    for shape in ("rows", "arc", "grid", "walk"):
        cameras = make_rig(shape, 102)
        for target in cameras[::4]:
            near, chosen = (
                [each.camera for each in choose_sources(target, cameras, k, how)]
                for how in ("nearest", "coverage")
            )
            assert value(target, chosen) >= value(target, near) - 1e-9
            plain.append(covered_share(target, chosen) - covered_share(target, near))
    assert np.mean(plain) > 0
    assert min(plain) > -0.05


def test_a_panning_camera_gets_sources_that_look_where_it_looks():
    """Of a walk with pans the two nearest places leave half of a view out; chosen ones see it."""
    cameras = make_rig("walk")
    covered = {
        how: [
            covered_share(target, [each.camera for each in choose_sources(target, cameras, 2, how)])
            for target in cameras[::2]
        ]
        for how in CHOICES
    }
    assert min(covered["nearest"]) < 0.5
    assert min(covered["coverage"]) > 0.9


def test_turned_away_cameras_are_never_chosen():
    """A camera beside the target that looks elsewhere is not taken, though fewer than K are left;
    alone it is refused.
    """
    target = make_rig("grid")[0]
    beside = [
        turned(target, angle_rad, f"turned{index}")
        for index, angle_rad in enumerate((1.4, 2.0, np.pi, -1.6))
    ]
    fellow = turned(target, 0.1, "fellow")
    assert min(turn_rad(target, camera) for camera in beside) > source_views.MOST_TURN_RAD
    assert names(choose_sources(target, [target, *beside, fellow], 4, "coverage")) == ["fellow"]
    with refused(CameraError, "4 cameras", "75 degrees"):
        choose_sources(target, [target, *beside], 2, "coverage")


@pytest.mark.parametrize("how", CHOICES)
def test_k_of_k_are_all(how):
    """Where there are no others to choose, all are taken, and all count whole where all are
    of use.
    """
    cameras = make_rig("grid")[:5]
    chosen = choose_sources(cameras[0], cameras, 4, how)
    assert set(names(chosen)) == {camera.name for camera in cameras[1:]}
    assert set(shares(chosen).values()) == {1.0}


@pytest.mark.parametrize("how", ALL)
@given(
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-50, 50)] * 3),
    scale=st.floats(0.01, 100),
    index=st.integers(0, 15),
)
@settings(max_examples=5, deadline=None)
def test_the_world_may_be_turned_shifted_and_scaled(how, turn, shift, scale, index):
    """Neither the choice nor its shares depend on where the world's origin lies and how long its
    unit is.
    """
    rotation, offset = Rotation.from_rotvec(turn).as_matrix(), np.array(shift)
    cameras = make_rig("rows", 103)
    there = [moved(camera, rotation, offset, scale) for camera in cameras]
    here, away = (shares(choose_sources(each[index], each, 3, how)) for each in (cameras, there))
    assert {*here} == {*away}
    np.testing.assert_allclose([away[name] for name in here], list(here.values()), atol=1e-3)


@pytest.mark.parametrize("how", ALL)
@given(
    shape=st.sampled_from(["rows", "arc", "grid"]),
    start=st.integers(0, 58),
    part=st.floats(0, 0.99),
    k=st.integers(2, 4),
)
@settings(max_examples=8, deadline=None)
def test_shares_are_continuous_as_the_target_moves(how, shape, start, part, k):
    """In 1/6000 of the way round no share changes much, that of a camera that comes or goes
    included.
    """
    cameras = make_rig(shape)
    poses = camera_loop(cameras, 60)[start : start + 2]
    k = 3 if how == "triplet" else k
    before, after = (
        shares(choose_sources(between(*poses, place), cameras, k, how))
        for place in (part, part + 0.01)
    )
    assert max(abs(before.get(name, 0) - after.get(name, 0)) for name in {*before, *after}) < 0.1


@pytest.mark.parametrize(
    "how", ["nearest", pytest.param("coverage", marks=pytest.mark.slow), "triplet"]
)
def test_a_view_has_no_share_at_its_exchange(how):
    """Found by bisection: just before and just after the set changes, who goes and who comes have
    the least share.
    """
    cameras = make_rig("rows")
    poses = camera_loop(cameras, 30)
    chosen = [{*names(at(pose, cameras, how))} for pose in poses]
    start = next(index for index in range(29) if chosen[index] != chosen[index + 1])
    low, high = 0.0, 1.0
    for _ in range(16):
        middle = (low + high) / 2
        same = {
            *names(at(between(poses[start], poses[start + 1], middle), cameras, how))
        } == chosen[start]
        low, high = (middle, high) if same else (low, middle)
    before, after = (
        shares(at(between(poses[start], poses[start + 1], place), cameras, how))
        for place in (low, high)
    )
    exchanged = {*before} ^ {*after}
    assert exchanged
    assert all((before | after)[name] <= LEAST_SHARE + 1e-3 for name in exchanged)


def at(target: Camera, cameras: list[Camera], how: str):
    return choose_sources(target, cameras, k_of(how), how)


def between(one: Camera, other: Camera, part: float) -> Camera:
    """A pose on the way from one to another: its centre moves, it looks where the first one
    looks.
    """
    world_to_camera = one.world_to_camera.copy()
    world_to_camera[:3, 3] = -one.rotation @ ((1 - part) * one.centre + part * other.centre)
    return replace(one, world_to_camera=world_to_camera)


@pytest.mark.parametrize("how", ALL)
def test_too_few_cameras_and_unknown_choices_are_refused(how):
    """One line each."""
    cameras = make_rig("grid")[:3]
    with refused(CameraError, "3 source cameras", "2 others"):
        choose_sources(cameras[0], cameras, 3, how)
    with refused(CameraError, "nearest, coverage, triplet", "'covrage'"):
        choose_sources(cameras[0], cameras, 2, "covrage")  # type: ignore[arg-type]


def test_a_camera_covers_itself():
    """The lattice measure: all from the same place, nothing back to back, half from a window of
    half the width.
    """
    camera = make_rig("grid")[0]
    assert covered_share(camera, [camera]) == 1
    assert covered_share(camera, [turned(camera, np.pi, "back")]) == 0
    assert covered_share(
        camera, [camera.cropped(0, 0, camera.width // 2, camera.height)]
    ) == pytest.approx(0.5)
    assert covered_share(camera, []) == 0


def flat_rig(places: list[tuple[float, float]]) -> list[Camera]:
    """Cameras of a plane that look along its normal."""
    first = make_rig("grid")[0]
    pose = np.eye(4)
    rig = []
    for index, (x, y) in enumerate(places):
        pose[:3, 3] = -x, -y, 0
        rig.append(replace(first, name=f"at{index}", world_to_camera=pose.copy()))
    return rig


def test_a_triplet_is_the_triangle_around_the_target():
    """Corners of the triangle, at the middle of which all count whole; at a corner it counts alone;
    outside, the nearest side.
    """
    rig = flat_rig([(0, 0), (3, 0), (0, 3), (9, 8), (-8, -9)])
    target = replace(flat_rig([(1, 1)])[0], name="target")
    assert shares(choose_sources(target, rig, 3, "triplet")) == {"at0": 1.0, "at1": 1.0, "at2": 1.0}
    corner = shares(choose_sources(replace(rig[1], name="target"), rig, 3, "triplet"))
    assert corner["at1"] == 1.0
    assert sorted(corner.values())[:2] == [LEAST_SHARE] * 2
    triangle = rig[:3]
    outside = shares(
        choose_sources(replace(flat_rig([(1.5, -2)])[0], name="target"), triangle, 3, "triplet")
    )
    assert (outside["at0"], outside["at1"]) == pytest.approx((1.0, 1.0))
    assert outside["at2"] == LEAST_SHARE


def test_a_row_of_cameras_has_no_triplets():
    """It is refused with the choice that is left, and so are two sources."""
    row = flat_rig([(index, 0) for index in range(5)])
    with refused(CameraError, "form a triangle", "nearest"):
        choose_sources(row[2], row, 3, "triplet")
    with refused(CameraError, "K = 3", "got 2"):
        choose_sources(make_rig("grid")[0], make_rig("grid"), 2, "triplet")
