"""One index shows one instant in all cameras: by tables of times, numbers and times of pictures,
and times of videos.
"""

import json
import subprocess
from types import SimpleNamespace

import numpy as np
import pytest

from ggvs_eval.capture import Extras
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.instants import align_instants, read_times, write_pairing
from ggvs_eval.files.images import write_image
from ggvs_eval.files.time_tables import read_rows, times_in
from ggvs_eval.files.video import write_video
from helpers.captures import (
    N_FRAMES,
    NAMES,
    make_image,
    make_rig,
    refusal,
    write_poses,
    write_timed_video,
)


def numbered(folder, first):
    """A rig whose camera i has frames from first(i) on; the mark of a frame is its number."""
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        for number in range(first(index), first(index) + N_FRAMES):
            write_image(
                folder / "frames" / name / f"{number:04d}.png", make_image(index, number % 10)
            )
    return folder


def instants(folder, times_s, stem):
    """A rig whose camera i has frames at times_s[i]; the mark of a frame is the second that is
    nearest.
    """
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        for time_s in times_s[index]:
            write_image(
                folder / "frames" / name / f"{stem(time_s)}.png", make_image(index, round(time_s))
            )
    return folder


def clock(time_s):
    """Ten seconds before eleven o'clock, and what follows."""
    minutes, milliseconds = divmod(round(1000 * (time_s + 50)), 60_000)
    return f"2026-05-01_{10 + (59 + minutes) // 60}-{(59 + minutes) % 60:02d}-{milliseconds // 1000:02d}-{milliseconds % 1000:03d}"  # noqa: E501


def night(time_s):
    """Two seconds before midnight, and what follows; without a date."""
    minutes, milliseconds = divmod(round(1000 * (time_s + 86_398)) % 86_400_000, 60_000)
    return f"{minutes // 60:02d}-{minutes % 60:02d}-{milliseconds // 1000:02d}-{milliseconds % 1000:03d}"  # noqa: E501


def assert_in_step(capture, seconds):
    """Every camera shows these seconds, by the marks of its frames."""
    for name in capture.camera_names:
        marks = [int(capture.frame(name, frame)[0, 0, 0]) for frame in range(capture.n_frames)]
        assert marks == [30 + 20 * second for second in seconds], name


# Cameras of one clock that are not triggered together: the second begins later, the third lost the
# fifth second.
FREE = [
    (0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
    (2.1, 2.9, 4.1, 5.2),
    (0.3, 1.3, 2.3, 3.3, 5.3),
    (0.0, 1.0, 2.0, 3.0, 4.0, 5.0),
]


@pytest.mark.parametrize(
    "stem",
    [
        clock,
        night,
        lambda time_s: f"{1.7e9 + time_s:.6f}",
        lambda time_s: f"{10**18 + round(1e9 * time_s)}",
    ],
    ids=["clock", "over midnight", "s", "ns"],
)
def test_times_in_names_align_cameras(tmp_path, stem):
    """The nearest frames are one instant, at the rate of the times; those without a partner are
    left out and counted.
    """
    capture = open_capture(instants(tmp_path / "room", FREE, stem))
    assert capture.fps == pytest.approx(1, abs=0.02)
    assert_in_step(capture, [2, 3, 5])
    note = (
        "3 instants that all cameras have are taken, by the times in the names of pictures; "
        "left out: cam00 3 of 6, cam01 1 of 4"
    )
    assert any(line.startswith(note) for line in capture.notes)
    assert "time jumps after frame 1, by the times in the names of pictures" in capture.notes


def test_times_without_a_common_instant_are_refused(tmp_path):
    """With the range of each; cameras that begin together open once they are numbered from one
    frame on, as the message says.
    """
    times_s = [(0.0, 1.0, 2.0)] * 3 + [(7.0, 8.0, 9.0)]
    message = refusal(instants(tmp_path / "room", times_s, clock))
    assert "wanted cameras with a common instant, by the times in the names of pictures" in message
    assert message.endswith("if they begin together, number all from one frame on")
    for name in NAMES:
        for number, file in enumerate(sorted((tmp_path / "room" / "frames" / name).iterdir())):
            file.rename(file.with_name(f"{number}.png"))
    assert open_capture(tmp_path / "room").n_frames == 3


LONG = "\n".join(
    f"{index},{frame},{100 + time_s:.4f}"
    for index, times in enumerate(FREE)
    for frame, time_s in enumerate(times)
)
WIDE = "\n".join(
    ",".join(f"{times[frame]:.4f}" if frame < len(times) else "" for times in FREE)
    for frame in range(max(map(len, FREE)))
)


@pytest.mark.parametrize(
    "tables",
    [
        {"timestamps.csv": f"cam_id,frame_index,frame_time\n{LONG}"},
        {
            "timestamps.txt": "\n".join(
                f"{NAMES[int(line[0])]} {line[4:]}" for line in LONG.splitlines()
            )
        },
        {"sync/times.txt": f"# {','.join(NAMES)}\n{WIDE}"},
        {"sync.json": json.dumps(dict(zip(NAMES, FREE, strict=True)))},
        {
            "stamps.json": json.dumps(
                [
                    {"camera": NAMES[int(line[0])], "pts": float(line[4:])}
                    for line in LONG.splitlines()
                ]
            )
        },
        {
            f"times/{name}.txt": "\n".join(
                f"{row} {time_s:.4f}" for row, time_s in enumerate(FREE[index])
            )
            for index, name in enumerate(NAMES)
        },
        {
            f"frames/{name}/stamps.csv": "t,stamp\n"
            + "\n".join(f"0,{clock(time_s)}" for time_s in FREE[index])
            for index, name in enumerate(NAMES)
        },
    ],
    ids=[
        "a row per frame",
        "without a head",
        "a column per camera",
        "lists in JSON",
        "tables in JSON",
        "a file per camera",
        "beside the frames",
    ],
)
def test_tables_of_times_align_cameras(tmp_path, tables):
    """Their frames are numbered in each camera for itself; a table that has another number of them
    is named, and not used.
    """
    folder = tmp_path / "room"
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        for number, time_s in enumerate(FREE[index]):
            write_image(
                folder / "frames" / name / f"{number:04d}.png", make_image(index, round(time_s))
            )
    assert "wanted one frame count" in refusal(folder)
    for file, text in tables.items():
        (folder / file).parent.mkdir(exist_ok=True, parents=True)
        (folder / file).write_text(text)
    capture = open_capture(folder)
    assert_in_step(capture, [2, 3, 5])
    assert any(f"by the times in {next(iter(tables))}" in note for note in capture.notes)
    assert not any("not used" in note for note in capture.notes)
    (note,) = read_times(folder, sources(5)).notes
    assert note.endswith(
        "are not used: cam00 6 of 5 frames, cam01 4 of 5 frames, cam03 6 of 5 frames"
    )


@pytest.mark.parametrize(
    "tables",
    [
        {"timestamps.txt": ""},
        {"sync.csv": "cam00,cam01,cam02,cam03\n"},
        {"times.csv": "cam00,cam01,cam02,cam03\n1,inf,nan,1\n2,inf,nan,2\n"},
        {f"{name}_timestamps.txt": "" for name in NAMES},
    ],
)
def test_tables_without_times_say_nothing(tmp_path, tables):
    """Empty files, heads alone, and numbers that are none."""
    for name, text in tables.items():
        (tmp_path / name).write_text(text)

    assert read_times(tmp_path, sources(2)).times == {}


def test_times_in_arrays(tmp_path):
    """One per frame, or with the frames' numbers, whichever way the array lies."""
    times_s = np.array([0.0, 0.1, 0.3])
    for index, values in enumerate(
        (times_s, np.stack([[1, 2, 3], times_s]), np.stack([[1, 2, 3], times_s], axis=1))
    ):
        np.save(tmp_path / f"{index}.npy", values)
        assert times_in(read_rows(tmp_path / f"{index}.npy")).tolist() == times_s.tolist()


def test_masks_and_depth_stay_with_their_frames(tmp_path):
    """What belongs to a frame that is left out is left out."""
    folder = instants(tmp_path / "room", FREE, clock)
    sources = open_capture(folder).sources
    files = {name: source.source for name, source in zip(NAMES, sources, strict=True)}
    aligned = align_instants(folder, files, [Extras(mask=source) for source in files.values()])
    for source, extras in zip(aligned.sources.values(), aligned.extras, strict=True):
        assert np.array_equal(
            np.stack([*source.frames(0, 3)]), np.stack([*extras.mask.frames(0, 3)])
        )


def sources(n_frames):
    """Cameras of a number of frames."""
    return {name: SimpleNamespace(n_frames=n_frames) for name in NAMES}


def timed(folder, dropped):
    """A rig of ten frames whose camera i lacks the instant dropped(i) of eleven; the mark of a
    frame is its instant.
    """
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        kept = [instant for instant in range(11) if instant != dropped(index)]
        write_timed_video(
            folder / f"{name}.mp4", [make_image(index, t) for t in kept], [20 * t for t in kept]
        )
    return folder


def test_cameras_that_begin_later_are_aligned_by_number(tmp_path):
    """The common numbers are taken and noted, and each index shows one number in all cameras."""
    capture = open_capture(numbered(tmp_path / "room", lambda index: 102 if index == 3 else 100))
    assert capture.n_frames == N_FRAMES - 2
    for frame in range(capture.n_frames):
        assert {int(capture.frame(name, frame)[0, 0, 0]) for name in NAMES} == {
            30 + 20 * (2 + frame)
        }
    (note,) = (note for note in capture.notes if "all cameras have" in note)
    assert note.startswith(
        "3 instants that all cameras have are taken, by the numbers in the names of pictures; left "
        "out: cam00 2 of 5"
    )


def test_cameras_without_a_common_number_are_refused(tmp_path):
    """With the range of each."""
    message = refusal(numbered(tmp_path / "room", lambda index: 200 if index == 3 else 100))
    assert "cam00, cam01, cam02 from 100 to 104; cam03 from 200 to 204" in message


def test_counting_from_zero_and_from_one_is_noted(tmp_path):
    """They are taken to begin together, as before, and the note says which is which."""
    capture = open_capture(numbered(tmp_path / "room", lambda index: index // 2))
    assert capture.n_frames == N_FRAMES
    (note,) = (note for note in capture.notes if "from 0 in some cameras" in note)
    assert "cam00, cam01 from 0 to 4; cam02, cam03 from 1 to 5" in note


@pytest.mark.parametrize("others_lose", [10, 8])
def test_videos_that_drop_frames_are_paired_by_time(tmp_path, others_lose):
    """Where one of them does, and where all do at different moments, so that their average rates
    agree; once that is asked.
    """
    folder = timed(tmp_path / "room", lambda index: 4 if index == 2 else others_lose)
    assert "33.3 ms apart; 'ggvs-eval check" in refusal(folder)
    write_pairing(folder)
    capture = open_capture(folder)
    lost = {"cam02": [4], "cam00": [others_lose]}
    kept = [instant for instant in range(11) if [instant] not in lost.values()]
    for name in NAMES:
        marks = [int(capture.frame(name, frame)[0, 0, 0]) for frame in range(capture.n_frames)]
        assert marks == pytest.approx([30 + 20 * instant for instant in kept], abs=6)


def test_timecodes_pair_frames_once_that_is_asked(tmp_path):
    """Before, a note says how late each camera begins."""
    program = pytest.importorskip("imageio_ffmpeg").get_ffmpeg_exe()
    write_poses(tmp_path, make_rig())
    for index, name in enumerate(NAMES):
        late = (0, 0, 2, 1)[index]
        write_video(tmp_path / "raw", (make_image(index, late + frame) for frame in range(5)), 30)
        words = f"-v error -i raw -c copy -timecode 10:15:30:{5 + late:02d} {name}.mp4"
        subprocess.run([program, *words.split()], cwd=tmp_path, check=True)
    (tmp_path / "raw").unlink()
    assert any(
        "timecodes begin apart, frames late: cam02 2, cam03 1" in note
        for note in open_capture(tmp_path).notes
    )
    write_pairing(tmp_path)
    capture = open_capture(tmp_path)
    assert capture.n_frames == 3
    assert len({round(float(capture.frame(name, 0)[0, 0, 0]), -1) for name in NAMES}) == 1


def test_a_frame_that_all_drop_is_no_fault(tmp_path):
    """Their frames are of one instant still."""
    assert open_capture(timed(tmp_path / "room", lambda index: 4)).n_frames == 10
