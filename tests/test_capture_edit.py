"""One instant held still, sensor noise added: bits that a seed decides, statistics in closed form,
runs that pick it up again.
"""

import dataclasses
import json

import numpy as np
import pytest

from ggvs_eval.capture import CaptureEdit, Extras
from ggvs_eval.capture_edit import PickedFrames, perturb_capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CaptureError, ProtocolError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.commands.flags import CaptureOptions
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.run.evaluate import reopen
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.protocol import CameraPath, Frames, Synthesis, Views, load_protocol
from ggvs_eval.run_folder import frame_path, read_json
from helpers.captures import N_FRAMES, NAMES, make_image, make_rig, write_folders, write_poses

HELD = CaptureEdit(hold_frames=6, hold_frame=2, sensor_noise_255=1.5, noise_seed=7)


@pytest.fixture
def folder(tmp_path):
    """A capture of lossless frames; frame and camera can be told from the colour."""
    write_poses(tmp_path / "scene", make_rig())
    write_folders(tmp_path / "scene")
    return tmp_path / "scene"


@pytest.fixture
def folder_capture(folder):
    return open_capture(folder)


def test_one_instant_is_held_still(folder_capture):
    """Without noise every instant shows the held one, for every camera, for as long as wanted."""
    held = perturb_capture(folder_capture, CaptureEdit(hold_frames=9, hold_frame=3))

    assert held.n_frames == 9
    for camera, name in enumerate(NAMES):
        for image in held.frames(name):
            np.testing.assert_array_equal(image, make_image(camera, 3))


def test_noise_has_its_sigma_and_nothing_in_common(folder_capture):
    """Noise of 1.5 levels (and 1/12 for rounding), no mean, uncorrelated between instants and
    between cameras.
    """
    held = perturb_capture(folder_capture, HELD)
    grain = np.stack(
        [
            [image - make_image(camera, 2).astype(float) for image in held.frames(name)]
            for camera, name in enumerate(NAMES)
        ]
    )  # (cameras, instants, H, W, 3)
    flat = grain.reshape(len(NAMES) * 6, -1)
    correlations = np.corrcoef(flat) - np.eye(len(flat))

    assert grain.std() == pytest.approx(np.sqrt(1.5**2 + 1 / 12), rel=0.01)
    assert abs(grain.mean()) < 0.02
    assert np.abs(correlations).max() < 5 / np.sqrt(flat.shape[1])


def test_equal_seeds_give_equal_bits_in_any_order(folder_capture):
    """Frames are the same asked for one by one, backwards, or as a stream; another seed gives
    others.
    """
    held, again = perturb_capture(folder_capture, HELD), perturb_capture(folder_capture, HELD)
    stream = list(held.frames("cam01"))

    for frame in reversed(range(6)):
        np.testing.assert_array_equal(again.frame("cam01", frame), stream[frame])
    other = perturb_capture(folder_capture, dataclasses.replace(HELD, noise_seed=8))
    assert not np.array_equal(other.frame("cam01", 0), stream[0])


def test_a_camera_keeps_its_noise_without_the_others(folder_capture):
    """The noise of a camera does not depend on which other cameras there are."""
    np.testing.assert_array_equal(
        perturb_capture(folder_capture.without(["cam00"], "test"), HELD).frame("cam02", 4),
        perturb_capture(folder_capture, HELD).frame("cam02", 4),
    )


def test_a_moving_capture_goes_on_moving(folder_capture):
    """Noise alone leaves time, number of frames and content as they are."""
    noisy = perturb_capture(folder_capture, CaptureEdit(sensor_noise_255=1.5))

    assert noisy.n_frames == N_FRAMES
    for frame, image in enumerate(noisy.frames("cam03")):
        error = image - make_image(3, frame).astype(float)
        assert 1.3 < error.std() < 1.8
        assert abs(error.mean()) < 0.1


def test_noise_is_clipped_like_an_image(folder_capture):
    """Noise of 80 levels wraps round nowhere: black and white are its ends."""
    image = perturb_capture(folder_capture, CaptureEdit(sensor_noise_255=80.0)).frame("cam00", 0)

    dark = make_image(0, 0)[..., :2] == 30
    assert 0.2 < (image[..., :2][dark] == 0).mean() < 0.5  # P(30 + 80 n < 0.5) = 0.36
    assert image[..., :2][dark].mean() < 80


def test_digests_tell_what_was_done(folder_capture):
    """Held, noisy, other noise, longer, as taken: five inputs, five digests."""
    kinds = [
        CaptureEdit(),
        CaptureEdit(hold_frames=6),
        CaptureEdit(hold_frames=7),
        HELD,
        dataclasses.replace(HELD, noise_seed=8),
    ]

    assert len({perturb_capture(folder_capture, kind).digest("cam00") for kind in kinds}) == len(
        kinds
    )
    assert perturb_capture(folder_capture, CaptureEdit()) is folder_capture


def test_measured_depth_is_held_too(folder_capture):
    """Depth that a sensor measured stays with the held instant, without noise."""

    class Depths:
        n_frames, digest = N_FRAMES, "depths"

        def depths(self, start, stop):
            yield from (np.full((2, 3), t + 1.0, np.float32) for t in range(start, stop))

    with_depth = dataclasses.replace(
        folder_capture, extras=tuple(Extras(depth=Depths()) for _ in NAMES)
    )
    depth = perturb_capture(with_depth, HELD).extras_of("cam01").depth

    assert isinstance(depth, PickedFrames)
    assert [float(each[0, 0]) for each in depth.depths(1, 4)] == [3.0, 3.0, 3.0]


@pytest.mark.parametrize(
    ("wanted", "message"),
    [
        (
            CaptureEdit(hold_frames=4, hold_frame=N_FRAMES),
            f"wanted frame {N_FRAMES} held still, the capture has {N_FRAMES}",
        ),
        (CaptureEdit(hold_frame=1), "wanted hold_frames"),
        (CaptureEdit(hold_frames=-1), "hold_frames -1"),
        (CaptureEdit(sensor_noise_255=-0.5), "sensor_noise_255 -0.5"),
        (CaptureEdit(sensor_noise_255=float("nan")), "sensor_noise_255 nan"),
    ],
)
def test_what_cannot_be_is_refused(folder_capture, wanted, message):
    """An instant that is not there, or a number that means nothing, is refused in one line."""
    with pytest.raises(CaptureError, match=message) as caught:
        perturb_capture(folder_capture, wanted)
    assert "\n" not in str(caught.value)


def test_noise_is_added_once(folder_capture):
    """A noisy capture is not made noisy again: what a run records would no longer say what was
    done.
    """
    with pytest.raises(CaptureError, match="open it again"):
        perturb_capture(perturb_capture(folder_capture, HELD), HELD)


def test_the_command_line_says_what_it_did(folder, capsys):
    """`--hold-frames 6 ...` gives these frames, and a note of them."""
    opened = CaptureOptions(hold_frames=6, hold_frame=2, sensor_noise_255=1.5, noise_seed=7).open(
        folder
    )

    np.testing.assert_array_equal(
        opened.frame("cam00", 5), perturb_capture(open_capture(folder), HELD).frame("cam00", 5)
    )
    assert "frame 2 held still for 6 instants, sensor noise of 1.5/255" in capsys.readouterr().err


@pytest.fixture
def protocol(tmp_path):
    base = load_protocol("demo")
    measurement = dataclasses.replace(base.measurement, metrics=("PSNR",))
    changed = dataclasses.replace(
        base,
        views=Views(("cam00",), "test"),
        frames=Frames(0, 2),
        synthesis=Synthesis(2),
        path=CameraPath(3),
        measurement=measurement,
    )
    (tmp_path / "protocol.toml").write_text(changed.to_toml())
    return changed


@pytest.mark.slow
def test_a_run_picks_up_the_same_frames_again(folder, protocol, tmp_path):
    """A run prepared with held frames and noise, opened again from its folder alone, has the same
    cameras, frames and depth.
    """
    arguments = (
        "--hold-frames",
        "2",
        "--hold-frame",
        "1",
        "--sensor-noise",
        "1.5",
        "--noise-seed",
        "3",
        "--jobs",
        "1",
    )
    run_command(
        [
            "prepare",
            str(tmp_path / "run"),
            "--capture",
            str(folder),
            "--protocol",
            str(tmp_path / "protocol.toml"),
            *arguments,
        ]
    )
    wanted = perturb_capture(open_capture(folder), CaptureEdit(2, 1, 1.5, 3))
    first = read_image(frame_path(tmp_path / "run" / "truth" / "cam00", 1))
    depth = sorted((tmp_path / "run" / "depth").rglob("*.np*"))

    frame_path(tmp_path / "run" / "truth" / "cam00", 1).unlink()
    again = reopen(tmp_path / "run", workers=1)

    assert again.capture.edit == wanted.edit
    assert "noise" in read_json(tmp_path / "run" / "capture.json")["notes"][-1]
    np.testing.assert_array_equal(first, wanted.frame("cam00", 1))
    np.testing.assert_array_equal(
        read_image(frame_path(tmp_path / "run" / "truth" / "cam00", 1)), first
    )
    assert sorted((tmp_path / "run" / "depth").rglob("*.np*")) == depth
    with pytest.raises(ProtocolError, match="other frames"):
        prepare(
            tmp_path / "run",
            perturb_capture(open_capture(folder), CaptureEdit(2, 1, 1.5, 4)),
            protocol,
        )


def test_the_true_path_is_left_away_where_it_shows_another_instant(folder, protocol, tmp_path):
    """A path rendered at one instant is the truth where that is held still, and none where another
    is.
    """
    write_poses(folder / "path", make_rig())
    for pose in range(4):
        write_image(folder / "path" / "images" / f"{pose:04d}.png", make_image(pose, 2))
    (folder / "demo.json").write_text(json.dumps({"units_per_metre": 1.0, "path_time_s": 2 / 30}))
    capture = open_capture(folder)
    there, elsewhere = (
        prepare(tmp_path / f"held{at}", perturb_capture(capture, CaptureEdit(2, at)), protocol)
        for at in (2, 1)
    )

    assert there.path_images is not None
    assert elsewhere.path_images is None
    assert reopen(tmp_path / "held1", workers=1).capture.edit == CaptureEdit(2, 1)
    assert elsewhere.path
