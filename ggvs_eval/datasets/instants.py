"""One index shows one instant in all cameras: by the times of frames or the numbers of pictures,
else by their order.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.capture import Extras, FrameSource, source_chain
from ggvs_eval.capture_edit import picked, picked_extras
from ggvs_eval.datasets.frames import ImageFrames, video_of
from ggvs_eval.datasets.media import match_cameras
from ggvs_eval.errors import CaptureError, OutOfStepError
from ggvs_eval.files.listing import list_files_below
from ggvs_eval.files.names import Fields, Number, is_stamp, listed, over_midnight
from ggvs_eval.files.time_tables import TABLES, Rows, number_in, read_rows, times_in
from ggvs_eval.files.video import VideoFrames

# Image folders do not say their rate; every capture published in this layout was recorded at this
# one.
FOLDER_FPS = 30.0
# Of constant rates that are one: what averages are rounded by, a fifth of what 29.97 is off 30.
LARGEST_DIFFERENCE = 2e-4
LARGEST_LAG = 0.5  # steps between frames of one instant: farther off, the next frame is nearer
SAME_TIME = 1e-3  # steps that rounded times are off
LONGEST_STEP_S = 2.0
PARTS_S = (3600, 60, 1, 1)  # of a timecode; the last counts frames
GAP_STEPS = 1.5  # at twice a step a frame is missing

TIMES = re.compile(r"time|stamp|sync", re.I)
DEEPEST = 2
CAMERA = re.compile(r"cam|device|view|port|serial", re.I)  # columns
PAIRING_FILE = "pair_by_time.txt"


def write_pairing(path: Path) -> Path:
    """Write the file in a capture that makes all commands pair its frames by time, and
    return it.
    """
    file = (path if path.is_dir() else path.parent) / PAIRING_FILE
    file.write_text(
        "Frames of this capture are paired by the times in its videos, or by their timecodes; "
        "without this file by number.\n",
        encoding="utf-8",
    )
    return file


class Aligned(NamedTuple):
    """Cameras whose frames of one index are of one instant.

    Attributes:
        sources: of the cameras by name, of equally many frames.
        extras: of the cameras in their order, or none.
        fps: frames per second; 0 of one frame.
        tables: what says when the frames were taken, paths relative to the capture.
    """

    sources: Mapping[str, FrameSource]
    extras: Sequence[Extras]
    fps: float
    notes: Sequence[str]
    tables: Sequence[str] = ()


def align_instants(
    path: Path,
    sources: Mapping[str, FrameSource],
    extras: Sequence[Extras] = (),
    fps: float | None = None,
) -> Aligned:
    """Bring frames of one instant under one index, masks and depth with them, and note what that
    leaves out.

    Args:
        path: of the capture; tables of times may lie there.
        fps: frames per second where that is known.

    Raises:
        CaptureError: no instant that all cameras have; without times also unequal numbers of
            frames, or rates.

    Reading:
        Times go first, those of a table (`read_times`) before those in the names of pictures: the
        partner of a frame is the nearest of each other camera, at most half a step away. Then the
        numbers in these names, if all cameras have as many; cameras that count from 0 and others
        that count from 1 are taken to begin together. Else frames are in step. Pictures with times
        have the rate of these.
    """
    table = read_times(path, sources)
    instants: Mapping[str, Any] = table.times or _numbers_in_names(sources)
    are_times = bool(table.times) or any(
        is_stamp(number) for numbers in instants.values() for number in numbers
    )
    if not instants or (len(set(map(len, instants.values()))) > 1 and not are_times):
        rate, notes = _common_rate(path, sources, fps)
        return Aligned(sources=sources, extras=extras, fps=rate, notes=[*table.notes, *notes])
    rates = [video.fps if video else FOLDER_FPS for video in _videos(sources).values()]
    if are_times:  # of cameras that begin before and after midnight
        begun = zip(
            instants.items(),
            over_midnight([numbers[0] for numbers in instants.values()]),
            strict=True,
        )
        instants = {
            name: [number + (start - numbers[0]) for number in numbers]
            for (name, numbers), start in begun
        }
    ranges: dict[tuple[Any, ...], list[str]] = {}
    for name, numbers in instants.items():
        ranges.setdefault(tuple(numbers), []).append(name)
    ranges_text = "; ".join(
        f"{listed(names)} from {numbers[0]} to {numbers[-1]}" for numbers, names in ranges.items()
    )
    if (
        {numbers[0] for numbers in ranges} == {0, 1}
        and len({tuple(np.diff(row)) for row in ranges}) == 1
        and not are_times
    ):
        note = (
            f"frames are numbered from 0 in some cameras and from 1 in others, taken to begin "
            f"together: {ranges_text}"
        )
        return Aligned(sources=sources, extras=extras, fps=fps or min(rates), notes=[note])
    start = min(numbers[0] for numbers in ranges)
    places = {
        name: np.array([float(number - start) for number in numbers])
        for name, numbers in instants.items()
    }
    step = min(float(np.median(np.diff(numbers))) for numbers in places.values())
    steps = np.concatenate([np.diff(row) for row in places.values()])
    rate = fps or (
        _rate(float(steps[steps <= GAP_STEPS * step].mean()))
        if are_times and {*rates} == {FOLDER_FPS}
        else min(rates)
    )
    partners = find_partners(places, LARGEST_LAG * step * are_times)
    common = next(iter(partners.values()))
    tables = listed(table.files)
    origin = f"by the {'times' if are_times else 'numbers'} in {tables or 'the names of pictures'}"
    if not common:
        remedy = "number all from one frame on" + f", and move {tables} elsewhere" * bool(tables)
        raise CaptureError(
            f"{path}: wanted cameras with a common instant, {origin}, got {ranges_text}; if they "
            f"begin together, {remedy}"
        )
    left_out = [
        f"{name} {len(row) - len(common)} of {len(row)}"
        for name, row in places.items()
        if len(row) > len(common)
    ]
    notes = (
        [
            f"{len(common)} instants that all cameras have are taken, {origin}; left out: "
            f"{listed(left_out)}"
        ]
        if left_out
        else []
    )
    slowest = min(places, key=lambda name: len(places[name]))
    times = places[slowest]
    gaps = np.flatnonzero(
        np.diff(times[[*partners[slowest]]]) > GAP_STEPS * np.median(np.diff(times))
    )
    notes += [f"time jumps after frame {listed(map(str, gaps))}, {origin}"] if len(gaps) else []
    return Aligned(
        sources={name: picked(source, partners[name]) for name, source in sources.items()},
        extras=[
            picked_extras(extra, partners[name])
            for name, extra in zip(sources, extras, strict=False)
        ],
        fps=rate if len(common) > 1 else 0.0,
        notes=notes,
        tables=table.files,
    )


def _rate(step: float) -> float:
    """Return frames per second by a step of times, in seconds or, where these were more than two,
    in ms, us or ns.
    """
    while step > LONGEST_STEP_S:
        step /= 1000
    return round(1 / step, 2)


def find_partners(places: Mapping[str, Array], tolerance: float) -> dict[str, tuple[int, ...]]:
    """Return the frames of each camera that have a partner in every other camera, the nearest one.

    Args:
        places: when or at which number each frame is, ascending.
        tolerance: largest distance of partners.

    Examples:
        >>> find_partners(
        ...     {"a": np.array([0.0, 1.0, 2.0, 3.0]), "b": np.array([0.1, 1.1, 3.1])}, 0.5
        ... )
        {'a': (0, 1, 3), 'b': (0, 1, 2)}
    """
    reference = min(places.values(), key=len)
    common = np.arange(len(reference))
    nearest = {
        name: np.searchsorted((row[1:] + row[:-1]) / 2, reference) for name, row in places.items()
    }
    for name, indices in nearest.items():
        common = common[np.abs(places[name][indices[common]] - reference[common]) <= tolerance]
        common = common[np.unique(indices[common], return_index=True)[1]]
    return {name: tuple(indices[common].tolist()) for name, indices in nearest.items()}


def _numbers_in_names(sources: Mapping[str, FrameSource]) -> dict[str, tuple[Number, ...]]:
    """Return the numbers of the frames of each camera, none if some have none.

    Those of several fields tell an order only.
    """
    numbers = {}
    for name, source in sources.items():
        *_, files = source_chain(source)
        numbers[name] = (
            files.numbers if isinstance(files, ImageFrames) and files.n_frames > 1 else ()
        )
    is_told = all(len(numbers[name]) == source.n_frames for name, source in sources.items())
    return (
        numbers
        if is_told and not any(isinstance(row[0], Fields) for row in numbers.values())
        else {}
    )


def _common_rate(
    path: Path, sources: Mapping[str, FrameSource], fps: float | None
) -> tuple[float, list[str]]:
    """Return the frame rate of cameras that are in step, 0 of one frame, and a note where it
    varies.

    Args:
        fps: the rate where it is known, whatever files say.

    Raises:
        CaptureError: unequal numbers of frames, constant rates that differ, variable ones where
            frames of one number differ by over half a step: all of it in one line, with the command
            that mends it.

    Reading:
        The average of a variable rate says little: phones that are started together keep step while
        their averages differ, and cameras that each drop a frame have equal ones. So the times of
        equal frame numbers are compared, each camera's counted from its first frame. The command
        writes the lowest rate, which repeats no frame.
    """
    videos = _videos(sources)
    counts = {name: source.n_frames for name, source in sources.items()}
    shortest = min(counts.values())
    rates = {name: video.fps if video else FOLDER_FPS for name, video in videos.items()}
    uneven = [
        f"{name} ({video.uneven})" for name, video in videos.items() if video and video.uneven
    ]
    times_s = {name: video.times_s for name, video in videos.items() if video and uneven}
    is_timed = len(times_s) == len(videos)
    rate = fps or (float(np.mean([*rates.values()])) if uneven else rates[next(iter(rates))])
    lag_s = (
        float(np.ptp(np.stack([times[:shortest] for times in times_s.values()]), axis=0).max())
        if is_timed
        else 0.0
    )
    differ = np.ptp([*rates.values()]) > LARGEST_DIFFERENCE * max(rates.values())
    apart = f"{1000 * lag_s:.1f} ms"
    faults = (
        [f"one frame count for all cameras, got {_shown(counts)}"]
        if len(set(counts.values())) > 1
        else []
    )
    if not fps and (lag_s > LARGEST_LAG / rate or (differ and not is_timed)):
        faults.append(
            f"one frame rate for all cameras, got {_shown(rates)}" + f", {apart} apart" * is_timed
        )
    if faults:
        remedy = (
            f"'ggvs-eval check {path} --repair' takes the span that all have and pairs frames by "
            "time"
        )
        raise OutOfStepError(f"{path}: wanted {'; and '.join(faults)}; {remedy}")
    rule = "frame t of each camera counts as one instant, regardless of its time"
    notes = [
        f"variable frame rate in {listed(uneven)}: {rule}"
        + f"; their times differ by up to {apart}" * is_timed
    ]
    return round(rate, 2) if shortest > 1 else 0.0, notes * (bool(uneven) and not fps) + _late(
        videos, rate
    )


def _late(videos: Mapping[str, VideoFrames | None], fps: float) -> list[str]:
    """A note on timecodes that begin at different frames."""
    starts_s = _starts_s(videos.values())
    frames = [round((start_s - min(starts_s)) * fps) for start_s in starts_s]
    late = [f"{name} {count}" for name, count in zip(videos, frames, strict=False) if count]
    by_time = (
        f"if the clocks were in step, an empty {PAIRING_FILE} in the capture pairs frames by them"
    )
    return (
        [
            f"timecodes begin apart, frames late: {listed(late)}; frames are paired by number: "
            f"{by_time}"
        ]
        if late
        else []
    )


def _starts_s(videos: Collection[VideoFrames | None]) -> list[float]:
    """Return the times of day at which videos begin by their timecodes, seconds.

    None unless all have one.
    """
    starts_s = []
    for video in videos:
        fields = re.findall(r"\d+", video.timecode if video else "")
        if video and len(fields) == len(PARTS_S):
            starts_s.append(
                float(np.dot([*map(int, fields)], [*PARTS_S[:-1], PARTS_S[-1] / video.fps]))
            )
    return starts_s if len(starts_s) == len(videos) else []


def _shown(values: Mapping[str, float]) -> str:
    return listed(f"{name} {round(value, 2):g}" for name, value in values.items())


def _videos(sources: Mapping[str, FrameSource]) -> dict[str, VideoFrames | None]:
    """Return the video of each camera, also behind an undistortion.

    None if its frames are images.
    """
    return {name: video_of(source) for name, source in sources.items()}


class FrameTimes(NamedTuple):
    """When the frames of cameras were taken.

    Attributes:
        times: of each camera in ascending order, (T,), in any unit; none where no table has those
            of all.
        files: that have them, relative to the capture.
        notes: why a table with times is not used.
    """

    times: Mapping[str, Array]
    files: Sequence[str] = ()
    notes: Sequence[str] = ()


def read_times(path: Path, sources: Mapping[str, FrameSource]) -> FrameTimes:
    """Return the times of a table of all cameras, or of one table per camera, up to two levels
    below a capture.

    Reading:
        Where `PAIRING_FILE` says so, the times of videos: since the first frame, or by their
        timecodes if all have one. A table of all cameras has a column that names them and a row per
        frame, or a column per camera. Times ascend; they are the column that is called so, else the
        last one that ascends.
    """
    counts = {name: source.n_frames for name, source in sources.items()}
    if min(counts.values()) < 2:
        return FrameTimes({})
    if (path / PAIRING_FILE).exists():
        return FrameTimes(_video_times(sources), [PAIRING_FILE])
    names = [str(file.relative_to(path)) for file in list_files_below(path, TABLES, DEEPEST)]
    tables = {name: read_rows(path / name) for name in names if TIMES.search(name)}
    of_cameras = match_cameras(counts, tables).names
    candidates = [([name], _of_all(rows, counts)) for name, rows in tables.items()]
    candidates.append(
        (
            [*of_cameras.values()],
            {camera: times_in(tables[name]) for camera, name in of_cameras.items()},
        )
    )
    notes = []
    for files, times in candidates:
        odd = [
            f"{camera} {len(row)} of {counts[camera]} frames"
            for camera, row in times.items()
            if len(row) != counts[camera]
        ]
        if len(times) == len(counts) and not odd:
            return FrameTimes({camera: times[camera] for camera in counts}, files)
        notes += (
            [f"times in {listed(files)} are not used: {listed(odd)}"]
            if odd and all(map(len, times.values()))
            else []
        )
    return FrameTimes({}, notes=notes)


def _video_times(sources: Mapping[str, FrameSource]) -> dict[str, Array]:
    videos = _videos(sources)
    starts_s = _starts_s(videos.values()) or [0.0] * len(videos)
    times_s = [
        video.times_s if video else np.arange(sources[name].n_frames) / FOLDER_FPS
        for name, video in videos.items()
    ]
    return {
        name: start_s + row for name, start_s, row in zip(videos, starts_s, times_s, strict=True)
    }


def _of_all(rows: Rows, cameras: Collection[str]) -> dict[str, Array]:
    """Return the times of each camera in a table of all; none if it is another table."""
    head, *body = rows or [[]]
    of_camera = match_cameras(cameras, head).names
    if len(of_camera) == len(cameras):
        columns = {camera: head.index(name) for camera, name in of_camera.items()}
        return {
            camera: times_in([[row[index]] for row in body if row[index]])
            for camera, index in columns.items()
        }
    if any(number_in(cell) is not None for cell in head):
        head, body = [""] * len(head), rows
    for index in sorted(range(len(head)), key=lambda index: not CAMERA.search(head[index])):
        of_camera = match_cameras(cameras, {row[index] for row in body}).names
        if len(of_camera) == len(cameras):
            return {
                camera: times_in([head, *(row for row in body if row[index] == name)])
                for camera, name in of_camera.items()
            }
    return {}
