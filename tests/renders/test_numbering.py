"""The numbers in names are understood once for all views, the understanding is told, and what has
two is an error.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.renders.numbering import Numbered, frame_numbers, number_streams, number_views
from ggvs_eval.renders.request import FrameRequest
from ggvs_eval.run_folder import frame_path
from helpers.refusals import refused
from helpers.render_folders import (
    FRAMES,
    N_FRAMES,
    VIEWS,
    make_run,
    rendered,
    write_folders,
    write_videos,
)

PLACE = Path("theirs")


def request(frames: range, n_frames: int, first_frame: int | None = None) -> FrameRequest:
    sizes = dict.fromkeys(VIEWS, (64, 48))
    return FrameRequest(
        "mine", VIEWS, frames, n_frames, sizes, ("cam00", "cam01", "cam02"), Path(), first_frame
    )


def numbered(
    numbers: Sequence[int] | Mapping[str, Sequence[int]],
    frames: range,
    n_frames: int,
    first_frame: int | None = None,
) -> Numbered[str]:
    by_view = numbers if isinstance(numbers, Mapping) else dict.fromkeys(VIEWS, numbers)
    items = {view: [(number, f"{number:04d}") for number in some] for view, some in by_view.items()}
    return number_views(PLACE, items, request(frames, n_frames, first_frame))


# Numbers, frames of the protocol and of the capture; the number of instant 0 and what is told.
UNDERSTOOD: dict[str, tuple[Sequence[int], range, int, int, str]] = {
    "instants": (
        range(10, 16),
        range(10, 16),
        24,
        0,
        "frames 10-15 are used as the instants 10-15 of the capture",
    ),
    "from 1": (
        range(1, 7),
        range(6),
        24,
        1,
        "numbered from 1: 1-6 are used as the instants 0-5 of the capture",
    ),
    "from 1, all there is": (
        range(1, 7),
        range(6),
        6,
        1,
        "numbered from 1: 1-6 are used as the instants 0-5 of the capture",
    ),
    "from 1, one missing": (
        (1, 2, 4, 5, 6),
        range(6),
        24,
        1,
        "numbered from 1: 1-2, 4-6 are used as the instants 0-1, 3-5 of the capture",
    ),
    "from 1 in the middle, past the end": (
        range(19, 25),
        range(18, 24),
        24,
        1,
        "numbered from 1: 19-24 are used as the instants 18-23 of the capture",
    ),
    "the whole capture": (
        range(24),
        range(10, 16),
        24,
        0,
        "frames of 0-23, the whole capture, 10-15 are used",
    ),
    "the whole capture from 1": (
        range(1, 25),
        range(10, 16),
        24,
        1,
        "numbered from 1: of 1-24, the whole capture, 11-16 are used as the instants 10-15",
    ),
    "the whole capture from 100": (
        range(100, 124),
        range(10, 16),
        24,
        100,
        "numbered from 100: of 100-123, the whole capture, 110-115 are used as the instants 10-15",
    ),
    "from 100": (
        range(100, 106),
        range(6),
        24,
        100,
        "numbered from 100: 100-105 are used as the instants 0-5 of the capture",
    ),
    "0 is there": (
        (0, 1, 2, 4, 5),
        range(6),
        24,
        0,
        "frames 0-2, 4-5 are used as the instants 0-2, 4-5 of the capture",
    ),
    "one too many": (
        range(7),
        range(6),
        24,
        0,
        "frames 0-5 are used as the instants 0-5 of the capture",
    ),
    "one too many from 1": (
        range(1, 8),
        range(6),
        24,
        1,
        "numbered from 1: 1-6 are used as the instants 0-5 of the capture",
    ),
    "the protocol's first, from 1": (
        (1,),
        range(1),
        24,
        1,
        "numbered from 1: 1 is used as the instant 0 of the capture",
    ),
}


@pytest.mark.parametrize("case", UNDERSTOOD)
def test_numbers_are_understood_and_told(case):
    """What has one meaning is taken, and one line says which."""
    numbers, frames, n_frames, first, note = UNDERSTOOD[case]

    result = numbered(numbers, frames, n_frames)

    assert (result.first, result.note) == (first, note)
    names = {number - first: f"{number:04d}" for number in numbers if number - first in frames}
    assert result.frames == dict.fromkeys(VIEWS, names)


REFUSED: dict[str, tuple[Sequence[int] | Mapping[str, Sequence[int]], range, int, str]] = {
    "other instants of the capture": (
        range(10, 16),
        range(6),
        24,
        "numbered 10-15, the protocol uses the instants 0-5 of 0-23; render those, or give "
        "--first-frame 10 if number 10 shows instant 0",
    ),
    "the protocol's, or the capture's first": (
        range(6),
        range(10, 16),
        24,
        "give --first-frame 0 if number 0 shows instant 10",
    ),
    "the same from 1": (
        range(1, 7),
        range(10, 16),
        24,
        "give --first-frame 1 if number 1 shows instant 10",
    ),
    "one later, or from 1": (
        range(11, 17),
        range(10, 16),
        24,
        "can be the instants 11-16 or, counted from 1, 10-15, and the protocol uses 10-15; name "
        "them by instant, or give --first-frame 10 if number 10 shows instant 10, --first-frame "
        "11 if number 11 does",
    ),
    "the first or the last is missing": (
        range(1, 6),
        range(6),
        24,
        "can be the instants 1-5 or, counted from 1, 0-4",
    ),
    "nearly the whole capture": (
        range(1, 24),
        range(10, 16),
        24,
        "can be the instants 1-23 or, counted from 1, 0-22",
    ),
    "no instants, and the protocol starts later": (
        range(100, 106),
        range(10, 16),
        24,
        "the capture has the instants 0-23",
    ),
    "no instants, with a gap": (
        (100, 102, 103),
        range(6),
        24,
        "give by --first-frame the number of instant 0",
    ),
    "one view from 0, one from 1": (
        {"cam00": range(6), "cam02": range(1, 7)},
        range(6),
        24,
        "views are numbered differently: cam00 0-5, cam02 1-6; wanted one numbering for all views, "
        "rename the frames",
    ),
    "one view by instant, one in order": (
        {"cam00": range(10, 16), "cam02": range(6)},
        range(10, 16),
        24,
        "views are numbered differently: cam00 10-15, cam02 0-5",
    ),
    "one view whole from 1, one by instant": (
        {"cam00": range(1, 25), "cam02": range(10, 16)},
        range(10, 16),
        24,
        "views are numbered differently: cam00 1-24, cam02 10-15",
    ),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_has_two_meanings_or_none_is_refused(case):
    """In one line that says what came, what the protocol asks for and which option or name ends the
    doubt.
    """
    numbers, frames, n_frames, message = REFUSED[case]

    with pytest.raises(RenderError) as caught:
        numbered(numbers, frames, n_frames)

    assert message in str(caught.value)
    assert str(caught.value).startswith("theirs: ")


def test_what_the_user_says_is_not_guessed():
    """--first-frame settles each doubtful case, in all views, and what it leaves over of the
    capture is not used.
    """
    for case in (
        "other instants of the capture",
        "the protocol's, or the capture's first",
        "one later, or from 1",
    ):
        numbers, frames, n_frames, _ = REFUSED[case]
        result = numbered(numbers, frames, n_frames, first_frame=numbers[0])
        assert result.frames["cam00"] == {
            frame: f"{number:04d}" for frame, number in zip(frames, numbers, strict=True)
        }
        assert f"numbered by --first-frame {numbers[0]}" in result.note
    result = numbered(range(1, 24), range(10, 16), 24, first_frame=11)
    assert result.frames["cam02"] == {frame: f"{frame + 1:04d}" for frame in range(10, 16)}
    assert result.extras["cam02"] == []
    assert numbered(range(1, 26), range(10, 16), 24, first_frame=11).extras["cam02"] == ["0025"]


def test_a_gap_in_one_view_is_read_as_the_other_views_are():
    """Counted from 1 in all views: the view that lacks one frame lacks that frame and no other."""
    result = numbered({"cam00": range(1, 7), "cam02": (1, 2, 4, 5, 6)}, range(6), 24)

    assert set(result.frames["cam02"]) == {0, 1, 3, 4, 5}
    assert result.extras == {"cam00": [], "cam02": []}


def test_one_missing_frame_says_which_instant_and_which_name(tmp_path):
    """Of frames that are numbered from 1."""
    run = make_run(tmp_path / "run", frames=range(6), n_frames=24)
    folder = write_folders(tmp_path / "theirs", (0, 1, 3, 4, 5), numbers=(1, 2, 4, 5, 6))

    with pytest.raises(RenderError) as caught:
        import_renders(run, "mine", folder)

    message = str(caught.value)
    assert (
        "numbered from 1: 1-2, 4-6 are used as the instants 0-1, 3-5 of the capture; frames are "
        "missing: " in message
    )
    assert "mine in cam00 lacks 2 (numbered 3)" in message
    assert "fits no view and frame" not in message


def test_frames_without_numbers_need_none_where_one_is_asked_for(tmp_path):
    """The only picture of each view is the only frame; its view's name is no number."""
    run = make_run(tmp_path / "run", frames=range(3, 4), n_frames=24)
    folder = write_folders(tmp_path / "theirs", (3,), pattern="{view}/{view}.png")

    record = import_renders(run, "mine", folder)

    assert record["notes"] == ["the only frame of each view is assumed to be instant 3"]
    np.testing.assert_array_equal(
        read_image(frame_path(run.renders("mine", "cam00"), 3)), rendered("cam00", 3)
    )


@pytest.mark.parametrize(
    ("name", "view", "number"),
    [
        ("frame_0012", "cam00", 12),
        ("cam00", "cam00", None),
        ("cam00_0003", "cam00", 3),
        ("00", "00", 0),
    ],
)
def test_the_number_of_a_view_is_no_frame_number(name, view, number):
    """Unless the view's name is nothing but a number."""
    assert frame_numbers(Path(view), [name], view) == [number]


def test_a_second_meaning_replaces_the_first(tmp_path):
    """The same files with --first-frame are imported again, and the record says how they were
    taken.
    """
    run = make_run(tmp_path / "run")
    folder = write_folders(tmp_path / "theirs", numbers=range(3))
    with pytest.raises(RenderError, match="--first-frame 0"):
        import_renders(run, "mine", folder)

    record = import_renders(run, "mine", folder, first_frame=0)

    assert all(part in record["notes"][0] for part in ("--first-frame 0", "0-2", "instants 2-4"))
    for view in VIEWS:
        for frame in FRAMES:
            np.testing.assert_array_equal(
                read_image(frame_path(run.renders("mine", view), frame)), rendered(view, frame)
            )


def test_streams_are_understood_alike_in_all_views():
    """The whole capture in each view, or the protocol's frames in each; a mixture is refused where
    it matters.
    """
    start_inside, from_0 = request(range(2, 5), 7), request(range(3), 7)

    assert number_streams(PLACE, {"cam00": 7, "cam02": 7}, start_inside).frames["cam02"] == {
        2: 2,
        3: 3,
        4: 4,
    }
    assert number_streams(PLACE, {"cam00": 3, "cam02": 2}, start_inside).frames["cam02"] == {
        2: 0,
        3: 1,
    }
    assert number_streams(PLACE, {"cam00": 7, "cam02": 3}, from_0).frames["cam00"] == {
        0: 0,
        1: 1,
        2: 2,
    }
    with refused(RenderError, "cam00 7, cam02 3", "--first-frame"):
        number_streams(PLACE, {"cam00": 7, "cam02": 3}, start_inside)
    settled = number_streams(
        PLACE, {"cam00": 7, "cam02": 5}, request(range(2, 5), 7, first_frame=2)
    )
    assert settled.frames == {view: {2: 2, 3: 3, 4: 4} for view in VIEWS}
    assert all(
        part in settled.note for part in ("--first-frame 2", "frame 2 of each view", "instant 2")
    )


def test_videos_of_different_lengths_are_refused(tmp_path):
    """One of the whole capture beside one of the protocol's frames is not understood view
    by view.
    """
    run = make_run(tmp_path / "run")
    write_videos(tmp_path / "theirs", range(N_FRAMES), ["cam00"])
    write_videos(tmp_path / "theirs", FRAMES, ["cam02"])

    with refused(RenderError, "theirs: ", "3 frames", "cam00 7, cam02 3"):
        import_renders(run, "mine", tmp_path / "theirs")
