"""Raw videos of known lenses become pinhole videos, and lens files are read without running what
they hold.
"""

import io
import pickle
from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.arrays import Image8
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import find_rig_frames
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.images import read_image, round_levels
from ggvs_eval.files.video import VideoFrames, write_video
from ggvs_eval.pipelines.offline.calibration.known_cameras import read_known
from ggvs_eval.pipelines.offline.calibration.undistort import (
    LARGEST_PICKLE_BYTES,
    UndistortOptions,
    read_pickle,
    undistort_videos,
)
from helpers.captures import N_FRAMES, NAMES, make_image, write_dynerf, write_folders, write_videos

WIDTH, HEIGHT, FPS = 320, 180, 24.0
# A wide lens whose image holds all of the pinhole image below, in our convention (pixel centres at
# halves).
LENS_K = np.array([[150.0, 0, 162.0], [0, 152.0, 88.0], [0, 0, 1]])
FISHEYE = (0.05, -0.01, 0.002, -0.0005)
BARREL = (-0.12, 0.01, 0.001, -0.0015, 0.0)


def pattern(uv: np.ndarray, shift: float) -> np.ndarray:
    """A smooth coloured picture in closed form: its value at image coordinates of the pinhole
    image, (..., 3) in 0..255.
    """
    u, v = uv[..., 0] + shift, uv[..., 1]
    return np.stack(
        [128 + 100 * np.sin(u / 14), 128 + 100 * np.cos(v / 11), 128 + 80 * np.sin((u + v) / 19)],
        axis=-1,
    )


def pixel_centres() -> np.ndarray:
    return np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1)


def rays_of_lens(model: str, coefficients: tuple[float, ...]) -> np.ndarray:
    """Normalised pinhole coordinates that each pixel of the lens's image sees, by inverting its
    published formula, (H, W, 2).
    """
    distorted = (pixel_centres() - LENS_K[:2, 2]) / LENS_K[[0, 1], [0, 1]]
    normalised = distorted.copy()
    for _ in range(60):
        x, y = normalised[..., 0], normalised[..., 1]
        r2 = x * x + y * y
        if model == "fisheye":
            r = np.sqrt(r2)
            theta = np.arctan(r)
            k1, k2, k3, k4 = coefficients
            scale = (
                theta
                * (1 + k1 * theta**2 + k2 * theta**4 + k3 * theta**6 + k4 * theta**8)
                / np.maximum(r, 1e-12)
            )
            shift = np.zeros_like(normalised)
        else:
            k1, k2, p1, p2, _ = coefficients
            scale = 1 + k1 * r2 + k2 * r2**2
            shift = np.stack(
                [2 * p1 * x * y + p2 * (r2 + 2 * x * x), p1 * (r2 + 2 * y * y) + 2 * p2 * x * y],
                axis=-1,
            )
        normalised = (distorted - shift) / scale[..., None]
    return normalised


def raw_frames(
    model: str,
    coefficients: tuple[float, ...],
    pinhole_K: np.ndarray,
    draw: Callable[..., np.ndarray],
    count: int,
):
    """Frames as the lens sees a picture that is given on the pinhole image."""
    uv = rays_of_lens(model, coefficients) * pinhole_K[[0, 1], [0, 1]] + pinhole_K[:2, 2]
    for index in range(count):
        yield round_levels(draw(uv, 3.0 * index))


def write_raw(
    folder: Path,
    model: str,
    coefficients: tuple[float, ...],
    pinhole_K: np.ndarray,
    names=("00", "01"),
) -> Path:
    for name in names:
        write_video(
            folder / f"{name}.mp4",
            raw_frames(model, coefficients, pinhole_K, pattern, 4),
            FPS,
            crf=4,
        )
    return folder


def write_intri(path: Path, names=("00", "01")) -> Path:
    """EasyMocap's file, in OpenCV's convention (pixel centres at whole numbers)."""
    K = LENS_K.copy()
    K[:2, 2] -= 0.5
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    storage.startWriteStruct("names", cv2.FileNode_SEQ)
    for name in names:
        storage.write("", name)
    storage.endWriteStruct()
    for name in names:
        storage.write(f"K_{name}", K)
        storage.write(f"dist_{name}", np.array([BARREL]))
    storage.release()
    return path


def calibration_entries(count: int, dtype: str = "f8") -> list[dict[str, np.ndarray]]:
    K = LENS_K.copy()
    K[:2, 2] -= 0.5
    return [
        {"K": K.astype(dtype), "D": np.array(FISHEYE, dtype).reshape(4, 1)} for _ in range(count)
    ]


def psnr(image: Image8, truth: np.ndarray) -> float:
    inner = (slice(4, -4), slice(4, -4))
    return float(
        10 * np.log10(255**2 / np.square(image[inner].astype(float) - truth[inner]).mean())
    )


def refused(function: Callable[..., object], *arguments: object) -> str:
    with pytest.raises(CaptureError) as caught:
        function(*arguments)
    assert "\n" not in str(caught.value)
    return str(caught.value)


@pytest.mark.parametrize("lossless", [False, True])
def test_d3dmv_videos_become_pinhole(tmp_path, lossless):
    """A pattern distorted by the published fisheye formula comes back as it was (PSNR above 40 dB,
    35 through a second codec), 90 degrees wide around the middle of the image, with all frames and
    the rate kept.
    """
    pinhole_K = np.array([[WIDTH / 2, 0, WIDTH / 2], [0, WIDTH / 2, HEIGHT / 2], [0, 0, 1]])
    write_raw(tmp_path / "raw", "fisheye", FISHEYE, pinhole_K)
    (tmp_path / "calib_1080.pkl").write_bytes(pickle.dumps(calibration_entries(2)))
    done = undistort_videos(
        tmp_path / "raw",
        tmp_path / "calib_1080.pkl",
        tmp_path / "out",
        UndistortOptions(lossless=lossless),
    )
    assert (done.cameras, done.n_frames, done.fps) == (("00", "01"), 4, FPS)
    if lossless:
        images = [
            read_image(tmp_path / "out" / "images" / "01" / f"{index:06d}.png")
            for index in range(4)
        ]
    else:
        video = VideoFrames(tmp_path / "out" / "01.mp4")
        assert (video.n_frames, video.fps, video.size) == (4, FPS, (WIDTH, HEIGHT))
        images = list(video.frames(0, 4))
    for index, image in enumerate(images):
        assert psnr(image, pattern(pixel_centres(), 3.0 * index)) > (40 if lossless else 35)
    known = read_known(tmp_path / "out")
    assert known.keys() == find_rig_frames(tmp_path / "out").keys()  # what `calibrate` takes
    assert np.array_equal(known["00"].lens.K, pinhole_K)
    assert (known["00"].lens.is_pinhole, known["00"].lens.width, known["00"].lens.height) == (
        True,
        WIDTH,
        HEIGHT,
    )


def test_easymocap_videos_become_pinhole(tmp_path):
    """The same with EasyMocap's file and OpenCV's lens: the pinhole image keeps the lens's K."""
    write_raw(tmp_path / "raw", "opencv", BARREL, LENS_K)
    lens_file = write_intri(tmp_path / "intri.yml")
    undistort_videos(tmp_path / "raw", lens_file, tmp_path / "out", UndistortOptions(lossless=True))
    image = read_image(tmp_path / "out" / "images" / "00" / "000002.png")
    assert psnr(image, pattern(pixel_centres(), 6.0)) > 40
    np.testing.assert_allclose(read_known(tmp_path / "out")["00"].lens.K, LENS_K, atol=1e-12)


def test_capture_is_written_as_its_frames_are_read(tmp_path):
    """Without a lens file, any capture becomes lossless frames and the K of its cameras, under
    their names.
    """
    write_dynerf(tmp_path / "room")
    capture = open_capture(tmp_path / "room")
    done = undistort_videos(
        tmp_path / "room", None, tmp_path / "out", UndistortOptions(lossless=True)
    )
    assert (done.cameras, done.n_frames, done.fps) == (NAMES, N_FRAMES, 30.0)
    for index, image in enumerate(capture.frames("cam02")):
        assert np.array_equal(
            read_image(tmp_path / "out" / "images" / "cam02" / f"{index:06d}.png"), image
        )
    assert np.array_equal(read_known(tmp_path / "out")["cam03"].lens.K, capture.camera("cam03").K)


@pytest.mark.parametrize(
    ("n_frames", "fps", "message"),
    [(3, 30.0, "frame count for all cameras, got cam00 5, cam01 3"), (N_FRAMES, 25.0, "cam01 25")],
)
def test_videos_of_different_length_or_rate(tmp_path, n_frames, fps, message):
    """Cameras are refused rather than put out of step."""
    write_videos(tmp_path / "raw")
    write_video(
        tmp_path / "raw" / "cam01.mp4", (make_image(1, frame) for frame in range(n_frames)), fps
    )
    (tmp_path / "lens.toml").write_text(lens_toml())
    assert message in refused(
        undistort_videos, tmp_path / "raw", tmp_path / "lens.toml", tmp_path / "out"
    )


def lens_toml(more: str = "") -> str:
    """Lenses of the tiny captures' cameras."""
    lens = "width=64\nheight=48\nK=[[60,0,32],[0,60,24],[0,0,1]]"
    return "".join(f"[[camera]]\nname='{name}'\n{lens}\n{more}\n" for name in NAMES)


def test_lens_files_that_do_not_fit(tmp_path):
    """Too few entries, a file for another size, cameras under other names and an unknown kind of
    file are each refused.
    """
    write_videos(tmp_path / "raw")
    out = tmp_path / "out"
    (tmp_path / "few.pkl").write_bytes(pickle.dumps(calibration_entries(3)))
    assert "one entry for each of the 4 cameras, got 3" in refused(
        undistort_videos, tmp_path / "raw", tmp_path / "few.pkl", out
    )
    (tmp_path / "size.pkl").write_bytes(pickle.dumps(calibration_entries(4)))
    message = refused(undistort_videos, tmp_path / "raw", tmp_path / "size.pkl", out)
    assert "cam00: K is of about" in message
    write_intri(tmp_path / "intri.yml")
    message = refused(undistort_videos, tmp_path / "raw", tmp_path / "intri.yml", out)
    assert "wanted intrinsics of cam00, cam01, cam02, cam03" in message
    (tmp_path / "lens.txt").write_text("f = 1")
    assert "wanted intri.yml (EasyMocap)" in refused(
        undistort_videos, tmp_path / "raw", tmp_path / "lens.txt", out
    )
    assert "no such file" in refused(
        undistort_videos, tmp_path / "raw", tmp_path / "absent.pkl", out
    )


def test_image_folders_can_be_undistorted(tmp_path):
    """Frames in folders work like videos; their rate is the one that such folders are taken to
    have.
    """
    write_folders(tmp_path / "raw", NAMES, "images/{}")
    (tmp_path / "lens.toml").write_text(
        lens_toml("distortion={model='opencv', coefficients=[-0.1, 0, 0, 0]}")
    )
    done = undistort_videos(tmp_path / "raw", tmp_path / "lens.toml", tmp_path / "out")
    assert (done.n_frames, done.fps) == (N_FRAMES, 30.0)
    assert VideoFrames(tmp_path / "out" / "cam01.mp4").n_frames == N_FRAMES


@pytest.mark.parametrize("protocol", range(pickle.HIGHEST_PROTOCOL + 1))
@pytest.mark.parametrize("dtype", ["<f8", ">f8", "<f4"])
def test_pickled_arrays_of_every_protocol(tmp_path, protocol, dtype):
    """What numpy pickles, in any protocol and byte order, is read as numpy itself would read it,
    rows and columns in place.
    """
    entries = calibration_entries(10, dtype)
    entries[3]["K"] = np.asfortranarray(entries[3]["K"] + np.arange(9).reshape(3, 3))
    (tmp_path / "calib.pkl").write_bytes(pickle.dumps(entries, protocol))
    read = read_pickle(tmp_path / "calib.pkl")
    assert len(read) == 10
    for entry, truth in zip(read, entries, strict=True):
        assert entry.keys() == truth.keys()
        for key in truth:
            assert np.array_equal(entry[key], truth[key])


def test_pickle_of_python_2(tmp_path):
    """A file as Python 2 wrote it, with arrays' bytes as text, is read too."""
    content = np.arange(9, dtype="<f8").tobytes()
    text = b"\x80\x02]q\x01}q\x02U\x01KcNUMPY\n".replace(
        b"NUMPY", b"numpy.core.multiarray\n_reconstruct"
    )
    text += b"cnumpy\nndarray\nK\x00\x85U\x01b\x87R(K\x01K\x03K\x03\x86cnumpy\ndtype\nU\x02f8K\x00K\x01\x87R"  # noqa: E501
    text += (
        b"(K\x03U\x01<NNNJ\xff\xff\xff\xffJ\xff\xff\xff\xffK\x00tb\x89U"
        + bytes([len(content)])
        + content
        + b"tbsa."
    )
    (tmp_path / "calib.pkl").write_bytes(text)
    assert np.array_equal(read_pickle(tmp_path / "calib.pkl")[0]["K"], np.arange(9.0).reshape(3, 3))


@pytest.mark.parametrize(
    "content", [pickle.dumps(calibration_entries(2))[:-60], pickle.dumps(print), b"no pickle"]
)
def test_damaged_or_malicious_pickle(tmp_path, content):
    """What is cut, calls a function or is none is refused in one line that names the file."""
    (tmp_path / "calib.pkl").write_bytes(content)
    message = refused(read_pickle, tmp_path / "calib.pkl")
    assert "nothing was run" in message
    assert str(tmp_path / "calib.pkl") in message


def test_pickle_too_large(tmp_path):
    """A file far larger than any calibration is refused unread."""
    (tmp_path / "calib.pkl").write_bytes(
        io.BytesIO(b"\x80\x04" + b"N" * LARGEST_PICKLE_BYTES).getvalue()
    )
    assert "below 1 MiB" in refused(read_pickle, tmp_path / "calib.pkl")


@pytest.mark.parametrize(
    "entry",
    [
        {"K": np.eye(3)},
        {"K": np.eye(2), "D": np.zeros(4)},
        {"K": np.eye(3) * np.nan, "D": np.zeros(4)},
        3,
    ],
)
def test_entries_that_are_no_calibration(tmp_path, entry):
    """Entries without K or D, of another shape or not finite are refused, naming the camera."""
    write_videos(tmp_path / "raw", ("a", "b"), n_frames=2)
    (tmp_path / "calib.pkl").write_bytes(pickle.dumps([entry, entry]))
    message = refused(undistort_videos, tmp_path / "raw", tmp_path / "calib.pkl", tmp_path / "out")
    assert "calib.pkl: a: wanted" in message
