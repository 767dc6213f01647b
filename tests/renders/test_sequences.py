"""Videos and depth videos without a capture: every form that people have them in, and what is told
where there is none.
"""

import cv2
import numpy as np
import pytest

from ggvs_eval.depth_store import DepthMap, DepthStore
from ggvs_eval.errors import CaptureError, RenderError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.renders.sequences import read_depths, read_frames
from helpers.refusals import refused

DEPTHS = np.random.default_rng(0).uniform(1, 9, (3, 12, 16)).astype(np.float32)
FRAMES = np.random.default_rng(1).integers(0, 256, (3, 12, 16, 3), dtype=np.uint8)


def write_store(folder):
    store = DepthStore(folder)
    key = store.write_spec({"what": "a test"})
    for index, depth in enumerate(DEPTHS):
        store.write(key, index, DepthMap(depth, np.ones_like(depth)))
    return store.folder(key)


def write_each(folder, suffix):
    """One file per map; 16-bit pictures hold thousandths."""
    folder.mkdir()
    for index, depth in enumerate(DEPTHS):
        name = folder / f"depth_{index + 8}{suffix}"  # 8, 9, 10: not the order of the alphabet
        if suffix == ".npy":
            np.save(name, depth)
        elif suffix == ".npz":
            np.savez(name, depth=depth, confidence=depth)
        else:
            cv2.imwrite(
                str(name), np.rint(1000 * depth).astype(np.uint16) if suffix == ".png" else depth
            )
    return folder


@pytest.mark.parametrize("suffix", [".png", ".tif", ".pfm", ".npy", ".npz"])
def test_folders_of_depth_are_read_in_order(suffix, tmp_path):
    """Each kind of file gives the same maps, in the order of their numbers."""
    read = np.stack(list(read_depths(write_each(tmp_path / "maps", suffix))))

    assert read.dtype == np.float32
    assert read / (1000 if suffix == ".png" else 1) == pytest.approx(DEPTHS, abs=6e-4)


def test_arrays_stores_and_videos_of_depth_are_read(tmp_path):
    """A stack, this package's own store, and a video of grey levels."""
    np.save(tmp_path / "stack.npy", DEPTHS)
    grey = np.repeat((20 * DEPTHS).astype(np.uint8)[..., None], 3, axis=-1)
    write_video(
        tmp_path / "depth.mp4",
        [np.full((16, 16, 3), level, np.uint8) for level in (40, 80, 120)],
        30,
        crf=0,
    )

    assert np.array_equal(list(read_depths(tmp_path / "stack.npy")), DEPTHS)
    assert np.array_equal(list(read_depths(write_store(tmp_path / "store"))), DEPTHS)
    assert [depth.mean() for depth in read_depths(tmp_path / "depth.mp4")] == pytest.approx(
        [40, 80, 120], abs=1
    )
    np.savez(tmp_path / "one.npz", levels=grey[..., 0])
    assert np.array_equal(list(read_depths(tmp_path / "one.npz")), grey[..., 0].astype(np.float32))


def test_frames_are_read_in_every_form(tmp_path):
    """Pictures by their numbers, arrays of both kinds."""
    (tmp_path / "frames").mkdir()
    for index, frame in enumerate(FRAMES):
        write_image(tmp_path / "frames" / f"{index + 9}.png", frame)
    np.save(tmp_path / "frames.npy", FRAMES)
    np.savez(tmp_path / "frames.npz", frames=FRAMES / 255.0)

    for path in ("frames", "frames.npy", "frames.npz"):
        assert np.array_equal(list(read_frames(tmp_path / path)), FRAMES)


@pytest.mark.parametrize(
    ("make", "read", "words"),
    [
        (
            lambda path: None,
            read_depths,
            r"wanted a folder of depth maps, .*got no such path; check it",
        ),
        (
            lambda path: path.write_text("no"),
            read_frames,
            "wanted a folder of pictures, .*got another kind",
        ),
        (lambda path: path.mkdir(), read_depths, r"wanted depth maps \(.png, .*\), got none"),
        (lambda path: path.mkdir(), read_frames, r"wanted pictures \(.png, .*\), got none"),
    ],
)
def test_what_is_no_video_is_told(make, read, words, tmp_path):
    """One line that names the path and says what is wanted there."""
    make(tmp_path / "given")
    with pytest.raises(RenderError, match=words):
        list(read(tmp_path / "given"))


def test_what_is_no_depth_is_told(tmp_path):
    """Pictures of colour maps, channels, two kinds of files at once, objects, and damaged files."""
    folder = tmp_path / "maps"
    folder.mkdir()
    cv2.imwrite(str(folder / "0.png"), FRAMES[0])
    with refused(RenderError, "0.png", "one channel", "colours"):
        list(read_depths(folder))
    np.save(folder / "0.npy", DEPTHS[0])
    with refused(RenderError, "0.npy", "one kind of file"):
        list(read_depths(folder))
    (folder / "0.png").write_bytes(b"\x89PNG\r\n\x1a\nnothing")
    (folder / "0.npy").unlink()
    with pytest.raises((RenderError, CaptureError), match=r"0\.png: wanted"):
        list(read_depths(folder))
    np.save(tmp_path / "one.npy", DEPTHS[0])
    with refused(RenderError, "(T, H, W)", "(12, 16)"):
        list(read_depths(tmp_path / "one.npy"))
    np.save(tmp_path / "objects.npy", np.array([None]), allow_pickle=True)
    with refused(RenderError, "objects.npy", "numbers"):
        list(read_depths(tmp_path / "objects.npy"))
    np.savez(tmp_path / "two.npz", a=DEPTHS, b=DEPTHS)
    with refused(RenderError, "one array", "a, b", "depth"):
        list(read_depths(tmp_path / "two.npz"))
