"""Grey, palettes, 16 bits, black, links to nothing and names a little off are told, never passed
over.
"""

import shutil
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from PIL import Image

from ggvs_eval.errors import GgvsError, RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.refusals import refused
from helpers.render_folders import (
    VIEWS,
    rendered,
    stack,
    view_major,
    write_easyvolcap,
    write_flat,
    write_folders,
    write_nerfbaselines,
    write_videos,
)


def refusal(run: RunFolder, source: Path) -> str:
    with pytest.raises(GgvsError) as caught:
        import_renders(run, "mine", source)
    assert "\n" not in str(caught.value)
    return str(caught.value)


def save(mode: str, **options: object) -> Callable[[Path, np.ndarray], None]:
    return lambda path, image: Image.fromarray(image).convert(mode).save(path, **options)


CONVERTED: dict[str, tuple[str, Callable[[Path, np.ndarray], None], list[str]]] = {
    "grey": (
        ".png",
        save("L"),
        ["1 frame (3) grey: the same level is measured in all three channels"],
    ),
    "one bit": (
        ".png",
        save("1"),
        ["1 frame (3) grey: the same level is measured in all three channels"],
    ),
    "grey with alpha": (
        ".png",
        save("LA"),
        [
            "1 frame (3) read without an alpha channel",
            "1 frame (3) grey: the same level is measured in all three channels",
        ],
    ),
    "palette": (".png", save("P"), ["1 frame (3) read in the colours of a palette"]),
    "palette with transparency": (
        ".png",
        save("P", transparency=3),
        [
            "1 frame (3) read in the colours of a palette",
            "1 frame (3) read without an alpha channel",
        ],
    ),
    "colour with alpha": (".png", save("RGBA"), ["1 frame (3) read without an alpha channel"]),
    "colour with a hole": (
        ".png",
        lambda path, image: Image.fromarray(
            np.dstack([image, np.where(np.arange(64) < 9, 0, 255 + 0 * image[..., 0])]).astype("u1")
        ).save(path),
        [
            "1 frame (3) read without an alpha channel",
            "1 frame (3) read without the alpha of transparent pixels: the colour beneath",
        ],
    ),
    "grey JPEG": (".jpg", save("L"), ["1 frame (3) of JPEG", "1 frame (3) grey"]),
    "CMYK JPEG": (
        ".jpg",
        save("CMYK"),
        ["1 frame (3) of JPEG", "1 frame (3) read converted from CMYK"],
    ),
}


@pytest.mark.parametrize("case", CONVERTED)
def test_pictures_that_are_no_rgb_are_converted_and_told(case, truth_run, tmp_path):
    """What is measured are the colours that Pillow makes of it; one line per view and kind
    says so.
    """
    suffix, write, notes = CONVERTED[case]
    folder = write_folders(tmp_path / "theirs")
    file = folder / "cam00" / f"0003{suffix}"
    (folder / "cam00" / "0003.png").unlink()
    write(file, rendered("cam00", 3))

    record = import_renders(truth_run, "mine", folder)

    told = [note for note in record["notes"] if note.startswith("cam00")]
    assert [
        note.removeprefix("cam00: ")[: len(start)] for note, start in zip(told, notes, strict=True)
    ] == notes
    assert not [note for note in record["notes"] if note.startswith("cam02")]
    image = read_image(frame_path(truth_run.renders("mine", "cam00"), 3)).astype(int)
    assert np.abs(image - np.asarray(Image.open(file).convert("RGB"), int)).max() <= (
        4 if case == "CMYK JPEG" else 1
    )


def test_black_frames_are_told(truth_run, tmp_path):
    """All-zero frames of renders, in pictures and in arrays, are scored and named; those of the
    capture are named too.
    """
    folder = write_folders(tmp_path / "theirs")
    for frame in (2, 3):
        write_image(folder / "cam00" / f"000{frame}.png", np.zeros((48, 64, 3), np.uint8))
    write_image(frame_path(truth_run.truth("cam02"), 4), np.zeros((48, 64, 3), np.uint8))
    (tmp_path / "arrays").mkdir()
    for view in VIEWS:
        np.save(
            tmp_path / "arrays" / f"{view}.npy",
            stack(view) * np.array([1, 0, 1], np.uint8)[:, None, None, None],
        )

    pictures, arrays = (
        import_renders(truth_run, name, tmp_path / name)["notes"] for name in ("theirs", "arrays")
    )

    assert "cam00: 2 frames (2-3) all zero (failed rendering?); scored anyway" in pictures
    assert "captured frames of cam02 are all zero: 4" in pictures
    assert "cam02: 1 frame (3) all zero (failed rendering?); scored anyway" in arrays
    assert sum("all zero" in note for note in pictures) == 2


def test_floats_beyond_one_are_clipped_and_told(truth_run, tmp_path):
    """A little overshoot is clipped, and the frames and the range are named; whole floats in [0, 1]
    have no such line.
    """
    for name, factor in (("over", 1.05), ("inside", 1.0)):
        (tmp_path / name).mkdir()
        for view in VIEWS:
            frames = stack(view, "float32")
            frames[1] *= factor / frames[1].max()
            np.save(tmp_path / name / f"{view}.npy", frames)

    over, inside = (
        import_renders(truth_run, name, tmp_path / name)["notes"] for name in ("over", "inside")
    )

    assert any(note.startswith("cam00: 1 frame (3) with values outside [0, 1], ") for note in over)
    assert any(note.endswith(" to 1.05, which are clipped") for note in over)
    assert not any("clipped" in note for note in inside)
    assert read_image(frame_path(truth_run.renders("over", "cam00"), 3)).max() == 255


@pytest.mark.parametrize(
    ("change", "mend"),
    [
        (
            lambda frames: frames[..., 0],
            "which has no colours: save numpy.repeat(frames[..., None], 3, -1)",
        ),
        (lambda frames: frames[..., :1], "which is grey: save numpy.repeat(frames, 3, -1)"),
        (
            lambda frames: np.concatenate([frames, frames[..., :1]], -1),
            "which has a fourth channel: save frames[..., :3]",
        ),
        (lambda frames: frames.astype(np.uint16) * 257, "got uint16; divide by 65535.0"),
    ],
)
def test_arrays_of_another_kind_say_how_to_mend_them(change, mend, truth_run, tmp_path):
    """Grey, alpha and 16 bit are not guessed at."""
    (tmp_path / "theirs").mkdir()
    for view in VIEWS:
        np.save(tmp_path / "theirs" / f"{view}.npy", change(stack(view)))

    assert mend in refusal(truth_run, tmp_path / "theirs")


def test_grey_and_deep_videos_are_told(truth_run, tmp_path):
    """10 bits that become 8 and grey that becomes RGB."""
    import av

    for view, pixels in (("cam00", "yuv420p10le"), ("cam02", "gray")):
        (tmp_path / "theirs").mkdir(exist_ok=True)
        with av.open(str(tmp_path / "theirs" / f"{view}.mp4"), "w") as container:
            stream = container.add_stream("libx264", rate=30)
            stream.width, stream.height, stream.pix_fmt = 64, 48, pixels
            for image in stack(view):
                container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
            container.mux(stream.encode())

    notes = import_renders(truth_run, "mine", tmp_path / "theirs")["notes"]

    assert "cam00: frames are read cut from 10 to 8 bits" in notes
    assert "cam02: 3 frames (2-4) grey: the same level is measured in all three channels" in notes


LINKED: dict[str, tuple[Callable[[Path], Path], str]] = {
    "folders": (write_folders, "cam00/0003.png"),
    "video": (write_videos, "cam00.mp4"),
    "nerfbaselines": (write_nerfbaselines, "color/cam00/0003.png"),
    "nerfbaselines, truth": (write_nerfbaselines, "gt-color/cam00/0003.png"),
    "easyvolcap": (write_easyvolcap, "RENDER/frame0003_camera0000.png"),
    "flat": (lambda folder: write_flat(folder, view_major()), "renders/00001.png"),
    "flat, truth": (lambda folder: write_flat(folder, view_major()), "gt/00001.png"),
}


@pytest.mark.parametrize("target", ["nowhere", "itself"])
@pytest.mark.parametrize("case", LINKED)
def test_a_dangling_link_is_one_line(case, target, truth_run, tmp_path):
    """A link to nothing, or to itself, among the files of every kind is named, whatever
    kind it is.
    """
    write, name = LINKED[case]
    file = write(tmp_path / "theirs") / name
    file.unlink()
    file.symlink_to(file.name if target == "itself" else "nowhere")

    message = refusal(truth_run, tmp_path / "theirs")

    assert f"{file}: wanted a file, got " in message
    assert (
        "a link to nothing; restore it or remove it" if target == "nowhere" else "Too many levels"
    ) in message


def test_a_dangling_link_to_a_folder_is_one_line(truth_run, tmp_path):
    """A view's folder, and the folder of renders itself."""
    folder = write_folders(tmp_path / "theirs")
    shutil.rmtree(folder / "cam00")
    (folder / "cam00").symlink_to("nowhere")
    (tmp_path / "loop").symlink_to("loop")

    assert "cam00 lacks all 3 frames, but cam00 is a broken link; restore its target" in refusal(
        truth_run, folder
    )
    assert "got no such path" in refusal(truth_run, tmp_path / "loop")


def test_renders_that_are_gone_are_told(truth_run, tmp_path):
    """Where frames are links and the files were taken away the run says what to do."""
    folder = write_folders(tmp_path / "theirs")
    import_renders(truth_run, "mine", folder, link=True)
    shutil.rmtree(folder / "cam00")

    with refused(
        RenderError, "wanted the frames of mine", "cam00, got none", "--renders mine=NEWPLACE"
    ):
        score(truth_run)


def renamed(folder: Path, *names: tuple[str, str]) -> Path:
    for old, new in names:
        (folder / old).rename(folder / new)
    return folder


def converted(
    folder: Path, suffix: str, keep: bool = False, views: tuple[str, ...] = VIEWS
) -> Path:
    for file in [file for view in views for file in sorted((folder / view).iterdir())]:
        Image.open(file).save(file.with_suffix(suffix))
        if not keep:
            file.unlink()
    return folder


CASE = "names are case-sensitive, write cam00"
LOOKALIKES: dict[str, tuple[Callable[[Path], Path], list[str], list[str]]] = {
    ".webp": (
        lambda f: converted(write_folders(f), ".webp"),
        ["cam00/ holds 3 .webp unsupported pictures: convert them to .png"],
        ["protocol.toml", "EasyVolcap"],
    ),
    ".webp in one view": (
        lambda f: converted(write_folders(f), ".webp", views=("cam00",)),
        [
            "mine in cam00 lacks all 3 frames, but cam00/ holds 3 .webp unsupported pictures: "
            "convert them to .png"
        ],
        ["cam02"],
    ),
    ".tif in one flat list": (
        lambda f: renamed(
            converted(renamed(write_folders(f)), ".tif"), ("cam00", "color"), ("cam02", "colour")
        ),
        ["color/ holds 3 .tif unsupported pictures"],
        ["protocol.toml"],
    ),
    "CAM00": (
        lambda f: renamed(write_folders(f), ("cam00", "CAM00")),
        [f"lacks all 3 frames, but there is CAM00: {CASE}"],
        [],
    ),
    "CAM00 and CAM02": (
        lambda f: renamed(write_folders(f), ("cam00", "CAM00"), ("cam02", "CAM02")),
        [f"there is CAM00: {CASE}", "there is CAM02: "],
        ["protocol.toml"],
    ),
    "CAM00.mp4": (
        lambda f: renamed(write_videos(f), ("cam00.mp4", "CAM00.mp4")),
        [f"there is CAM00.mp4: {CASE}"],
        [],
    ),
    "numbers alone": (
        lambda f: renamed(write_folders(f), ("cam00", "00"), ("cam02", "02")),
        ["there is 00: rename it if it is cam00", "there is 02: rename it if it is cam02"],
        ["protocol.toml"],
    ),
    ".mkv": (
        lambda f: renamed(write_videos(f), ("cam00.mp4", "cam00.mkv")),
        ["cam00.mkv is there but not supported"],
        [],
    ),
    ".jpg beside .png": (
        lambda f: converted(write_folders(f), ".jpg", keep=True),
        [
            "mine in cam00: 2-4 (several pictures of one frame: 0002.jpg and 0002.png; give a "
            "folder with one of each)"
        ],
        ["lacks", "fits no view and frame"],
    ),
}


@pytest.mark.parametrize("case", LOOKALIKES)
def test_what_was_meant_is_recognised(case, truth_run, tmp_path):
    """Another format, other case, two formats of one frame: what is the matter, and what to do."""
    write, said, unsaid = LOOKALIKES[case]

    message = refusal(truth_run, write(tmp_path / "theirs"))

    assert [text for text in said if text not in message] == []
    assert [text for text in unsaid if text in message] == []


def test_a_member_of_an_npz_in_another_case_is_recognised(truth_run, tmp_path):
    """As folders are."""
    np.savez(tmp_path / "all.npz", CAM00=stack("cam00"), cam02=stack("cam02"))

    assert f"there is all.npz[CAM00]: {CASE}" in refusal(truth_run, tmp_path / "all.npz")


def test_sixteen_bit_and_palette_frames_of_a_capture_are_told(tmp_path):
    """They are read in 8 bits, and the capture's notes say of which cameras and how many."""
    from ggvs_eval.datasets.frames import ImageFrames

    for index, name in enumerate(("a.png", "b.png", "c.png")):
        image = rendered("cam00", index)
        if name == "b.png":
            cv2.imwrite(str(tmp_path / f"{index}.png"), image[..., ::-1].astype(np.uint16) * 257)
        else:
            Image.fromarray(image).convert("P" if name == "c.png" else "RGB").save(
                tmp_path / f"{index}.png"
            )

    frames = ImageFrames(tmp_path)

    assert frames.conversions == {"cut from 16 to 8 bits": 1, "in the colours of a palette": 1}
    np.testing.assert_array_equal(next(iter(frames.frames(1, 2))), rendered("cam00", 1))
