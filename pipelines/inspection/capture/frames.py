"""Frames of the cameras: their number, those unreadable or black, and those frozen while other
cameras see things move.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.capture import Capture, source_chain
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.files.video import DEINTERLACE, VideoFrames
from ggvs_eval.finding import RIG, Finding, graded
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord

FRAMES, FROZEN = "frames", "frozen frames"
# A repeated frame differs from its twin by the codec's rounding only; a real one by noise and
# motion.
STILL_SHARE = 0.1
# Below, the picture is static anyway and nothing can be concluded.
LEAST_CHANGE = 1.0
# The other cameras must show at least this share of their usual change at that instant.
MOVING_SHARE = 0.3
BAD_FROZEN = 0.1  # of the frames: a count would call a fault of a long clip bad, of a short one not
LISTED = 6
ENCODED = "-c:v libx264 -crf 12 OUT.mp4"
TO_SDR = (
    "ffmpeg -i IN -vf "
    "zscale=t=linear:npl=100,format=gbrpf32le,zscale=p=bt709,tonemap=mobius,zscale=t=bt709:m=bt709:r=tv,"
    f"format=yuv420p {ENCODED}"
)


def check_frames(capture: Capture, records: Sequence[CameraRecord]) -> tuple[Finding, ...]:
    """Return the counts, sizes, rate, frames that cannot be read, and frames without light."""
    sizes = sorted({camera.size for camera in capture.cameras})
    sizes_text = ", ".join(f"{width} x {height}" for width, height in sizes)
    rate = f"{capture.fps:g} fps" if capture.fps else "one instant"
    text = (
        f"{len(capture.cameras)} cameras, {capture.n_frames} "
        f"frame{'s' * (capture.n_frames > 1)} of {sizes_text}, {rate}"
    )
    values = {
        "layout": capture.layout,
        "n_cameras": len(capture.cameras),
        "n_frames": capture.n_frames,
        "fps": capture.fps,
    }
    values |= {"sizes": [list(size) for size in sizes], "notes": list(capture.notes)}
    text += "".join(f"; {note}" for note in capture.notes)
    outside = frames_outside(capture)
    if outside:
        values["outside"] = {name: str(path) for name, path in outside.items()}
        name, path = next(iter(outside.items()))
        more = f" and of {len(outside) - 1} more" * (len(outside) > 1)
        text += f"; frames of {name}{more} are outside the capture's folder, in {path}"
    advice = (
        ["check that these files are intended; moving the capture breaks the links"]
        if outside
        else []
    )
    inner = {
        name: list(source_chain(source))[-1]
        for name, source in zip(capture.camera_names, capture.sources, strict=True)
    }
    if hdr := {
        name: video.transfer
        for name, video in inner.items()
        if isinstance(video, VideoFrames) and video.transfer
    }:
        values["transfer"] = hdr
        text += (
            f"; levels of {', '.join(list(hdr)[:LISTED])}{', ...' * (len(hdr) > LISTED)} are "
            f"{next(iter(hdr.values()))}"
        )
        text += " (high dynamic range), not those of a display, which metrics need"
        advice.append(f"convert these videos: {TO_SDR}")
    if woven := [
        name for name, video in inner.items() if isinstance(video, VideoFrames) and video.interlaced
    ]:
        values["interlaced"] = woven
        advice.append(f"part the fields of each of these videos: {DEINTERLACE}")
    profiles = {
        name: source.profiles if isinstance(source, ImageFrames) else ()
        for name, source in inner.items()
    }
    if len(set(profiles.values())) > 1:
        values["profiles"] = {name: list(profile) for name, profile in profiles.items()}
        text += "; colour profiles differ: " + ", ".join(
            f"{name} {' '.join(profile) or 'sRGB'}" for name, profile in profiles.items()
        )
        advice.append(
            "convert the pictures to sRGB (magick mogrify -profile sRGB.icc FILES); a gain cannot "
            "correct a profile"
        )
    return (
        Finding(
            subject=RIG,
            question=FRAMES,
            verdict="warn" if advice else "ok",
            measured=text,
            values=values,
            advice="; ".join(advice),
        ),
        *(_evaluate_damage(record, capture.n_frames) for record in records),
    )


def frames_outside(capture: Capture) -> dict[str, Path]:
    """Return the cameras whose frames are outside the capture's folder, and their place.

    Links are followed.
    """
    root = capture.path.resolve()
    root = root.parent if root.is_file() else root
    outside = {}
    for name, source in zip(capture.camera_names, capture.sources, strict=True):
        *_, inner = source_chain(source)  # behind corrections and an undistortion
        files = getattr(inner, "files", None) or [
            path for path in [getattr(inner, "path", None)] if path
        ]
        elsewhere = [path for path in map(Path.resolve, files) if not path.is_relative_to(root)]
        if elsewhere:
            outside[name] = elsewhere[0].parent
    return outside


def check_frozen(records: Sequence[CameraRecord], fps: float) -> tuple[Finding, ...]:
    """Return the frames that repeat the one before, and the rate of the recording where they do so
    periodically.

    Args:
        fps: frames per second of the capture.
    """
    if all(np.isnan(record.change).all() for record in records):
        reason = "fewer than two frames in a row"
        return tuple(
            Finding(subject=subject, question=FROZEN, verdict="unknown", measured=reason)
            for subject in (RIG, *(record.name for record in records))
        )
    change = np.stack([record.change for record in records])  # (N, T)
    frozen, common = frozen_frames(change), common_repeats(change)
    evaluated = [
        _evaluate_frozen(record.name, list(map(int, np.flatnonzero(row))), len(row), fps)
        for record, row in zip(records, frozen, strict=True)
    ]
    if common.any():
        text = (
            f"frames {_listed(list(map(int, np.flatnonzero(common))))} repeat the one before in "
            "all cameras"
        )
        advice = "a converted frame rate? use the original videos"
        return (
            Finding(
                subject=RIG,
                question=FROZEN,
                verdict="warn",
                measured=text,
                values={"frames": np.flatnonzero(common).tolist()},
                advice=advice,
            ),
            *evaluated,
        )
    text = (
        "none"
        if not frozen.any()
        else f"{int(frozen.sum())} in {int(frozen.any(axis=1).sum())} cameras"
    )
    return (
        Finding(
            subject=RIG,
            question=FROZEN,
            verdict="ok",
            measured=text,
            values={"n_frozen": int(frozen.sum())},
        ),
        *evaluated,
    )


def frozen_frames(change: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the frames that repeat the one before while other cameras see things move, (N, T).

    Args:
        change: largest change of each camera and frame, (N, T), NaN where unknown.
    """
    share = _relative(change)
    moving = np.stack([_usual_of_others(share, index) for index in range(len(share))])
    return np.asarray((share < STILL_SHARE) & (moving > MOVING_SHARE))


def common_repeats(change: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return the frames that repeat the one before in every camera, (T,)."""
    share = _relative(change)
    finite = np.isfinite(share)
    return np.asarray(
        finite.any(axis=0)
        & ((share < STILL_SHARE) | ~finite).all(axis=0)
        & (finite.sum(axis=0) > 1)
    )


def _relative(change: NDArray[np.float32]) -> NDArray[np.float64]:
    """Return the change as a share of each camera's usual one.

    NaN for cameras in which nothing ever moves.
    """
    usual = np.array(
        [np.median(row[np.isfinite(row)]) if np.isfinite(row).any() else np.nan for row in change],
        np.float64,
    )
    usual[~(usual >= LEAST_CHANGE)] = np.nan
    return change / usual[:, None]


def _usual_of_others(share: NDArray[np.float64], index: int) -> NDArray[np.float64]:
    """Return the median over the other cameras, (T,).

    NaN, which is above nothing, where none of them is known.
    """
    other_shares = np.delete(share, index, axis=0)
    finite = np.isfinite(other_shares).any(axis=0)
    middle = np.full(share.shape[1], np.nan)
    middle[finite] = np.nanmedian(other_shares[:, finite], axis=0)
    return middle


def _evaluate_damage(record: CameraRecord, n_frames: int) -> Finding:
    values = {"n_read": record.n_read, "damaged": [damage.frame for damage in record.damage]}
    if not record.damage and record.black:
        values["black"] = list(record.black)
        frames = f"frame{'s' * (len(record.black) > 1)} {_listed(list(record.black))}"
        advice = "a lens cap, or a damaged recording? exclude these instants from the protocol"
        return Finding(
            subject=record.name,
            question=FRAMES,
            verdict="warn",
            measured=f"{frames} all zero",
            values=values,
            advice=advice,
        )
    if not record.damage:
        return Finding(
            subject=record.name,
            question=FRAMES,
            verdict="ok",
            measured=f"{record.n_read} frames read",
            values=values,
        )
    first = record.damage[0]
    text = (
        f"frame {first.frame} cannot be read, {n_frames - record.n_read} of {n_frames} missing: "
        f"{first.message}"
    )
    return Finding(
        subject=record.name,
        question=FRAMES,
        verdict="bad",
        measured=text,
        values=values,
        advice="restore the file, or drop this camera",
    )


def _evaluate_frozen(name: str, frames: list[int], n_frames: int, fps: float) -> Finding:
    values: dict[str, Any] = {"frames": frames}
    if not frames:
        return Finding(subject=name, question=FROZEN, verdict="ok", measured="none", values=values)
    text = (
        f"frames {_listed(frames)} repeat the one before"
        if len(frames) > 1
        else f"frame {frames[0]} repeats the one before"
    )
    if (period := repeat_period(frames, n_frames)) and fps:
        values["recorded_fps"] = fps * (1 - 1 / period)
        stored = (
            f"recorded at {values['recorded_fps']:.4g} frames per second, it seems, and "
            f"stored as {fps:.4g}"
        )
        remedy = "leave the repeats out (then 'check --repair' pairs the frames by time)"
        advice = (
            f"give the original video, or {remedy}: ffmpeg -i IN -vf decimate=cycle={period} "
            f"{ENCODED}"
        )
        return Finding(
            subject=name,
            question=FROZEN,
            verdict="bad",
            measured=f"{stored}: {text}",
            values=values,
            advice=advice,
        )
    verdict = graded(len(frames) / n_frames, 0.0, BAD_FROZEN)
    return Finding(
        subject=name,
        question=FROZEN,
        verdict=verdict,
        measured=text,
        values=values,
        advice="copy or convert this video again",
    )


def repeat_period(frames: Sequence[int], n_frames: int) -> int | None:
    """Return every how many frames one repeats the one before, from end to end of a clip.

    None if they do not so.

    Examples:
        >>> repeat_period([3, 9, 15], 20), repeat_period([3, 9], 20)
        (6, None)
    """
    steps = np.diff(frames)
    if not len(steps):
        return None
    period = round(float(steps.mean()))
    is_even = np.ptp(steps) <= 1 and frames[0] <= period and frames[-1] + period >= n_frames
    return period if is_even and period > 1 else None


def _listed(frames: list[int]) -> str:
    return ", ".join(map(str, frames[:LISTED])) + (", ..." if len(frames) > LISTED else "")
