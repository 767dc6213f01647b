"""Renders that do not fit are refused in one line that lists everything, and nothing of them stays
in the run.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import GgvsError, ProtocolError, RenderError
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.run.import_renders import import_renders, named_renders
from ggvs_eval.run_folder import RunFolder
from helpers.render_folders import (
    FRAMES,
    N_FRAMES,
    VIEWS,
    rendered,
    stack,
    truth,
    view_major,
    write_flat,
    write_folders,
    write_nerfbaselines,
    write_picture,
    write_videos,
)


def refusal(run: RunFolder, source: Path, label: str = "mine", allow_partial: bool = False) -> str:
    """The one line, after which the run holds what it held before."""
    before = sorted((run.root / "renders").rglob("*"))
    with pytest.raises(GgvsError) as caught:
        import_renders(run, label, source, allow_partial)
    message = str(caught.value)
    assert "\n" not in message
    assert sorted((run.root / "renders").rglob("*")) == before
    return message


def test_everything_wrong_is_in_one_list(truth_run, tmp_path):
    """Missing frames as ranges, extras, wrong sizes with both sizes and unreadable files come in
    one message.
    """
    folder = write_folders(tmp_path / "theirs")
    for frame in (2, 3):
        (folder / "cam02" / f"000{frame}.png").unlink()
    write_image(folder / "cam02" / "0099.png", rendered("cam02", 2))
    write_image(folder / "depth" / "0002.png", rendered("cam01", 2))
    write_image(folder / "cam00" / "0002.png", np.zeros((24, 32, 3), np.uint8))
    write_image(folder / "cam00" / "0003.png", np.zeros((24, 32, 3), np.uint8))
    (folder / "cam00" / "0004.png").write_bytes(b"nothing")

    message = refusal(truth_run, folder)

    assert "frames are missing: mine in cam02 lacks 2-3; " in message
    assert "mine in cam00: 2-3 (32 x 24 instead of 64 x 48: to score them at this size" in message
    assert "mine in cam00: 4 (no picture that can be read)" in message
    assert "fits no view and frame: depth/ (1 pictures); cam02/0099.png" in message
    assert "--allow-partial" in message


@pytest.mark.parametrize(
    "pattern", ["{view}/{number:04d}.png", "{view}_{number:04d}.png", "{view}.mp4"]
)
def test_a_camera_that_is_not_tested_is_a_note(pattern, truth_run, tmp_path):
    """Who renders every camera of the capture has done nothing wrong; the note names those that are
    left out.
    """
    folder = tmp_path / "theirs"
    if pattern.endswith(".mp4"):
        write_videos(folder, views=["cam00", "cam02", "cam01"])
    else:
        write_folders(folder, pattern=pattern)
        write_picture(folder / pattern.format(view="cam01", number=2), rendered("cam01", 2))
    record = import_renders(truth_run, "mine", folder)
    assert "cam01: not used, as the protocol does not test these cameras" in record["notes"]
    assert (set(record["frames"]), record["partial"]) == (set(VIEWS), "")


def test_a_long_list_is_counted(truth_run, tmp_path):
    """Of more than 20 extras 20 are named and the rest is counted."""
    folder = write_folders(tmp_path / "theirs")
    for number in range(100, 130):
        shutil.copy(folder / "cam00" / "0002.png", folder / "cam00" / f"{number}.png")

    assert message_items(refusal(truth_run, folder)) == (20, "and 10 more")


def message_items(message: str) -> tuple[int, str]:
    listed = message.partition("fits no view and frame: ")[2]
    return listed.count("cam00/"), "and" + listed.partition(" and")[2].partition(";")[0]


def test_two_pictures_of_one_frame_are_told(truth_run, tmp_path):
    """Colour and depth under one number are not guessed apart: both are named, and what to do."""
    folder = write_folders(tmp_path / "theirs", pattern="{view}/rgb_{number:04d}.png")
    write_folders(tmp_path / "theirs", pattern="{view}/depth_{number:04d}.png")

    message = refusal(truth_run, folder)

    assert (
        "mine in cam00: 2-4 (several pictures of one frame: depth_0002.png and rgb_0002.png; give "
        "a folder with one of each)" in message
    )
    assert "lacks" not in message


def test_sixteen_bits_are_refused(truth_run, tmp_path):
    """16-bit PNG would be cut to 8 bit while reading, so that something else were measured than was
    written.
    """
    folder = write_folders(tmp_path / "theirs")
    cv2.imwrite(str(folder / "cam00" / "0003.png"), rendered("cam00", 3).astype(np.uint16) * 257)

    assert "mine in cam00: 3 (16 bits per channel instead of 8: convert them yourself)" in refusal(
        truth_run, folder
    )


def test_a_gap_does_not_shift_what_follows(truth_run, tmp_path):
    """Three pictures numbered 2, 3, 5 are not taken for 2, 3, 4 although their count is right."""
    message = refusal(truth_run, write_folders(tmp_path / "theirs", numbers=(2, 3, 5)))

    assert "mine in cam00 lacks 4" in message
    assert "cam00/0005.png" in message


def nothing(folder: Path) -> Path:
    folder.mkdir()
    return folder


def write_array(folder: Path, array: np.ndarray) -> Path:
    folder.mkdir()
    for view in VIEWS:
        np.save(folder / f"{view}.npy", array)
    return folder


def move_truth(folder: Path, change: Callable[[str, int], np.ndarray]) -> Path:
    """Flat renders whose copies of the truth are something else."""
    write_flat(folder, view_major())
    for index, place in enumerate(view_major()):
        write_image(folder / "gt" / f"{index:05d}.png", change(*place))
    return folder


def with_nan() -> np.ndarray:
    frames = np.zeros((3, 48, 64, 3), np.float16)
    frames[1, 5, 7:9, 0] = np.nan
    return frames


def write_one(folder: Path, array: np.ndarray) -> Path:
    folder.mkdir()
    np.save(folder / "renders.npy", array)
    return folder


def mixed(folder: Path) -> Path:
    write_videos(write_folders(folder))
    return folder


def two_sets(folder: Path) -> Path:
    for name in ("ours_7000", "ours_30000"):
        write_flat(folder / "test" / name, view_major())
    return folder


def uneven(folder: Path) -> Path:
    write_flat(folder, view_major())
    (folder / "gt" / "00003.png").unlink()
    return folder


def damaged_video(folder: Path) -> Path:
    video = write_videos(folder) / "cam00.mp4"
    video.write_bytes(video.read_bytes()[:-400])
    return folder


def without_truth_and_names(folder: Path) -> Path:
    write_nerfbaselines(folder, copies=False)
    for index, file in enumerate(sorted((folder / "color").rglob("*.png"))):
        file.rename(folder / "color" / f"{index:05d}.png")
    return folder


def with_another_video(folder: Path) -> Path:
    shutil.copy(write_videos(folder) / "cam00.mp4", folder / "depth.mp4")
    return folder


WRONG: dict[str, tuple[Callable[[Path], Path], str]] = {
    "nothing there": (lambda f: f, "theirs: wanted renders, got no such path"),
    "cameras that are not tested": (
        lambda f: write_videos(f, views=["cam01"]),
        "theirs has cam01, which are sources under this protocol; its test views are cam02, "
        "cam00: render these; where the method did not use cam01, hold them out: ggvs-eval "
        "protocol CAPTURE mine.toml --test cam01",
    ),
    "an empty folder": (
        nothing,
        "no renders of cam02, cam00 that can be read: a run folder: no protocol.toml; ",
    ),
    "every reason": (
        nothing,
        "<view>/<frame>.png: no folder cam02 or cam00 with PNG or JPEG pictures",
    ),
    "no video of a view": (nothing, "one video per view: no cam02.mp4 or the like"),
    "two kinds at once": (mixed, "holds one video per view and <view>/<frame>.png at once"),
    "a short video": (
        lambda f: write_videos(f, range(2, 4)),
        "mine in cam02 lacks 4; mine in cam00 lacks 4",
    ),
    "a video of who knows what": (
        lambda f: write_videos(f, range(5)),
        "wanted 3 frames of each view (the protocol's) or 7 (the whole capture), got cam00 5, "
        "cam02 5",
    ),
    "a damaged video": (damaged_video, "the file is truncated or no video"),
    "one video too few": (
        lambda f: write_videos(f, views=["cam00"]),
        "mine in cam02 lacks all 3 frames",
    ),
    "one video too many": (with_another_video, "fits no view and frame: depth.mp4"),
    "channels first": (
        lambda f: write_array(f, stack("cam00").transpose(0, 3, 1, 2)),
        "wanted an array (T, H, W, 3), got (3, 3, 48, 64), which has its channels first: save "
        "frames.transpose(0, 2, 3, 1)",
    ),
    "integers of 16 bit": (
        lambda f: write_array(f, stack("cam00").astype(np.uint16)),
        "float in [0, 1], got uint16",
    ),
    "floats up to 255": (
        lambda f: write_array(f, stack("cam00").astype(float)),
        "; divide them by 255",
    ),
    "floats from -1": (
        lambda f: write_array(f, stack("cam00", "float32") * 2 - 1),
        "; map them by (x + 1) / 2",
    ),
    "NaN": (
        lambda f: write_array(f, with_nan()),
        "2 values of frame 1 are NaN, the first at row 5, column 7; find out where the renderer "
        "makes them, clipping keeps NaN",
    ),
    "half the size": (
        lambda f: write_array(f, stack("cam00")[:, ::2, ::2]),
        "2-4 (32 x 24 instead of 64 x 48: to score them at this size, set synthesis.width = 32, "
        "synthesis.height = 24 in",
    ),
    "an array nobody asked for": (
        lambda f: write_one(f, np.zeros((3, 3, 48, 64, 3), np.uint8)),
        "holds renders.npy, but no renders of cam02, cam00 that can be read",
    ),
    "a level too high": (
        lambda f: write_folders(f / "out" / "mine" / "renders").parents[2],
        "no renders of cam02, cam00 here, but in out/mine/renders/; give ",
    ),
    "the training views": (
        lambda f: write_flat(f / "train" / "ours_30000", view_major()).parents[1],
        "train/ours_30000/renders/ is there, which is no test set",
    ),
    "truth of other frames": (
        lambda f: move_truth(f, lambda view, frame: truth(view, frame - 1)),
        "gt: wanted copies of the captured frames next to these renders, got others: copies of "
        "cam02 fit one frame earlier",
    ),
    "truth of another camera": (
        lambda f: move_truth(f, lambda view, frame: truth("cam01", frame)),
        "gt/00000.png is ",
    ),
    "truth of another size": (
        lambda f: move_truth(f, lambda view, frame: truth(view, frame)[::2, ::2]),
        "gt/00000.png has another size than frame 2 of ",
    ),
    "a flat list of five": (
        lambda f: write_flat(f, view_major()[:5]),
        "wanted 3, 6, 7, 14 pictures",
    ),
    "renders without their truth": (
        uneven,
        "wanted the same numbers in renders/ and gt/, one of them lacks 3",
    ),
    "two iterations": (two_sets, "several sets; give one of test/ours_30000, test/ours_7000"),
    "names that tell nothing": (
        without_truth_and_names,
        "wanted names with a view, got color/00000.png",
    ),
}


@pytest.mark.parametrize("case", WRONG)
def test_what_cannot_be_scored_says_why(case, truth_run, tmp_path):
    """Each way of not fitting has one line that says what was wanted and what came."""
    write, message = WRONG[case]

    assert message in refusal(truth_run, write(tmp_path / "theirs"))


def test_several_sets_are_the_only_reason(truth_run, tmp_path):
    """Where one of several sets is to be chosen nothing else is listed; --allow-partial is not
    offered where nothing fits.
    """
    assert "run folder" not in refusal(truth_run, two_sets(tmp_path / "theirs"))
    half = write_array(tmp_path / "half", stack("cam00")[:, ::2, ::2])
    assert "--allow-partial" not in refusal(truth_run, half)


def test_predictions_against_another_capture_are_refused(truth_run, tmp_path):
    """NerfBaselines' own copy of the truth is held against the capture even where the names fit;
    the distance is told.
    """
    folder = write_nerfbaselines(tmp_path / "theirs")
    write_image(folder / "gt-color" / "cam00" / "0003.png", 255 - truth("cam00", 3))
    level = np.abs(255.0 - 2 * truth("cam00", 3).astype(float)).mean()

    assert f"gt-color/cam00/0003.png is {level:.1f} levels from frame 3 of cam00" in refusal(
        truth_run, folder
    )


@pytest.mark.parametrize(
    "label", ["ours-geometric", "Ours", "OURS", "truth", "", ".hidden", "a/b", "a*"]
)
def test_names_that_mean_something_else_are_refused(label, truth_run, tmp_path):
    """Renders cannot take the name or the title of a method, the name of the truth, or one that is
    no plain name.
    """
    assert "renders cannot be called" in refusal(
        truth_run, write_folders(tmp_path / "theirs"), label
    )


def test_a_name_longer_than_file_systems_take_is_one_line(truth_run, tmp_path):
    """Temporary folders add to it, so that the limit is below theirs; the name that is offered
    instead is shorter.
    """
    line = refusal(truth_run, write_folders(tmp_path / "theirs"), 245 * "a")
    assert "which is not a plain name of at most 128 bytes; give another: --renders " in line
    assert line.endswith(f" {100 * 'a'}=PATH")


def test_what_was_rendered_here_is_not_overwritten(truth_run, tmp_path):
    """A folder of that name that no import made stays, and a run cannot import from itself."""
    write_folders(truth_run.root / "renders" / "mine")

    assert "got an existing one; choose another name" in refusal(
        truth_run, write_folders(tmp_path / "theirs")
    )
    assert "are already in the run" in refusal(truth_run, truth_run.root)


def test_a_run_without_truth_says_what_to_run(truth_run, tmp_path):
    """Without captured frames nothing can be compared."""
    shutil.rmtree(truth_run.truth("cam02"))

    assert "run `ggvs-eval prepare`" in refusal(truth_run, write_folders(tmp_path / "theirs"))


def test_partial_of_nothing_is_still_refused(truth_run, tmp_path):
    """Where not one frame fits, --allow-partial does not help."""
    folder = write_folders(tmp_path / "theirs", range(N_FRAMES)[:3], numbers=(1, 20, 30))

    assert "wanted frames of the protocol, got none" in refusal(
        truth_run, folder, allow_partial=True
    )


def test_the_command_line_names_renders():
    """NAME=PATH, or a path that gives its own name; a name twice is refused."""
    assert named_renders(("a=x/y", "some/where/theirs.tar.gz", "dir/with=sign")) == {
        "a": Path("x/y"),
        "theirs": Path("some/where/theirs.tar.gz"),
        "with-sign": Path("dir/with=sign"),
    }
    with pytest.raises(ProtocolError, match="would both be called a"):
        named_renders(("a=x", "a=y"))


@pytest.mark.slow
def test_an_error_of_one_view_reaches_the_caller_from_a_worker(truth_run, tmp_path):
    """What a worker cannot decode is an error of the import, and nothing stays."""
    folder = write_array(tmp_path / "theirs", np.full((len(FRAMES), 48, 64, 3), 7.0))

    with pytest.raises(RenderError, match="frame 0 has 7 to 7"):
        import_renders(truth_run, "mine", folder, workers=2)
    assert list((truth_run.root / "renders").iterdir()) == []
