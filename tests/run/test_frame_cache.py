"""Captured frames are decoded once per run: later steps read them from the run folder."""

import os
import shutil

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.frames import ImageFrames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.run.derived_files import cache_frames, frame_tasks, path_task
from ggvs_eval.run_folder import JOB_FILE, frame_numbers, frame_path
from helpers.captures import NAMES


def frames_left(capture, numbers, root) -> dict[str, list[int]]:
    """Camera -> frames that would be written."""
    left = {task.folder.name: task.left() for task in frame_tasks(capture, numbers, root)}
    return {name: frame_numbers(task.files) if task else [] for name, task in left.items()}


@pytest.fixture
def dynerf_capture(dynerf):
    return open_capture(dynerf)


def test_frames_are_those_of_the_capture_at_its_size(dynerf_capture, tmp_path):
    """The cached frames equal the capture's, resized by its filter, under the same numbers and
    digests.
    """
    small = dynerf_capture.resized(32, 24, "area")

    cached = cache_frames(small, {"cam01": [1, 2, 3]}, tmp_path, workers=1)

    for wanted, found in zip(
        small.frames("cam01", 1, 4), cached.frames("cam01", 1, 4), strict=True
    ):
        np.testing.assert_array_equal(found, wanted)
    assert cached.digest("cam01") == dynerf_capture.digest("cam01")
    with pytest.raises(CaptureError, match=r"0004\.png"):  # which was not asked for
        cached.frame("cam01", 4)
    assert [folder.name for folder in tmp_path.glob("cam*")] == ["cam01"]
    # which takes no part
    np.testing.assert_array_equal(cached.frame("cam03", 1), small.frame("cam03", 1))


def test_nothing_is_decoded_twice(dynerf_capture, dynerf, tmp_path):
    """Once the frames are there the videos are not opened any more, not even for a second call."""
    wanted = {name: range(5) for name in NAMES}
    cache_frames(dynerf_capture, wanted, tmp_path, workers=1)
    for video in dynerf.glob("*.mp4"):
        video.unlink()

    again = cache_frames(dynerf_capture, wanted, tmp_path, workers=1)

    assert sum(1 for name in NAMES for _ in again.frames(name)) == 4 * 5


def test_only_what_is_missing_is_written(dynerf_capture, tmp_path):
    """A lost frame comes back with the same pixels, the others are left as they are."""
    cached = cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path, workers=1)
    before = cached.frame("cam02", 3)
    kept, lost = frame_path(tmp_path / "cam02", 2), frame_path(tmp_path / "cam02", 3)
    stamp = kept.stat().st_mtime_ns
    lost.unlink()

    cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path, workers=1)

    np.testing.assert_array_equal(cached.frame("cam02", 3), before)
    assert kept.stat().st_mtime_ns == stamp


@pytest.mark.parametrize("keeps_time", [False, True])
def test_a_frame_that_was_changed_is_written_again(dynerf_capture, tmp_path, keeps_time):
    """Also where size and time of the file are as they were; until then it counts as work that is
    left.
    """
    cached = cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path, workers=1)
    before, file = cached.frame("cam02", 3), frame_path(tmp_path / "cam02", 3)
    about, content = file.stat(), bytearray(file.read_bytes())
    content[len(content) // 2] ^= 1
    file.write_bytes(content)
    if keeps_time:
        os.utime(file, ns=(about.st_atime_ns, about.st_mtime_ns))

    assert frames_left(dynerf_capture, {"cam02": range(5)}, tmp_path) == {"cam02": [3]}
    cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path, workers=1)

    np.testing.assert_array_equal(cached.frame("cam02", 3), before)
    assert frames_left(dynerf_capture, {"cam02": range(5)}, tmp_path) == {"cam02": []}


def test_a_frame_that_was_only_touched_stays(dynerf_capture, tmp_path):
    """A copy of a run folder has other times and inodes; its frames are hashed, not decoded."""
    cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path / "run", workers=1)
    shutil.copytree(tmp_path / "run", tmp_path / "copy", copy_function=shutil.copyfile)

    assert frames_left(dynerf_capture, {"cam02": range(5)}, tmp_path / "copy") == {"cam02": []}


def test_frames_of_unknown_origin_are_written_again(dynerf_capture, tmp_path):
    """Frames without a record, and those of another size, filter or capture, do not pass for this
    one's.
    """
    cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path, workers=1)

    assert frames_left(dynerf_capture.resized(32, 24, "area"), {"cam02": [0, 4]}, tmp_path) == {
        "cam02": [0, 4]
    }
    assert frames_left(
        dynerf_capture.resized(*dynerf_capture.camera("cam02").size, "area"),
        {"cam02": [1]},
        tmp_path,
    ) == {"cam02": [1]}
    (tmp_path / "cam02" / JOB_FILE).write_text("{")
    assert frames_left(dynerf_capture, {"cam02": [2]}, tmp_path) == {"cam02": [2]}


def test_true_images_of_a_path_are_those_of_the_capture(tmp_path):
    """They are written once, and again where the capture's change or where what was written did."""
    images, out = [np.full((8, 12, 3), value, np.uint8) for value in (20, 90)], tmp_path / "out"
    for pose, image in enumerate(images):
        write_image(tmp_path / "path" / f"{pose:04d}.png", image)

    def cached() -> list[int]:
        left = path_task(ImageFrames(tmp_path / "path"), (6, 4), "area", out).left()
        if left is None:
            return []
        left.run()
        return frame_numbers(left.files)

    assert (cached(), cached()) == ([0, 1], [])
    write_image(frame_path(out, 1), 255 - images[1][:4, :6])
    assert (cached(), cached()) == ([1], [])
    assert (read_image(frame_path(out, 1)) == 90).all()
    write_image(tmp_path / "path" / "0000.png", images[0] + 5)
    assert (cached(), cached()) == ([0, 1], [])
    assert (read_image(frame_path(out, 0)) == 25).all()


def test_frames_of_another_version_stay_until_they_are_replaced(dynerf_capture, dynerf, tmp_path):
    """Where they cannot be decoded again, what the folder had is still there, and still counts as
    missing.
    """
    cache_frames(dynerf_capture, {"cam02": range(5)}, tmp_path, workers=1)
    frames = {file: file.read_bytes() for file in (tmp_path / "cam02").glob("*.png")}
    small = dynerf_capture.resized(32, 24, "area")
    for video in dynerf.glob("*.mp4"):
        video.unlink()

    with pytest.raises(CaptureError):
        cache_frames(small, {"cam02": range(5)}, tmp_path, workers=1)

    assert {file: file.read_bytes() for file in frames} == frames
    assert frames_left(small, {"cam02": range(5)}, tmp_path) == {"cam02": [0, 1, 2, 3, 4]}
