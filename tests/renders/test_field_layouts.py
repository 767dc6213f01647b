"""Renders as people send them: other names for the same lists, views in flat names, archives of
macOS and Windows.
"""

import zipfile
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.render_folders import (
    FRAMES,
    VIEWS,
    make_run,
    rendered,
    truth,
    write_flat,
    write_folders,
)


def slightly_other(image: Image8) -> Image8:
    """A copy of the truth by another decoder."""
    return np.clip(
        image.astype(int) + np.random.default_rng(1).integers(-2, 3, image.shape), 0, 255
    ).astype(np.uint8)


def write_ns_render(
    folder: Path, above: str = "test", names: tuple[str, str] = ("rgb", "gt-rgb")
) -> Path:
    """``ns-render dataset``: counted from 1, instant after instant, beside depth and the
    train set.
    """
    places = [(view, frame) for frame in FRAMES for view in VIEWS]
    for number, (view, frame) in enumerate(places, 1):
        write_image(folder / above / names[0] / f"frame_{number:05d}.png", rendered(view, frame))
        write_image(
            folder / above / names[1] / f"frame_{number:05d}.png",
            slightly_other(truth(view, frame)),
        )
        write_image(folder / above / "depth" / f"frame_{number:05d}.png", truth(view, frame))
        write_image(folder / "train" / names[0] / f"frame_{number:05d}.png", truth(view, frame))
        write_image(folder / "train" / names[1] / f"frame_{number:05d}.png", truth(view, frame))
    return folder


def zip_files(
    folder: Path, archive: Path, rename: Callable[[str], str] = str, junk: bool = False
) -> Path:
    """A zip of a folder whose entries are renamed, with what macOS adds to it."""
    with zipfile.ZipFile(archive, "w") as packed:
        for file in sorted(each for each in folder.rglob("*") if each.is_file()):
            name = f"mine/{file.relative_to(folder).as_posix()}"
            packed.write(file, rename(name))
            if junk:
                packed.writestr(
                    f"__MACOSX/{Path(name).parent}/._{file.name}", b"\0\5\x16\7" + bytes(78)
                )
        if junk:
            packed.writestr("mine/.DS_Store", b"\0\0\0\1Bud1")
            packed.writestr("__MACOSX/._mine", b"\0\5\x16\7")
    return archive


def with_junk(folder: Path) -> Path:
    for view in VIEWS:
        (folder / view / "._0002.png").write_bytes(b"\0\5\x16\7" + bytes(78))
        (folder / view / "Thumbs.db").write_bytes(b"\xd0\xcf\x11\xe0")
    write_image(folder / "__MACOSX" / "cam00" / "0002.png", np.zeros((48, 64, 3), np.uint8))
    return folder


FIELD: dict[str, Callable[[Path], Path]] = {
    "ns-render": write_ns_render,
    "ns-render, its test folder": lambda f: write_ns_render(f) / "test",
    "color beside gt-color": lambda f: write_ns_render(f, ".", ("color", "gt-color")),
    "flat, numbers without zeros": lambda f: write_plain_numbers(f),
    "flat names, view first": lambda f: write_folders(f, pattern="{view}_{number:04d}.png"),
    "flat names, frame first": lambda f: write_folders(f, pattern="{number:04d}_{view}.png"),
    "flat names, more words": lambda f: write_folders(f, pattern="render-{view}-frame{number}.png"),
    "zip of macOS": lambda f: zip_files(write_folders(f / "a"), f / "a.zip", junk=True),
    "zip of PowerShell": lambda f: zip_files(
        write_folders(f / "a"), f / "a.zip", lambda name: name.replace("/", "\\")
    ),
    "junk in folders": lambda f: with_junk(write_folders(f)),
}


def write_plain_numbers(folder: Path) -> Path:
    places = [(view, frame) for view in VIEWS for frame in FRAMES]
    write_flat(folder, places)
    for name in ("renders", "gt"):
        for file in sorted((folder / name).iterdir()):
            # 7..12: by letters 10 comes first
            file.rename(file.with_name(f"{int(file.stem) + 7}.png"))
    return folder


@pytest.mark.parametrize("case", FIELD)
def test_renders_of_the_field_arrive_bit_for_bit(case, truth_run, tmp_path):
    """Every picture lands at its view and frame with its own values, and nothing is left over."""
    record = import_renders(truth_run, "mine", FIELD[case](tmp_path / "theirs"))

    assert record["partial"] == ""
    for view in VIEWS:
        for frame in FRAMES:
            np.testing.assert_array_equal(
                read_image(frame_path(truth_run.renders("mine", view), frame)),
                rendered(view, frame),
            )


def refusal(run: RunFolder, path: Path) -> str:
    with pytest.raises(RenderError) as error:
        import_renders(run, "mine", path)
    return str(error.value)


def beside_truth(view: str, frame: int, axis: int) -> Image8:
    return np.concatenate([truth(view, frame), rendered(view, frame)], axis)


@pytest.mark.parametrize(("axis", "words"), [(1, "side by side"), (0, "one above the other")])
def test_two_pictures_in_one_are_named(axis, words, truth_run, tmp_path):
    """Pictures and videos of twice the width or height; twice both is another size and no more."""
    folder, films = tmp_path / "theirs", tmp_path / "films"
    for view in VIEWS:
        for frame in FRAMES:
            write_image(folder / view / f"{frame:04d}.png", beside_truth(view, frame, axis))
        write_video(
            films / f"{view}.mp4", (beside_truth(view, frame, axis) for frame in FRAMES), 30.0
        )

    assert f"instead of 64 x 48: 2 pictures {words}?" in refusal(truth_run, folder)
    assert f"instead of 64 x 48: 2 pictures {words}?" in refusal(truth_run, films)
    for file in folder.rglob("*.png"):
        write_image(file, cv2.resize(rendered("cam00", 2), (128, 96)))
    assert "128 x 96 instead of 64 x 48)" in refusal(truth_run, folder)


def test_flat_names_that_tell_two_things_are_not_guessed(truth_run, tmp_path):
    """Two views, two numbers, or none: such a picture fits none, and is named."""
    folder = write_folders(tmp_path / "theirs", pattern="{view}_{number:04d}.png")
    for name in ("cam00_cam02_0002.png", "cam00_0002_0003.png", "preview.png"):
        write_image(folder / name, rendered("cam00", 2))

    message = refusal(truth_run, folder)
    assert (
        "fits no view and frame: cam00_0002_0003.png; cam00_cam02_0002.png; preview.png" in message
    )


def test_one_archive_under_two_spellings_is_no_hole(truth_run, tmp_path):
    """A backslash is a separator, after which the same checks hold."""
    for name, wanted in (
        ("mine\\..\\..\\evil.png", "leads outside"),
        ("C:\\evil.png", "leads outside"),
        ("\\evil.png", "leads outside"),
    ):
        with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed:
            packed.writestr(name, b"x")
        assert wanted in refusal(truth_run, tmp_path / "a.zip")
    with zipfile.ZipFile(tmp_path / "a.zip", "w") as packed:
        packed.writestr("mine/a.png", b"x")
        packed.writestr("mine\\a.png", b"y")
    assert "a.zip: holds 'mine/a.png' twice" in refusal(truth_run, tmp_path / "a.zip")


def test_messages_name_the_archive(truth_run, tmp_path):
    """What the user gave, never the folder it was unpacked to, which is gone."""
    folder = write_folders(tmp_path / "theirs", pattern="{view}/{number:04d}.jpg")
    (folder / "cam00" / "0003.jpg").write_bytes(b"no picture")
    damaged = zip_files(folder, tmp_path / "damaged.zip")
    with zipfile.ZipFile(tmp_path / "other.zip", "w") as packed:
        packed.writestr("mine/readme.txt", b"x")

    for archive in (damaged, tmp_path / "other.zip"):
        message = refusal(truth_run, archive)
        assert str(archive) in message
        assert "unpacked" not in message


def test_links_in_circles_end(truth_run, tmp_path):
    """A folder that links to itself, twice, is walked through once."""
    folder = write_flat(tmp_path / "theirs", [(view, frame) for view in VIEWS for frame in FRAMES])
    for name in ("a", "b"):
        (folder / "renders" / name).symlink_to(folder / "renders")

    assert import_renders(truth_run, "mine", folder)["partial"] == ""


@pytest.mark.parametrize(
    "write",
    [write_folders, lambda folder: write_folders(folder, pattern="{view}_{number:04d}.png")],
)
def test_suffixes_and_umlauts_are_compared_as_they_look(write, tmp_path):
    """A view called Tür, whose renders came from a Mac with the umlaut in two characters and the
    suffix in capitals.
    """
    run = make_run(tmp_path / "run")
    for folder in (run.root / "truth", write(tmp_path / "theirs")):
        for entry in sorted(folder.rglob("*"), key=lambda each: -len(each.parts)):
            is_truth = folder.name == "truth"
            name = entry.name.replace("cam00", "T\u00fcr" if is_truth else "Tu\u0308r")
            entry.rename(entry.with_name(name if is_truth else name.replace(".png", ".PNG")))
    text = run.protocol_file.read_text(encoding="utf-8").replace("cam00", "T\u00fcr")
    run.protocol_file.write_text(text, encoding="utf-8")

    assert import_renders(run, "mine", tmp_path / "theirs")["frames"]["T\u00fcr"] == list(FRAMES)
