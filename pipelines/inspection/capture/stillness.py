"""Movement of fixed cameras: whether one moved, by how much and when."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from ggvs_eval.arrays import Array
from ggvs_eval.camera import Camera
from ggvs_eval.finding import RIG, Finding, graded
from ggvs_eval.geometry.epipolar import Features, match_features
from ggvs_eval.pipelines.inspection.capture.records import (
    FEWEST_CORNERS,
    CameraRecord,
    fit_similarity,
    robust_sigma,
)

QUESTION = "stands still"
# Of the picture, pixels and share of the longer side: what a calibration is good for, and what no
# method can make good again.
WARN_PX, BAD_PX = 1.0, 3.0
WARN_SHARE, BAD_SHARE = 0.0015, 0.004
# Corners are found to a twentieth of a pixel; the codec's key frames and a breath of wind move them
# by as much.
LEAST_SIGMA_PX = 0.05
SIGMAS = 3.0
# A movement begins and ends where this share of it is left to do, or done.
BEGUN, DONE = 0.15, 0.85
ADVICE = "calibrate it again from its static frames, and evaluate only those; or drop this camera"


def check_stillness(
    cameras: Sequence[Camera], records: Sequence[CameraRecord], fps: float = 0.0
) -> tuple[Finding, ...]:
    """Displacement of each picture within the clip, by what stands in it.

    Args:
        fps: frames per second, to give times in seconds too.
    """
    evaluated = [
        _evaluate(camera, record, fps) for camera, record in zip(cameras, records, strict=True)
    ]
    moved = [finding for finding in evaluated if "moved_px" in finding.values]
    if not moved:
        reason = (
            evaluated[0].measured
            if len({finding.measured for finding in evaluated}) == 1
            else "too little of the pictures is static"
        )
        return (
            Finding(subject=RIG, question=QUESTION, verdict="unknown", measured=reason),
            *evaluated,
        )
    sizes = [finding.values["moved_px"] for finding in moved]
    odd = [finding for finding in moved if finding.verdict != "ok"]
    text = (
        f"largest displacement {max(sizes):.2f} px, median {np.median(sizes):.2f} px, "
        f"{len(moved)} cameras"
    )
    values = {"largest_px": max(sizes), "n_moved": len(odd)}
    if len(odd) > max(len(moved) / 2, 1):
        advice = "a moving rig, or stabilised videos? poses of one instant are wrong for others"
        return (
            Finding(
                subject=RIG,
                question=QUESTION,
                verdict="warn",
                measured=f"{len(odd)} of {len(moved)} cameras move; {text}",
                values=values,
                advice=advice,
            ),
            *evaluated,
        )
    return (
        Finding(subject=RIG, question=QUESTION, verdict="ok", measured=text, values=values),
        *evaluated,
    )


def _evaluate(camera: Camera, record: CameraRecord, fps: float) -> Finding:
    shifts = record.shifts_px
    frames = np.flatnonzero(np.isfinite(shifts).all(axis=1))
    if record.n_read < 2:
        return Finding(
            subject=camera.name,
            question=QUESTION,
            verdict="unknown",
            measured="fewer than two frames",
        )
    if lost := _lost(camera, record, frames):
        return lost
    if len(frames) < max(2, record.n_read / 2):
        return Finding(
            subject=camera.name,
            question=QUESTION,
            verdict="unknown",
            measured="too little of the picture is static",
        )
    series = median_filter(shifts[frames], size=(min(3, len(frames)), 1), mode="nearest")
    sizes = np.linalg.norm(series, axis=1)
    farthest = int(sizes.argmax())
    size, sigma = float(sizes[farthest]), shift_sigma(series)
    verdict = graded(size, *limits_px(camera)) if size > SIGMAS * sigma else "ok"
    values = _values(camera, series[farthest], SIGMAS * sigma)
    if verdict == "ok":
        return Finding(
            subject=camera.name,
            question=QUESTION,
            verdict="ok",
            measured=f"{size:.2f} +- {SIGMAS * sigma:.2f} px at most",
            values=values,
        )
    begun = int(np.flatnonzero(sizes > max(BEGUN * size, SIGMAS * sigma))[0])
    end = int(np.flatnonzero(sizes >= DONE * size)[0])
    # The middle of a jump can be lost to the median filter; the frames themselves say when.
    raw = np.linalg.norm(shifts[frames], axis=1)
    while begun > 0 and raw[begun - 1] > 0.5 * size:
        begun -= 1
    values |= {"first_frame": int(frames[begun]), "last_frame": int(frames[max(begun, end)])}
    when = describe_when(values["first_frame"], values["last_frame"], fps)
    how = _describe(series[farthest], camera)
    back = " and came back" if sizes[-1] < 0.3 * size else ""
    text = f"moved by {size:.1f} +- {SIGMAS * sigma:.1f} px {when}{back} ({how})"
    return Finding(
        subject=camera.name,
        question=QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=ADVICE,
    )


def limits_px(camera: Camera) -> tuple[float, float]:
    """Displacements above which a camera is warned of, and above which it is bad, pixels."""
    longest = max(camera.size)
    return max(WARN_PX, WARN_SHARE * longest), max(BAD_PX, BAD_SHARE * longest)


def shift_sigma(series: Array) -> float:
    """Return the standard error of a displacement, pixels, by how it scatters from frame to
    frame.
    """
    steps = np.diff(series, axis=0)
    scatter = [robust_sigma(column) / np.sqrt(2) for column in steps.T] if len(steps) else [0.0]
    return max(float(np.linalg.norm(scatter)), LEAST_SIGMA_PX)


def describe_when(first: int, last: int, fps: float = 0.0) -> str:
    """Return a time in frames and seconds.

    Examples:
        >>> describe_when(7, 7, 30), describe_when(7, 12)
        ('at frame 7 (0.23 s)', 'from frame 7 to 12')
    """
    frames = f"at frame {first}" if last - first <= 1 else f"from frame {first} to {last}"
    return frames + (f" ({first / fps:.2f} s)" if fps else "")


def _lost(camera: Camera, record: CameraRecord, frames: NDArray[np.intp]) -> Finding | None:
    """Return a camera whose picture was lost in mid-clip: features say whether it moved far.

    None if they, too, are silent.
    """
    first, *later = record.instants.items()
    last_seen = int(frames[-1]) if len(frames) else 0
    for frame, features in later:
        if frame <= last_seen + 1:
            continue
        shift = _shift_between(first[1], features, camera)
        if shift is None or np.linalg.norm(shift) < limits_px(camera)[1]:
            continue
        size = float(np.linalg.norm(shift))
        values = _values(camera, shift, size / 10) | {
            "first_frame": last_seen + 1,
            "last_frame": frame,
        }
        text = (
            f"moved by {size:.0f} px between frames {last_seen} and {frame} "
            f"({_describe(shift, camera)})"
        )
        return Finding(
            subject=camera.name,
            question=QUESTION,
            verdict="bad",
            measured=text,
            values=values,
            advice=ADVICE,
        )
    return None


def _shift_between(first: Features, second: Features, camera: Camera) -> Array | None:
    matches = match_features(first, second)
    middle, radius = np.array(camera.size) / 2, np.hypot(*camera.size) / 2 / np.sqrt(3)
    if len(matches) < 2 * FEWEST_CORNERS:
        return None
    motion, inliers = fit_similarity(
        first.uv[matches[:, 0]] - middle, second.uv[matches[:, 1]] - middle
    )
    if motion is None or inliers < len(matches) / 2:
        return None
    zoom, turn = np.hypot(*motion[:, 0]) - 1, np.arctan2(motion[1, 0], motion[0, 0])
    return np.array([*motion[:, 2], turn * radius, zoom * radius])


def _values(camera: Camera, shift: Array, half_width: float) -> dict[str, Any]:
    radius = np.hypot(*camera.size) / 2 / np.sqrt(3)
    return {
        "moved_px": round(float(np.linalg.norm(shift)), 3),
        "half_width_px": round(float(half_width), 3),
        "right_px": round(float(shift[0]), 3),
        "down_px": round(float(shift[1]), 3),
        "turn_deg": round(float(np.degrees(shift[2] / radius)), 4),
        "zoom": round(float(1 + shift[3] / radius), 5),
    }


def _describe(shift: Array, camera: Camera) -> str:
    """Return the largest part of a displacement in words."""
    values: Mapping[str, Any] = _values(camera, shift, 0.0)
    part = int(np.abs([np.linalg.norm(shift[:2]), *shift[2:]]).argmax())
    sideways = (
        f"{abs(shift[0]):.1f} px {'right' if shift[0] > 0 else 'left'}, {abs(shift[1]):.1f} px "
        f"{'down' if shift[1] > 0 else 'up'}"
    )
    return (
        sideways,
        f"turned by {values['turn_deg']:.2f} deg",
        f"zoomed by x {values['zoom']:.3f}",
    )[part]
