"""Rigs on which the method cannot work are refused from their calibration alone, in one line,
before anything is computed.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.errors import CameraError
from ggvs_eval.files.images import write_image
from ggvs_eval.geometry.sight import require_sight, shown_share
from ggvs_eval.geometry.source_views import choose_sources
from ggvs_eval.pipelines.inspection.capture.depth_range import check_overlap
from helpers.command_line import refusal

K = np.array([[90.0, 0, 48], [0, 90, 36], [0, 0, 1]])


def ring(angles_deg) -> list[Camera]:
    """Cameras on a circle of radius 3 that look at its middle."""
    cameras = []
    for index, angle in enumerate(np.deg2rad(angles_deg)):
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = [
            [np.cos(angle), 0, np.sin(angle)],
            [0, 1, 0],
            [-np.sin(angle), 0, np.cos(angle)],
        ]
        world_to_camera[:3, 3] = (0, 0, 3)
        cameras.append(Camera(f"cam{index:02d}", K, world_to_camera, 96, 72, 2.0, 5.0))
    return cameras


def nearest(cameras: list[Camera], index: int, k: int) -> list[Camera]:
    return [each.camera for each in choose_sources(cameras[index], cameras, k)]


def test_what_can_be_shown_falls_with_the_spacing():
    """Five cameras ever farther apart: all is shown, then less and less, then nothing."""
    spacings = (5, 10, 20, 30, 45, 60, 90)
    shares = []
    for spacing in spacings:
        cameras = ring(spacing * np.arange(-2, 3))
        shares.append(shown_share(cameras[2], nearest(cameras, 2, 4), cameras))
    assert shares[0] > 0.95
    assert shares == sorted(shares, reverse=True)
    assert shares[-1] == 0


def test_a_sensor_spares_the_stereo():
    """Two cameras have no partner but the target to be matched with; with depth of their own they
    show what they see.
    """
    cameras = ring([-20, 0, 100])
    target, sources = cameras[0], cameras[1:]
    assert shown_share(target, sources, cameras) == 0
    assert shown_share(target, sources, cameras, sensed=("cam01",)) > 0.8


def test_four_wide_cameras_are_refused_in_one_line():
    """As a studio with a camera in each corner: the message says how far away the sources look from
    and what would help.
    """
    cameras = ring([0, 50, 170, 235])
    with pytest.raises(CameraError) as caught:
        require_sight(cameras[0], nearest(cameras, 0, 3), cameras)
    message = str(caught.value)
    assert "\n" not in message
    assert message.startswith("camera cam00: its 3 sources are 47 degrees away (cam01) or more")
    assert "show 0% of its view with recoverable depth, wanted 40%" in message
    assert message.endswith(
        "add cameras between, 20 degrees apart or less, or remove it from the test views"
    )


def test_the_other_choice_is_offered_where_it_helps():
    """Near places that look elsewhere: chosen by what they see, others would do."""
    rig = ring([0, 6, 12, 18])
    away = [
        replace(camera, name=f"away{index}", world_to_camera=_backwards(camera))
        for index, camera in enumerate(rig[:2])
    ]
    cameras = [*rig, *away]
    with pytest.raises(
        CameraError, match=r'set synthesis\.sources = "coverage", whose sources see [89][0-9]%'
    ):
        require_sight(rig[0], away, cameras)


def _backwards(camera: Camera) -> np.ndarray:
    """The pose of a camera at the same place that looks the other way."""
    return np.diag([-1.0, 1.0, -1.0, 1.0]) @ camera.world_to_camera


def test_the_check_says_it_too():
    """Bad where no camera can be synthesised from the others, a warning where one cannot, nothing
    on a usual rig.
    """
    rig, *each = check_overlap(ring([0, 50, 170, 235]))
    assert (rig.verdict, {finding.verdict for finding in each}) == ("bad", {"warn"})
    assert "no camera can be synthesised from the others" in rig.measured
    assert "add cameras between" in rig.advice

    rig, *each = check_overlap(ring([0, 8, 16, 24, 120]))
    assert [finding.verdict for finding in (rig, *each)] == ["ok", "ok", "ok", "ok", "ok", "warn"]
    assert each[-1].values["shown_share"] < 0.1

    assert {finding.verdict for finding in check_overlap(ring([0, 8, 16, 24]))} == {"ok"}


def test_runs_are_refused_before_anything_is_computed(tmp_path):
    """`run` and `prepare` of such a capture end with that line; no folder is made."""
    lines = []
    for camera in ring([0, 50, 170, 235]):
        write_image(tmp_path / "images" / f"{camera.name}.png", np.full((72, 96, 3), 99, np.uint8))
        lines += [
            "[[camera]]",
            f'name = "{camera.name}"',
            f'frames = "images/{camera.name}.png"',
            "width = 96",
            "height = 72",
        ]
        lines += [
            f"K = {K.tolist()}",
            f"world_to_camera = {camera.world_to_camera.tolist()}",
            "near = 2.0",
            "far = 5.0",
        ]
    (tmp_path / "capture.toml").write_text("\n".join(["units_per_metre = 1.0", *lines]))
    for verb in ("run", "prepare"):
        message = refusal(verb, tmp_path / "out", "--capture", tmp_path)
        assert "camera cam01: its 3 sources are" in message
        assert not (tmp_path / "out").exists()
