"""``corrections.toml``: cameras brought into step and to one brightness, whatever reads the
capture.
"""

from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.corrections import FILE, Correction, read_corrections, write_corrections
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import write_video
from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.inspection.capture.colour import propose_corrections, repair_capture
from helpers.captures import FPS, NAMES, make_rig, write_poses

N_FRAMES = 9
FLAT = (48, 64, 3)


def level(camera: int, frame: int) -> int:
    """Of a picture of one colour: which camera, which instant."""
    return 20 + 20 * camera + 5 * frame


@pytest.fixture
def rig(tmp_path) -> Path:
    """Cameras of which frame t of the second shows what the others show at t - 2, and of the third
    at t + 1.
    """
    folder = tmp_path / "rig"
    folder.mkdir()
    for index, name in enumerate(NAMES):
        late = {1: -2, 2: 1}.get(index, 0)
        write_video(
            folder / f"{name}.mp4",
            [np.full(FLAT, level(index, t + late + 2), np.uint8) for t in range(N_FRAMES)],
            FPS,
        )
    write_poses(folder, make_rig())
    return folder


def levels(folder: Path, name: str) -> np.ndarray:
    return np.array([image.mean() for image in open_capture(folder).frames(name)])


def test_cameras_are_brought_into_step(rig):
    """Frame t of every camera shows one instant; three of nine instants were not seen by all."""
    before = open_capture(rig)
    write_corrections(
        rig / FILE, {NAMES[1]: Correction(NAMES[1], -2), NAMES[2]: Correction(NAMES[2], 1)}
    )
    capture = open_capture(rig)

    assert (before.n_frames, capture.n_frames) == (9, 6)
    for index, name in enumerate(NAMES):
        wanted = [level(index, instant + 3) for instant in range(6)]
        assert levels(rig, name) == pytest.approx(wanted, abs=1.5)  # x264 and its colours
        assert len(list(capture.frames(name, 2, 5))) == 3
    assert capture.digest(NAMES[1]) != before.digest(NAMES[1])
    assert (
        f"{NAMES[1]} 2 frames behind, shifted; {NAMES[2]} 1 frame ahead, shifted"
        in capture.notes[-1]
    )


def test_colours_are_divided(rig):
    """Each channel by its gain, rounded; other cameras keep their frames and their digest."""
    plain = open_capture(rig)
    gain = (1.1, 1.2, 0.9)
    write_corrections(rig / FILE, {NAMES[0]: Correction(NAMES[0], gain=gain)})
    capture = open_capture(rig)

    expected = np.clip(np.rint(plain.frame(NAMES[0], 4) / np.array(gain)), 0, 255)
    assert np.array_equal(capture.frame(NAMES[0], 4), expected)
    assert np.array_equal(capture.frame(NAMES[1], 4), plain.frame(NAMES[1], 4))
    assert capture.digest(NAMES[1]) == plain.digest(NAMES[1])
    assert capture.digest(NAMES[0]) != plain.digest(NAMES[0])


def test_a_file_without_corrections_changes_nothing(rig):
    """What needs no correction is not written; a capture with such a file has the digests that it
    had.
    """
    before = open_capture(rig)
    write_corrections(rig / FILE, {NAMES[0]: Correction(NAMES[0])})
    assert "[[camera]]" not in (rig / FILE).read_text()
    (rig / FILE).unlink()
    write_corrections(rig / FILE, {NAMES[0]: Correction(NAMES[0], gain=(1.0, 1.0, 1.01))})
    assert read_corrections(rig / FILE) == {NAMES[0]: Correction(NAMES[0], gain=(1.0, 1.0, 1.01))}
    assert open_capture(rig).n_frames == before.n_frames


BROKEN = {
    'camera = [{ name = "cam77" }]': "wanted cameras of the capture, got cam77",
    'camera = [{ name = "cam00", gain = [0, 1, 1] }]': "a gain of red, green and blue",
    'camera = [{ name = "cam00", gain = [1.1] }]': "a gain of red, green and blue",
    'camera = [{ name = "cam00", offset_frames = 9 }]': "the offsets leave none of 9 frames",
    'camera = [{ name = "cam00", offset_frames = 99999999 }]': "an offset in frames",
    'camera = [{ name = "cam00", offset = 9 }]': "did you mean camera[0].offset_frames",
    'camera = [{ name = "cam00" }, { name = "cam00" }]': "each camera once",
    "camera": "not valid TOML",
}


@pytest.mark.parametrize("text", BROKEN)
def test_what_is_no_correction_is_one_line(text, rig):
    """The file is named, with what to do."""
    (rig / FILE).write_text(text)
    with pytest.raises(CaptureError) as caught:
        open_capture(rig)
    assert BROKEN[text] in str(caught.value)
    assert str(rig / FILE) in str(caught.value)


def finding(camera: str, question: str, verdict: str, **values: object) -> Finding:
    return Finding(camera, question, verdict, "", values)  # type: ignore[arg-type]


def test_findings_become_corrections_and_add_up(rig):
    """Whole frames and gains that the check minds; a second repair adds to the first, one without
    findings writes nothing.
    """
    first = [
        finding("rig", "time offset", "bad", largest_frames=2.1),
        finding("cam01", "time offset", "bad", offset_frames=-1.9),
        finding("cam02", "time offset", "warn", offset_frames=0.4),
        finding("cam03", "time offset", "ok", offset_frames=0.1),
        finding("cam03", "colour gain", "warn", gain=[1.1, 1.2, 1.0]),
        finding("cam00", "colour gain", "unknown"),
    ]
    assert propose_corrections(first, {}) == {
        "cam01": Correction("cam01", -2),
        "cam03": Correction("cam03", 0, (1.1, 1.2, 1.0)),
    }
    assert repair_capture(rig, [finding("cam02", "time offset", "warn", offset_frames=0.4)]) == ""
    assert not (rig / FILE).exists()

    assert repair_capture(rig, first).startswith(str(rig / FILE))
    repair_capture(
        rig,
        [
            finding("cam01", "time offset", "bad", offset_frames=1.2),
            finding("cam03", "colour gain", "warn", gain=[1, 0.5, 2]),
        ],
    )
    assert read_corrections(rig / FILE) == {
        "cam01": Correction("cam01", -1),
        "cam03": Correction("cam03", 0, (1.1, 0.6, 2.0)),
    }
