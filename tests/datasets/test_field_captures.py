"""Captures as people bring them: names, suffixes, texts and rates of phones, drives, operating
systems and other programs.
"""

import codecs
import json
import shutil
import unicodedata
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.inspection.capture.check import check_capture
from ggvs_eval.pipelines.offline.calibration.known_cameras import read_known
from ggvs_eval.pipelines.offline.calibration.undistort import undistort_videos
from helpers.calibration_files import write_anipose, write_opencv, write_qualisys
from helpers.captures import (
    NAMES,
    make_image,
    make_rig,
    mean_colours,
    refusal,
    write_colmap,
    write_colmap_model,
    write_dynerf,
    write_poses,
    write_timed_video,
    write_videos,
)
from helpers.fuzz import CAPTURES
from helpers.small_layouts import transforms, write_capture_toml, write_easymocap, write_nerfstudio

APPLE = b"\0\5\x16\7\0\2\0\0Mac OS X        " + bytes(50)


def assert_rig(folder: Path, names: tuple[str, ...] = NAMES, n_frames: int | None = None) -> None:
    """Every camera has the pose of the rig and its own pictures in the order of time."""
    capture = open_capture(folder)
    assert capture.camera_names == names
    for index, (camera, given) in enumerate(zip(capture.cameras, make_rig(names), strict=True)):
        assert camera.centre == pytest.approx(given.centre, abs=1e-7)
        colours = mean_colours(capture, camera.name)
        assert [colour[1] for colour in colours] == [index] * capture.n_frames
        assert [colour[0] for colour in colours] == list(range(n_frames or capture.n_frames))


# Numbers in names


@pytest.mark.parametrize(
    ("stems", "numbers"),
    [
        (("10.50", "10.75", "11.00", "11.25"), (0, 1, 2, 3)),
        (("9", "9.5", "10", "10.5"), (0, 1, 2, 3)),
        (
            ("1305031102.175304", "1305031102.211214", "1305031102.243211", "1305031102.275326"),
            (0, 1, 2, 3),
        ),
        (("cam01.0009", "cam01.0010", "cam01.0011", "cam01.0012"), (0, 1, 2, 3)),
        (("cam01.9", "cam01.10", "cam01.11", "cam01.12"), (0, 1, 2, 3)),
        (
            (
                "315975689237425436",
                "315975689270758769",
                "315975689304092102",
                "315975689337425435",
            ),
            (0, 1, 2, 3),
        ),
        (("2.mask", "10.mask", "18.mask", "26.mask"), (0, 1, 2, 3)),
    ],
)
def test_frames_go_by_the_value_of_their_numbers(stems, numbers, tmp_path):
    """Fractions count, fields of a name do not; stamps may be uneven by a little."""
    write_poses(tmp_path, make_rig())
    for index, name in enumerate(NAMES):
        for stem, number in zip(reversed(stems), reversed(numbers), strict=True):
            write_image(tmp_path / "frames" / name / f"{stem}.png", make_image(index, number))

    assert_rig(tmp_path, n_frames=len(stems))


@pytest.mark.parametrize(
    ("stems", "message"),
    [
        (("10.5", "10.50", "11.0"), "several with the number 10.5 (10.5.png and 10.50.png)"),
        (("10.25", "10.5"), "wanted images whose numbers can be read in one way, got 10.25"),
        (("0000", "0001", "0003"), "gaps between 1 and 3"),
        (("0000", "0001", "thumbnail"), "got no number (thumbnail.png)"),
    ],
)
def test_numbers_that_tell_no_order_are_refused_by_name(stems, message, tmp_path):
    """Ties, gaps, names that can be read in two ways, and a picture without number among frames."""
    write_poses(tmp_path, make_rig())
    for name in NAMES:
        for frame, stem in enumerate(stems):
            write_image(tmp_path / "frames" / name / f"{stem}.png", make_image(0, frame))

    assert message in refusal(tmp_path)


# Files of operating systems


def add_junk(folder: Path) -> None:
    """What macOS, Windows, Jupyter and a network drive leave in every folder, named like what lies
    there.
    """
    for place in [folder, *(each for each in folder.rglob("*") if each.is_dir())]:
        for file in [each for each in place.iterdir() if each.is_file()]:
            (place / f"._{file.name}").write_bytes(APPLE)
        for name in (".DS_Store", "Thumbs.db", "desktop.ini"):
            (place / name).write_bytes(APPLE)
    for place in [folder, folder / "images", folder / "frames"]:
        for name in ("__MACOSX", ".ipynb_checkpoints", "@eaDir"):
            if place.is_dir():
                write_image(place / name / "0000.png", np.zeros((48, 64, 3), np.uint8))


@pytest.mark.parametrize("layout", CAPTURES)
def test_junk_is_nobody_s_frame(layout, tmp_path):
    """In every layout: the same cameras, pictures and notes with it as without."""
    clean = open_capture(CAPTURES[layout](tmp_path / "room"))
    first = {name: clean.frame(name, 0) for name in clean.camera_names}
    add_junk(tmp_path / "room")

    capture = open_capture(tmp_path / "room" if clean.path.is_dir() else clean.path)

    assert (capture.layout, capture.camera_names, capture.n_frames) == (
        clean.layout,
        clean.camera_names,
        clean.n_frames,
    )
    assert capture.notes == clean.notes
    for name, image in first.items():
        np.testing.assert_array_equal(capture.frame(name, 0), image)


# Where the frames of a camera lie


def to_avi(folder: Path) -> None:
    for video in list(folder.rglob("*.mp4")):
        video.rename(video.with_suffix(".avi"))


def one_each(folder: Path) -> None:
    for video, suffix in zip(
        sorted(folder.rglob("*.mp4")), (".MP4", ".mov", ".MOV", ".m4v"), strict=True
    ):
        video.rename(video.with_suffix(suffix))


def posed(write: Callable[[Path], None]) -> Callable[[Path], Path]:
    """Videos with the calibration that a function writes."""

    def written(folder: Path) -> Path:
        folder.mkdir()
        write_videos(folder)
        write(folder)
        return folder

    return written


def write_plain_anipose(folder: Path) -> None:
    """The rig without distortion."""
    file = write_anipose(folder / "Calib.toml", make_rig())
    file.write_text(
        "\n".join(
            line for line in file.read_text().splitlines() if not line.startswith("distortions")
        )
    )


RIGS = {
    "dynerf": write_dynerf,
    "anipose": posed(write_plain_anipose),
    "colmap": posed(
        lambda folder: write_colmap_model(
            folder / "sparse" / "0", [f"{name}.png" for name in NAMES]
        )
    ),
    "nerfstudio": posed(
        lambda folder: (folder / "transforms.json").write_text(json.dumps(transforms()))
    ),
}


@pytest.mark.parametrize("rig", RIGS)
def test_videos_are_found_under_any_suffix(rig, tmp_path):
    """What one layout reads every layout reads, in any case; so do the commands that know nothing
    of the cameras.
    """
    folder = RIGS[rig](tmp_path / "room")
    one_each(folder)

    assert_rig(folder)
    assert tuple(find_rig_frames(folder)) == NAMES


@pytest.mark.parametrize("rig", RIGS)
def test_videos_that_are_not_read_are_named_with_the_command(rig, tmp_path):
    """An .avi is there: the message says so and what makes an .mp4 of it."""
    folder = RIGS[rig](tmp_path / "room")
    to_avi(folder)

    message = refusal(folder)

    assert "ffmpeg -i cam00.avi" in message
    assert "cam00.mp4" in message
    with pytest.raises(CaptureError, match=r"ffmpeg -i cam00\.avi"):
        find_rig_frames(folder)


def test_frames_of_capture_toml_that_are_not_read_are_named(tmp_path):
    """It names the very file."""
    folder = write_capture_toml(tmp_path / "room")
    (folder / "videos" / "cam00.mp4").rename(folder / "videos" / "cam 00.mkv")
    file = folder / "capture.toml"
    file.write_text(file.read_text().replace("videos/cam00.mp4", "videos/cam 00.mkv"))

    assert "ffmpeg -i 'cam 00.mkv' -crf 8 'cam 00.mp4'" in refusal(folder)


def test_two_videos_of_one_camera_are_refused(tmp_path):
    """Which one is meant is not guessed."""
    folder = RIGS["colmap"](tmp_path / "room")
    shutil.copy(folder / "cam01.mp4", folder / "cam01.MOV")

    assert "wanted one file per camera, got several called cam01" in refusal(folder)


def with_paths(pattern: str) -> Callable[[Path], Path]:
    """transforms.json whose pictures lie under a pattern of their camera."""

    def written(folder: Path) -> Path:
        values = transforms()
        for index, (frame, name) in enumerate(zip(values["frames"], NAMES, strict=True)):
            frame["file_path"] = pattern.format(name)
            write_image(folder / pattern.format(name).replace("\\", "/"), make_image(index, 0))
        (folder / "transforms.json").write_text(json.dumps(values))
        return folder

    return written


def in_colmap(pattern: str) -> Callable[[Path], Path]:
    """A COLMAP model whose images are called by a pattern of their camera."""

    def written(folder: Path) -> Path:
        write_colmap_model(folder / "sparse" / "0", [pattern.format(name) for name in NAMES])
        for index, name in enumerate(NAMES):
            write_image(folder / "images" / pattern.format(name), make_image(index, 0))
        return folder

    return written


NAMED = {
    "nerfstudio, folder": with_paths("images/{}/000000.png"),
    "nerfstudio, ./": with_paths("./images/{}.png"),
    "nerfstudio, Windows": with_paths("images\\{}.png"),
    "nerfstudio, other folder": with_paths("rgb/{}/images/0000.png"),
    "colmap, folder": in_colmap("{}/0000.png"),
    "colmap, one folder for all": in_colmap("rgb/{}.png"),
}


@pytest.mark.parametrize("case", NAMED)
def test_cameras_are_called_by_what_tells_them_apart(case, tmp_path):
    """The folder where pictures are called alike, else the picture; for every calibration that
    names pictures.
    """
    assert_rig(NAMED[case](tmp_path / "room"))
    assert tuple(read_known(tmp_path / "room")) == NAMES


@pytest.mark.parametrize(
    "names", [("A-DJI plan (0)", "A-DJI plan (1)", "B  two blanks"), ("x", "x y", "x y z")]
)
def test_blanks_in_colmap_s_names(names, tmp_path):
    """The rest of the line of images.txt is the name, as a binary model has it."""
    write_colmap_model(tmp_path / "sparse" / "0", [f"{name}.png" for name in names])
    for index, name in enumerate(names):
        write_image(tmp_path / "images" / f"{name}.png", make_image(index, 0))

    assert_rig(tmp_path, tuple(sorted(names)))


# Texts


def remarked(mark: bytes, coding: str, line_end: str = "\r\n") -> Callable[[Path], None]:
    def change(file: Path) -> None:
        text = file.read_text().replace("\n", line_end)
        file.write_bytes(mark + text.encode(coding))

    return change


def opencv_rig(folder: Path) -> Path:
    folder.mkdir()
    write_videos(folder, NAMES)
    return write_opencv(folder, make_rig())


def qualisys_rig(folder: Path) -> Path:
    folder.mkdir()
    write_videos(folder, NAMES)
    write_qualisys(folder / "Calib.qca.txt", make_rig())
    return folder


TEXTS: dict[str, tuple[Callable[[Path], Path], tuple[str, ...]]] = {
    "transforms.json": (write_nerfstudio, ("transforms.json",)),
    "capture.toml": (write_capture_toml, ("capture.toml",)),
    "anipose": (RIGS["anipose"], ("Calib.toml",)),
    "easymocap": (write_easymocap, ("intri.yml", "extri.yml")),
    "opencv": (opencv_rig, tuple(f"{name}.yml" for name in NAMES)),
    "qualisys": (qualisys_rig, ("Calib.qca.txt",)),
    "colmap": (
        write_colmap,
        tuple(f"sparse/0/{name}.txt" for name in ("cameras", "images", "points3D")),
    ),
    "technicolor": (CAPTURES["technicolor"], ("cameras_parameters.txt",)),
    "rgbd": (CAPTURES["rgbd"], ("intrinsic/intrinsic_color.txt",)),
}


@pytest.mark.parametrize(
    "change", [remarked(codecs.BOM_UTF8, "utf-8"), remarked(codecs.BOM_UTF16_LE, "utf-16-le")]
)
@pytest.mark.parametrize("case", TEXTS)
def test_texts_of_windows_are_read(case, change, tmp_path):
    """With a byte order mark of UTF-8 or UTF-16 and lines of Windows the same cameras come out, to
    the last bit.
    """
    write, files = TEXTS[case]
    folder = write(tmp_path / "room")
    clean = open_capture(folder)
    for file in files:
        change(folder / file)

    capture = open_capture(folder)

    for camera, given in zip(capture.cameras, clean.cameras, strict=True):
        assert camera.name == given.name
        assert np.array_equal(camera.K, given.K)
        assert np.array_equal(camera.world_to_camera, given.world_to_camera)


@pytest.mark.parametrize(("on_disk", "in_file"), [("NFD", "NFC"), ("NFC", "NFD")])
def test_umlauts_are_compared_as_one_character(on_disk, in_file, tmp_path):
    """Files that came through macOS: cameras are called as the calibration spells them, and files
    as the disk does.
    """
    names = tuple(f"Kamera_für_{index}" for index in range(4))
    tmp_path.joinpath("room").mkdir()
    write_videos(tmp_path / "room", [unicodedata.normalize(on_disk, name) for name in names])
    spelled = tuple(unicodedata.normalize(in_file, name) for name in names)
    cameras = [
        Camera(
            name,
            *(
                getattr(c, key)
                for key in ("K", "world_to_camera", "width", "height", "near", "far")
            ),
        )
        for name, c in zip(spelled, make_rig(names), strict=True)
    ]
    file = write_anipose(tmp_path / "room" / "Calib.toml", cameras)
    file.write_text(
        "\n".join(
            line for line in file.read_text().splitlines() if not line.startswith("distortions")
        )
    )

    assert_rig(tmp_path / "room", spelled)
    sizes = {name: frames.size for name, frames in find_rig_frames(tmp_path / "room").items()}
    assert set(read_known(file, sizes)) == set(sizes)


@pytest.mark.parametrize(
    ("write", "file", "wanted"),
    [
        (
            write_colmap,
            "sparse/0/cameras.txt",
            "cameras.txt, line 2: no number in '57,6', which has a decimal comma: write 57.6",
        ),
        (write_colmap, "sparse/0/points3D.txt", "points3D.txt, line 1: no number in '"),
        (CAPTURES["technicolor"], "cameras_parameters.txt", "cameras_parameters.txt: wanted f cu"),
        (
            CAPTURES["rgbd"],
            "intrinsic/intrinsic_color.txt",
            "intrinsic_color.txt: wanted a text file of numbers, got: line 1",
        ),
        (qualisys_rig, "Calib.qca.txt", "which has a decimal comma: write"),
    ],
)
def test_decimal_commas_are_named(write, file, wanted, tmp_path):
    """File, line and word, and what to write instead."""
    folder = write(tmp_path / "room")
    text = (folder / file).read_text()
    at = next(
        place
        for place in range(1, len(text) - 1)
        if text[place] == "." and (text[place - 1] + text[place + 1]).isdigit()
    )
    (folder / file).write_text(text[:at] + "," + text[at + 1 :])
    if file.endswith("qca.txt"):
        (folder / file).write_text(text.replace('r11="0.', 'r11="0,').replace('r11="1.', 'r11="1,'))

    message = refusal(folder)

    assert wanted in message
    assert "decimal comma" in message


# Rates


def phones(folder: Path, steps: Callable[[int, int], float], n_frames: int = 20) -> Path:
    """A rig whose camera i shows frame t at so many 600ths of a second."""
    write_poses(folder, make_rig())
    for index, name in enumerate(NAMES):
        ticks = [round(20 * frame + steps(index, frame)) for frame in range(n_frames)]
        write_timed_video(
            folder / f"{name}.mp4",
            [make_image(index, frame % 10) for frame in range(n_frames)],
            ticks,
        )
    return folder


def jitter(index: int, frame: int) -> int:
    """Two 600ths here and there, and a tenth of a frame more or less at the end."""
    return int(np.random.default_rng([index, frame]).integers(-1, 2)) + (2 * index - 3) * (
        frame == 19
    )


def test_phones_of_one_rate_are_one_rig(tmp_path):
    """Averages of variable rates differ; frames of one number lie within half a step, and the note
    says how far apart.
    """
    folder = phones(tmp_path / "room", jitter)
    lens = "\n".join(
        f"[[camera]]\nname='{n}'\nwidth=64\nheight=48\nK=[[60,0,32],[0,60,24],[0,0,1]]"
        for n in NAMES
    )
    (tmp_path / "lens.toml").write_text(lens)

    capture = open_capture(folder)
    undistorted = undistort_videos(folder, tmp_path / "lens.toml", tmp_path / "out")

    assert capture.fps == pytest.approx(30, abs=0.1)
    assert undistorted.fps == capture.fps
    note = next(note for note in capture.notes if "variable frame rate" in note)
    times = np.array([[round(20 * t + jitter(i, t)) for t in range(20)] for i in range(4)])
    apart_ms = np.ptp(times - times[:, :1], axis=0).max() / 0.6
    assert f"differ by up to {apart_ms:.1f} ms" in note
    assert "variable frame rate" in check_capture(folder).of("frames")[0].measured


def test_phones_that_drift_apart_are_refused(tmp_path):
    """Where frames of one number come to lie more than half a step apart: with the distance."""
    folder = phones(tmp_path / "room", lambda index, frame: jitter(index, 0) + index * frame / 4)

    message = refusal(folder)

    assert "wanted one frame rate for all cameras, got cam00 30" in message
    assert "ms apart; 'ggvs-eval check" in message


def test_two_constant_rates_stay_two(tmp_path):
    """29.97 and 30 frames per second are no jitter, however few frames there are."""
    write_poses(tmp_path, make_rig())
    for index, name in enumerate(NAMES):
        write_video(
            tmp_path / f"{name}.mp4",
            (make_image(index, t) for t in range(4)),
            30 if index else 30000 / 1001,
        )

    assert "wanted one frame rate for all cameras, got cam00 29.97, cam01 30" in refusal(tmp_path)
