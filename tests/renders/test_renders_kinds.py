"""Renders of every layout become <view>/<frame>.png of a run, each picture at its place."""

import shutil
import socket
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.run import import_renders as import_module
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.run_folder import RunFolder, frame_path, read_json
from helpers.refusals import refused
from helpers.render_folders import (
    FRAMES,
    N_FRAMES,
    VIEWS,
    make_run,
    pack,
    rendered,
    stack,
    truth,
    view_major,
    write_4dgaussians,
    write_easyvolcap,
    write_flat,
    write_folders,
    write_nerfbaselines,
    write_picture,
    write_videos,
)


def largest_difference(run: RunFolder) -> int:
    """Between what was rendered and what lies in the run, over all views and frames."""
    pairs = [
        (read_image(frame_path(run.renders("mine", v), t)).astype(int), rendered(v, t))
        for v, t in view_major()
    ]
    assert sum(1 for _ in (run.root / "renders" / "mine").rglob("*.png")) == len(pairs)
    return max(int(np.abs(image - wanted).max()) for image, wanted in pairs)


def write_arrays(folder: Path, dtype: str, suffix: str) -> Path:
    folder.mkdir()
    for view in VIEWS:
        if suffix == ".npy":
            np.save(folder / f"{view}.npy", stack(view, dtype))
        else:
            np.savez_compressed(folder / f"{view}.npz", frames=stack(view, dtype))
    return folder


def write_one_npz(folder: Path) -> Path:
    folder.mkdir()
    np.savez(folder / "all.npz", **{view: stack(view) for view in VIEWS})
    return folder / "all.npz"


def write_one_array(folder: Path) -> Path:
    folder.mkdir()
    np.save(folder / "renders.npy", np.stack([stack(view) for view in VIEWS]))
    return folder


def write_linked(folder: Path) -> Path:
    """Renders next to the truth, whose folders of views are links to folders elsewhere."""
    for kind in ("renders", "gt"):
        (folder / kind).mkdir(parents=True)
        for view, frame in view_major():
            image = rendered(view, frame) if kind == "renders" else truth(view, frame)
            write_image(folder.parent / "elsewhere" / kind / view / f"{frame:04d}.png", image)
        for view in VIEWS:
            (folder / kind / view).symlink_to(folder.parent / "elsewhere" / kind / view)
    return folder


def write_other_run(folder: Path) -> Path:
    write_folders(make_run(folder).root / "renders" / "theirs")
    return folder


AS_THEY_ARE = "frames 2-4 are used as the instants 2-4 of the capture"
by_frame = [(view, frame) for frame in FRAMES for view in VIEWS]
by_alphabet = [(view, frame) for view in sorted(VIEWS) for frame in FRAMES]
whole_capture = [(view, frame) for view in sorted(VIEWS) for frame in range(N_FRAMES)]
BESIDE_TRUTH = "renders next to copies of the reference"
EXACT: dict[str, tuple[Callable[[Path], Path], str, str]] = {
    "folders": (write_folders, "<view>/<frame>.png", AS_THEY_ARE),
    "folders of five digits": (
        lambda f: write_folders(f, pattern="{view}/rgb_v2_{number:05d}.png"),
        "<view>/<frame>.png",
        AS_THEY_ARE,
    ),
    "folders of the whole capture": (
        lambda f: write_folders(f, range(N_FRAMES)),
        "<view>/<frame>.png",
        "frames of 0-6, the whole capture, 2-4 are used",
    ),
    "a run folder": (
        write_other_run,
        "a run folder",
        "frames of a run folder are numbered by instant",
    ),
    "uint8 arrays": (
        lambda f: write_arrays(f, "uint8", ".npy"),
        "one array per view",
        "in order, as the instants 2-4",
    ),
    "float arrays": (
        lambda f: write_arrays(f, "float32", ".npy"),
        "one array per view",
        "rounded to 8 bit",
    ),
    "double arrays in npz": (
        lambda f: write_arrays(f, "float64", ".npz"),
        "one array per view",
        "rounded to 8 bit",
    ),
    "one npz": (write_one_npz, "one array per view", "in order"),
    "one array of all views": (
        write_one_array,
        "one array per view",
        "its 2 stacks are taken for cam02, cam00",
    ),
    "flat, whose views are links": (
        write_linked,
        BESIDE_TRUTH,
        "gt/ agrees with the truth of the run",
    ),
    "flat, view by view": (lambda f: write_flat(f, view_major()), BESIDE_TRUTH, "view after view"),
    "flat, instant by instant": (
        lambda f: write_flat(f, by_frame),
        BESIDE_TRUTH,
        "instant after instant",
    ),
    "flat, by alphabet": (
        lambda f: write_flat(f, by_alphabet),
        BESIDE_TRUTH,
        "cam00, cam02 in frames 2-4",
    ),
    "flat, the whole capture": (
        lambda f: write_flat(f, whole_capture),
        BESIDE_TRUTH,
        "8 pictures of other frames",
    ),
    "a 3DGS model folder": (
        lambda f: write_flat(f / "test" / "ours_30000", view_major()).parents[1],
        BESIDE_TRUTH,
        "order determined",
    ),
    "a 4DGaussians model folder": (write_4dgaussians, BESIDE_TRUTH, "view after view"),
    "easyvolcap": (write_easyvolcap, "EasyVolcap output", "_gt pictures agree"),
    "easyvolcap, a tag": (
        lambda f: write_easyvolcap(f / "ours_b").parent,
        "EasyVolcap output",
        "2 = cam02, 0 = cam00",
    ),
    "easyvolcap, renders alone": (
        lambda f: write_easyvolcap(f, False) / "RENDER",
        "EasyVolcap output",
        "no _gt pictures",
    ),
    "easyvolcap, the whole capture": (
        lambda f: write_easyvolcap(f, False, range(N_FRAMES)),
        "EasyVolcap output",
        "frames of 0-6, the whole capture, 2-4 are used",
    ),
    "nerfbaselines": (write_nerfbaselines, BESIDE_TRUTH, "gt-color/ agrees"),
    "nerfbaselines, images/": (
        lambda f: write_nerfbaselines(f, "images/{view}/{frame:04d}.png"),
        BESIDE_TRUTH,
        "agrees",
    ),
    "nerfbaselines, flat names": (
        lambda f: write_nerfbaselines(f, "{view}_{frame:04d}.png"),
        BESIDE_TRUTH,
        "agrees",
    ),
    "nerfbaselines without views": (
        lambda f: pack_names(write_flat(f, view_major(), ("color", "gt-color"))),
        BESIDE_TRUTH,
        "order determined by comparing gt-color/",
    ),
    "nerfbaselines without truth": (
        lambda f: write_nerfbaselines(f, copies=False),
        BESIDE_TRUTH,
        "no complete gt-color/",
    ),
    "zip": (
        lambda f: pack(write_nerfbaselines(f), f.with_name("a.zip")),
        f"{BESIDE_TRUTH} in an archive",
        "agrees",
    ),
    "tar.gz": (
        lambda f: pack(write_nerfbaselines(f), f.with_name("a.tar.gz")),
        f"{BESIDE_TRUTH} in an archive",
        "agrees",
    ),
    "zip of a folder in it": (
        lambda f: pack(write_folders(f / "results").parent, f.with_name("a.zip")),
        "<view>/<frame>.png in an archive",
        AS_THEY_ARE,
    ),
}


def pack_names(folder: Path) -> Path:
    (folder / "info.json").write_text("{}")
    return folder


@pytest.mark.parametrize("case", EXACT)
def test_lossless_renders_arrive_bit_for_bit(case, truth_run, tmp_path):
    """Whatever the layout, every picture lands at its view and frame with its very values, and the
    record says how.
    """
    write, kind, note = EXACT[case]

    record = import_renders(truth_run, "mine", write(tmp_path / "theirs"))

    assert largest_difference(truth_run) == 0
    assert record["kind"] == kind
    assert note in " | ".join(record["notes"])
    assert "" not in record["notes"]
    assert record["partial"] == ""


def test_easyvolcap_of_another_capture_is_refused(truth_run, tmp_path):
    """A copy of the truth that shows another camera, and a camera number that the capture lacks,
    are told.
    """
    folder = write_easyvolcap(tmp_path / "theirs") / "RENDER"
    shutil.copy(folder / "frame0003_camera0002_gt.png", folder / "frame0003_camera0000_gt.png")
    with refused(RenderError, "frame0003_camera0000_gt.png", "frame 3 of cam00"):
        import_renders(truth_run, "mine", tmp_path / "theirs")

    shutil.copy(folder / "frame0003_camera0002.png", folder / "frame0003_camera0007.png")
    with refused(RenderError, "0 to 2", "got 7"):
        import_renders(truth_run, "mine", tmp_path / "theirs")


def test_easyvolcap_with_several_tags_is_asked_for_one(truth_run, tmp_path):
    """Where an experiment holds several sets of renders the message names them."""
    for tag in ("a", "b"):
        write_easyvolcap(tmp_path / "theirs" / tag)

    with refused(RenderError, "a/RENDER, b/RENDER"):
        import_renders(truth_run, "mine", tmp_path / "theirs")


def test_a_video_of_another_rate_shows_other_instants(truth_run, tmp_path):
    """Of another rate and number of frames, frame k is not instant k: both are named; equal numbers
    are taken in order.
    """
    fewer = range(FRAMES.start, FRAMES.stop - 1)
    with refused(RenderError, "24 frames per second", "the capture 30", "fps=30"):
        import_renders(truth_run, "mine", write_videos(tmp_path / "slow", fewer, fps=24.0))
    assert (
        import_renders(truth_run, "mine", write_videos(tmp_path / "same", FRAMES, fps=24.0))[
            "partial"
        ]
        == ""
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "frames", [FRAMES, range(N_FRAMES)], ids=["the protocol's frames", "the whole capture"]
)
def test_a_video_per_view_is_decoded_to_its_frames(frames, truth_run, tmp_path):
    """A video of the protocol's frames or of the whole capture gives each frame at its instant, but
    for its coding.
    """
    record = import_renders(truth_run, "mine", write_videos(tmp_path / "theirs", frames), workers=2)

    for view, frame in view_major():
        image = read_image(frame_path(truth_run.renders("mine", view), frame)).astype(float)
        near = {other: np.abs(image - rendered(view, other)).mean() for other in range(N_FRAMES)}
        assert min(near, key=lambda other: near[other]) == frame
        assert near[frame] < 4
    assert any("decoded from video" in note for note in record["notes"])


def test_jpeg_is_decoded_once_and_said(truth_run, tmp_path):
    """JPEG frames become PNG frames of the decoded values, and the record says how many."""
    write_folders(tmp_path / "theirs", pattern="{view}/{number:04d}.jpg")

    record = import_renders(truth_run, "mine", tmp_path / "theirs")

    file = frame_path(truth_run.renders("mine", "cam00"), 3)
    np.testing.assert_array_equal(
        read_image(file), read_image(tmp_path / "theirs" / "cam00" / "0003.jpg")
    )
    assert file.read_bytes().startswith(b"\x89PNG")
    assert (
        "cam00: 3 frames (2-4) of JPEG, decoded once to PNG: coding errors count against the method"
        in record["notes"]
    )


@pytest.mark.parametrize("link", [False, True], ids=["copied", "linked"])
def test_png_files_are_copied_or_linked_and_stay_theirs(
    truth_run, tmp_path, link, monkeypatch, capsys
):
    """PNG frames are copies of the very bytes, of which a line tells the size before, or links; a
    JPEG called .png is decoded.
    """
    monkeypatch.setattr(import_module, "TOLD_BYTES", 0)
    write_folders(tmp_path / "theirs")
    write_picture(tmp_path / "jpeg.jpg", rendered("cam00", 3))
    shutil.copy(tmp_path / "jpeg.jpg", tmp_path / "theirs" / "cam00" / "0003.png")

    import_renders(truth_run, "mine", tmp_path / "theirs", link=link)

    file, theirs = (
        frame_path(truth_run.renders("mine", "cam02"), 3),
        tmp_path / "theirs" / "cam02" / "0003.png",
    )
    assert file.is_symlink() == link
    assert file.read_bytes() == theirs.read_bytes()
    assert ("mine: copying 0 MB of frames into the run" in capsys.readouterr().err) == (not link)
    assert not frame_path(truth_run.renders("mine", "cam00"), 3).is_symlink()


def test_what_was_unpacked_stays_without_the_archive(truth_run, tmp_path):
    """Frames of an archive are files of the run; nothing temporary is left beside them."""
    archive = pack(write_folders(tmp_path / "theirs"), tmp_path / "theirs.zip")

    import_renders(truth_run, "mine", archive)
    archive.unlink()

    assert largest_difference(truth_run) == 0
    assert sorted(item.name for item in (truth_run.root / "renders").iterdir()) == ["mine"]


@pytest.mark.parametrize("case", ["folders", "zip", "flat, view by view", "uint8 arrays"])
def test_a_second_call_does_nothing(case, truth_run, tmp_path):
    """The same files are not imported again."""
    source = EXACT[case][0](tmp_path / "theirs")
    first = import_renders(truth_run, "mine", source)
    folder = truth_run.root / "renders" / "mine"
    before = folder.stat().st_ino, folder.stat().st_mtime_ns

    again = import_renders(truth_run, "mine", source)

    assert (folder.stat().st_ino, folder.stat().st_mtime_ns) == before
    assert again == first == read_json(folder / "import.json")


@pytest.mark.parametrize("suffix", ["", ".zip"], ids=["folder", "archive"])
def test_a_changed_file_is_noticed(suffix, truth_run, tmp_path):
    """Where a frame was rendered again, the import is made again in place of the old."""
    folder = write_folders(tmp_path / "theirs")
    source = pack(folder, tmp_path / "theirs.zip") if suffix else folder
    first = import_renders(truth_run, "mine", source)
    write_image(folder / "cam00" / "0003.png", truth("cam00", 3))
    source = pack(folder, tmp_path / "theirs.zip") if suffix else folder

    second = import_renders(truth_run, "mine", source)

    assert second["sha256"] != first["sha256"]
    np.testing.assert_array_equal(
        read_image(frame_path(truth_run.renders("mine", "cam00"), 3)), truth("cam00", 3)
    )


@pytest.mark.slow
def test_one_frame_of_a_large_stack_is_noticed(tmp_path):
    """An uncompressed array keeps its size when a frame in its middle is replaced; the import is
    made again all the same.
    """
    frames = range(480)
    run, folder = (
        make_run(tmp_path / "run", frames=frames, n_frames=len(frames)),
        tmp_path / "theirs",
    )
    folder.mkdir()
    for view in VIEWS:
        np.save(folder / f"{view}.npy", stack(view, frames=frames))
    import_renders(run, "mine", folder)
    changed = np.load(folder / "cam00.npy", mmap_mode="r+")
    changed[240] = 255 - changed[240]
    changed.flush()

    import_renders(run, "mine", folder)

    np.testing.assert_array_equal(
        read_image(frame_path(run.renders("mine", "cam00"), 240)), changed[240]
    )


def test_a_killed_import_is_made_again(truth_run, tmp_path):
    """Leftovers of a killed import are removed, lost frames are brought back."""
    source = write_folders(tmp_path / "theirs")
    (
        truth_run.root
        / "renders"
        / f".mine.{socket.gethostname().replace('.', '-')}.4194304000.tmp"
        / "cam00"
    ).mkdir(parents=True)
    import_renders(truth_run, "mine", source)
    frame_path(truth_run.renders("mine", "cam00"), 3).unlink()

    import_renders(truth_run, "mine", source)

    assert largest_difference(truth_run) == 0
    assert [item.name for item in (truth_run.root / "renders").iterdir()] == ["mine"]


@pytest.mark.parametrize("case", ["folders", "uint8 arrays"])
def test_a_frame_that_was_changed_in_the_run_comes_back(case, truth_run, tmp_path):
    """What lies in the run is what was rendered, linked or decoded."""
    source = EXACT[case][0](tmp_path / "theirs")
    import_renders(truth_run, "mine", source)
    frame = frame_path(truth_run.renders("mine", "cam00"), 3)
    frame.unlink()
    write_image(frame, 255 - rendered("cam00", 3))

    import_renders(truth_run, "mine", source)

    assert largest_difference(truth_run) == 0


def test_the_record_names_every_source_file(truth_run, tmp_path):
    """import.json holds the kind, the last part of the path and a digest of each file, and no
    absolute path.
    """
    import_renders(truth_run, "mine", write_folders(tmp_path / "theirs"))

    text = (truth_run.root / "renders" / "mine" / "import.json").read_text()
    record = read_json(truth_run.root / "renders" / "mine" / "import.json")

    assert (record["kind"], record["source"]) == ("<view>/<frame>.png", "theirs")
    assert sorted(record["identity"]["files"]) == [
        f"cam0{view}/000{frame}.png" for view in (0, 2) for frame in FRAMES
    ]
    assert len(set(record["identity"]["files"].values())) == 6
    assert str(tmp_path) not in text


def test_a_run_with_several_methods_is_asked_by_name(truth_run, tmp_path):
    """Of a run folder with several methods the one of the given name is taken; without one the
    error lists them.
    """
    other = make_run(tmp_path / "other")
    write_folders(other.root / "renders" / "mine")
    write_folders(other.root / "renders" / "worse", numbers=range(2, 5))

    import_renders(truth_run, "mine", other.root)

    assert largest_difference(truth_run) == 0
    with refused(RenderError, "mine, worse"):
        import_renders(truth_run, "third", other.root)


@pytest.mark.parametrize("write", [write_folders, write_nerfbaselines])
def test_a_relative_path_is_as_good_as_a_whole_one(truth_run, tmp_path, monkeypatch, write):
    """Renders are named as people type them, from where they stand."""
    write(tmp_path / "theirs")
    monkeypatch.chdir(tmp_path)

    import_renders(truth_run, "mine", Path("theirs"))

    assert largest_difference(truth_run) == 0


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_pictures_on_their_side_are_turned_as_they_say(suffix, truth_run, tmp_path):
    """By their EXIF tag, as those of captures are; without it their size is not the protocol's."""
    tag = Image.Exif()
    for exif in ({}, {"exif": tag}):
        for view, frame in view_major():
            file = tmp_path / "theirs" / view / f"{frame:04d}{suffix}"
            file.parent.mkdir(parents=True, exist_ok=True)
            Image.fromarray(np.ascontiguousarray(np.rot90(rendered(view, frame)))).save(
                file, quality=98, subsampling=0, **exif
            )
        if not exif:
            with refused(RenderError, "48 x 64", "64 x 48"):
                import_renders(truth_run, "mine", tmp_path / "theirs")
        tag[0x0112] = 6

    import_renders(truth_run, "mine", tmp_path / "theirs")

    assert largest_difference(truth_run) <= (0 if suffix == ".png" else 60)
