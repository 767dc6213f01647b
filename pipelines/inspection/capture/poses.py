"""Poses - rotations, doubles, whether the cameras look at one scene the same way up - and
intrinsics against size and rig.
"""

from collections.abc import Collection, Iterable, Sequence

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.datasets.units import nearest_to_rays
from ggvs_eval.finding import RIG, Finding, Verdict, graded

POSES_QUESTION = "poses"
# Rotations stored as 32-bit numbers are off by 1e-6; more is rounding in a text file, or no
# rotation.
SLANTED = 1e-3
# Two cameras nearer than this share of the rig's extent are one camera twice.
SAME_PLACE_SHARE = 1e-4
# Hand-held and mounted cameras differ by some 30 degrees in roll; beyond 90 a picture is upside
# down.
ROLLED_RAD, UPSIDE_DOWN_RAD = np.radians(45), np.radians(120)
# Axes within this angle are as good as parallel: they meet nowhere, and agree by pointing the same
# way.
PARALLEL_RAD = np.radians(3)
TURNED_AWAY_RAD = np.radians(90)
ITERATIONS = 20
INTRINSICS_QUESTION = "intrinsics"
# Lenses centre within a few percent; a quarter means a cropped picture or another picture's
# calibration.
WARN_OFF_CENTRE, BAD_OFF_CENTRE = 0.1, 0.25
# Square pixels, up to the rounding of a resize; users of anamorphic lenses know of them.
WARN_ASPECT, BAD_ASPECT = 0.01, 0.05
NARROWEST_DEG, WIDEST_DEG = 10.0, 150.0
# Cameras of one kind differ by 1 % in focal length; 3 % is another lens or a mistake.
ODD_FOCAL = 0.03


def check_poses(cameras: Sequence[Camera], doubtful: Collection[int] = ()) -> tuple[Finding, ...]:
    """Evaluate the poses by themselves.

    Args:
        doubtful: indices of cameras whose images contradict their pose; of two at one place they
            are the wrong ones.
    """
    target = look_at_point(cameras)
    away = away_angles(cameras, target)
    rolls = roll_angles(cameras)
    doubles = [
        [double for double in candidates if index in doubtful or double not in doubtful]
        for index, candidates in enumerate(same_places(cameras))
    ]
    n_outside = int(
        sum(angle > half_view_rad(camera) for angle, camera in zip(away, cameras, strict=True))
    )
    # Without a common region no camera looks away from it.
    away_known = away if n_outside <= len(cameras) / 3 else np.zeros(len(cameras))
    evaluated = [
        _evaluate_pose(
            camera,
            float(away_known[index]),
            float(rolls[index]),
            [cameras[double].name for double in doubles[index]],
        )
        for index, camera in enumerate(cameras)
    ]
    values = {
        "extent": round(rig_extent(cameras), 4),
        "target": None if target is None else target.round(4).tolist(),
    }
    gaze = (
        "face the same direction"
        if target is None
        else f"look at one region, {np.degrees(np.median(away)):.0f} deg off at the median"
    )
    if n_outside > len(cameras) / 3:
        text = (
            f"no common region: {n_outside} of {len(cameras)} cameras do not see the common point"
        )
        advice = (
            "a moving or outward-looking camera? else the poses may be inverted or in other axes"
        )
        return (
            Finding(
                subject=RIG,
                question=POSES_QUESTION,
                verdict="warn",
                measured=text,
                values=values,
                advice=advice,
            ),
            *evaluated,
        )
    return (
        Finding(
            subject=RIG,
            question=POSES_QUESTION,
            verdict="ok",
            measured=f"{len(cameras)} cameras {gaze}, right-handed",
            values=values,
        ),
        *evaluated,
    )


def look_at_point(cameras: Sequence[Camera]) -> Array | None:
    """Return the point that most viewing axes pass near, (3,); None if they are parallel.

    Reading:
        The sum of distances to the axes is minimised (reweighted least squares), so that one camera
        that looks elsewhere does not pull the point to itself.
    """
    axes, centres = (
        np.stack([camera.axis for camera in cameras]),
        np.stack([camera.centre for camera in cameras]),
    )
    if np.median(np.arccos(np.clip(axes @ _median_direction(axes), -1, 1))) < PARALLEL_RAD / 2:
        return None
    weights: Array | float = 1.0
    for _ in range(ITERATIONS):
        point = nearest_to_rays(centres, axes, weights)
        distance = np.linalg.norm(np.cross(point - centres, axes), axis=1)[:, None, None]
        weights = 1 / np.maximum(distance, 1e-3 * max(rig_extent(cameras), 1e-9))
    return point


def away_angles(cameras: Sequence[Camera], target: Array | None) -> Array:
    """Angle between each viewing axis and the direction to the common point (or the common
    direction), radians, (N,).
    """
    axes, centres = (
        np.stack([camera.axis for camera in cameras]),
        np.stack([camera.centre for camera in cameras]),
    )
    if target is None:
        cosines = axes @ _median_direction(axes)
    else:
        towards = target - centres
        cosines = (axes * towards).sum(axis=1) / np.maximum(np.linalg.norm(towards, axis=1), 1e-12)
    return np.asarray(np.arccos(np.clip(cosines, -1, 1)))


def roll_angles(cameras: Sequence[Camera]) -> Array:
    """Return the angle in each picture between its downward axis and the rig's common down,
    radians, (N,).

    Only the turn about the viewing axis counts: cameras on opposite sides that look down at the
    scene have different downward axes and are not rolled. One that looks along the common down gets
    0.
    """
    axes, downs = (np.stack([camera.rotation[row] for camera in cameras]) for row in (2, 1))
    common = _median_direction(downs)
    down_in_picture = common - axes * (axes @ common)[:, None]  # the common down in each picture
    length = np.linalg.norm(down_in_picture, axis=1)
    cosines = (down_in_picture * downs).sum(axis=1) / np.maximum(length, 1e-12)
    return np.where(length > 0.2, np.arccos(np.clip(cosines, -1, 1)), 0.0)


def same_places(cameras: Sequence[Camera]) -> list[list[int]]:
    """For each camera the others at the same place."""
    centres = np.stack([camera.centre for camera in cameras])
    distances = np.linalg.norm(centres[:, None] - centres[None], axis=-1)
    is_same_place = distances <= SAME_PLACE_SHARE * rig_extent(cameras)
    np.fill_diagonal(is_same_place, False)
    return [list(np.flatnonzero(row)) for row in is_same_place]


def rig_extent(cameras: Iterable[Camera]) -> float:
    """Return the largest distance between two centres, world units."""
    centres = np.stack([camera.centre for camera in cameras])
    return float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max())


def half_view_rad(camera: Camera) -> float:
    """Return the angle between the viewing axis and the corners of the picture, radians."""
    return float(np.arctan(np.hypot(*camera.size) / 2 / camera.focal_px))


def _evaluate_pose(camera: Camera, away_rad: float, roll_rad: float, doubles: list[str]) -> Finding:
    slant = max(
        camera.deviation, float(np.abs(camera.rotation @ camera.rotation.T - np.eye(3)).max())
    )
    values = {
        "away_deg": round(np.degrees(away_rad), 2),
        "roll_deg": round(np.degrees(roll_rad), 2),
        "not_orthonormal": slant,
    }
    away, roll = f"{np.degrees(away_rad):.0f} deg", f"{np.degrees(roll_rad):.0f} deg"
    verdict: Verdict = "warn"
    if doubles:
        verdict, text = "bad", f"same place as {', '.join(doubles)}"
        advice = "one pose was written twice; restore this camera's own or drop it"
    elif away_rad > TURNED_AWAY_RAD:
        verdict, text = "bad", f"looks away from the others' scene, by {away}"
        advice = "mirrored or inverted pose? check axes and handedness"
    elif roll_rad > UPSIDE_DOWN_RAD:
        text, advice = (
            f"upside down against the others, by {roll}",
            "mounted upside down? else its y axis is inverted",
        )
    elif away_rad > half_view_rad(camera):
        text = f"the others' common point is outside its picture, {away} off its axis"
        advice = "check that it films the same scene"
    elif roll_rad > ROLLED_RAD:
        text, advice = (
            f"rolled by {roll} against the others",
            "check that its frames are turned like its pose",
        )
    elif slant > SLANTED:
        text, advice = (
            f"rotation off by {slant:.1e}, the nearest one is used",
            "store poses with more digits",
        )
    else:
        verdict, text, advice = "ok", f"{away} off the common point", ""
    return Finding(
        subject=camera.name,
        question=POSES_QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )


def _median_direction(directions: Array) -> Array:
    """Return the unit vector with the least sum of distances to some.

    A minority that points elsewhere does not pull it away.
    """
    mean = directions.mean(axis=0)
    for _ in range(ITERATIONS):
        weights = 1 / np.maximum(np.linalg.norm(directions - mean, axis=1), 1e-6)
        mean = (directions * weights[:, None]).sum(axis=0) / weights.sum()
    return np.asarray(mean / max(float(np.linalg.norm(mean)), 1e-12))


def check_intrinsics(cameras: Sequence[Camera]) -> tuple[Finding, ...]:
    """Evaluate each camera's intrinsics."""
    relative = np.array([camera.focal_px / max(camera.size) for camera in cameras])
    typical = float(np.median(relative))
    # A rig of mixed lenses has no typical one, so none is odd in it.
    is_uniform = (
        float(np.median(np.abs(relative / typical - 1))) < ODD_FOCAL / 2 and len(cameras) > 2
    )
    evaluated = [
        _evaluate_intrinsics(camera, float(value / typical) if is_uniform else 1.0)
        for camera, value in zip(cameras, relative, strict=True)
    ]
    views = [fields_of_view_deg(camera)[0] for camera in cameras]
    values = {
        "fov_deg": [round(min(views), 2), round(max(views), 2)],
        "one_kind_of_lens": is_uniform,
    }
    text = (
        f"horizontal field of view {min(views):.1f} .. {max(views):.1f} deg, focal "
        f"{typical:.3f} of the longer side"
    )
    return (
        Finding(
            subject=RIG, question=INTRINSICS_QUESTION, verdict="ok", measured=text, values=values
        ),
        *evaluated,
    )


def fields_of_view_deg(camera: Camera) -> tuple[float, float]:
    """Return the horizontal and vertical field of view, degrees, through the image centre."""
    horizontal = np.degrees(2 * np.arctan(camera.width / 2 / camera.K[0, 0]))
    return float(horizontal), float(np.degrees(2 * np.arctan(camera.height / 2 / camera.K[1, 1])))


def off_centre(camera: Camera) -> float:
    """Distance of the principal point from the image centre along the axis where it is larger, as a
    share of that side.
    """
    return float(np.abs(camera.K[:2, 2] / np.array(camera.size) - 0.5).max())


def _evaluate_intrinsics(camera: Camera, focal_ratio: float) -> Finding:
    off, ratio, view = (
        off_centre(camera),
        float(camera.K[0, 0] / camera.K[1, 1]),
        fields_of_view_deg(camera)[0],
    )
    values = {
        "off_centre": round(off, 4),
        "fx_over_fy": round(ratio, 4),
        "fov_deg": round(view, 2),
        "focal_ratio": round(focal_ratio, 4),
    }
    verdict: Verdict = "warn"
    if off > WARN_OFF_CENTRE:
        verdict, text = (
            graded(off, WARN_OFF_CENTRE, BAD_OFF_CENTRE),
            f"principal point {100 * off:.0f} % of the side off centre",
        )
        advice = "cropped frames? shift the principal point too"
    elif abs(ratio - 1) > WARN_ASPECT:
        verdict, text = graded(abs(ratio - 1), WARN_ASPECT, BAD_ASPECT), f"fx / fy = {ratio:.3f}"
        advice = (
            "calibrated for frames of another aspect? scale both axes; by COLMAP? 'calibrate "
            "--camera-model SIMPLE_RADIAL'"
        )
    elif not NARROWEST_DEG < view < WIDEST_DEG:
        text, advice = (
            f"horizontal field of view {view:.0f} deg",
            "focal length in pixels of another size?",
        )
    elif abs(focal_ratio - 1) > ODD_FOCAL:
        text, advice = (
            f"focal length x {focal_ratio:.3f} of the rig's median",
            "another lens? else see the epipolar error",
        )
    else:
        verdict, text, advice = "ok", f"field of view {view:.1f} deg", ""
    return Finding(
        subject=camera.name,
        question=INTRINSICS_QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )
