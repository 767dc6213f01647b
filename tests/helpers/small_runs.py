"""The smallest capture and protocol that a whole run can be made of."""

from dataclasses import replace
from pathlib import Path

import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets import open_capture
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis, Views, load_protocol

LABELS = ("no-blending", "distance-based")


def leave_out_pixels(patch: pytest.MonkeyPatch) -> None:
    """Let figures of reports be composed but not drawn, which takes longer than all else of a report."""
    from matplotlib.figure import Figure

    patch.setattr(Figure, "savefig", lambda _self, file, **_: Path(file).write_bytes(b"no pixels"))


def leave_out_figures(patch: pytest.MonkeyPatch) -> None:
    """Let reports be written without figures of runs and parts of errors, most of their time; `tests/reports` shows both."""
    from ggvs_eval.reports import report, run_groups

    leave_out_pixels(patch)  # of sweeps
    patch.setattr(report, "_figures", lambda *_: [])
    patch.setattr(run_groups, "budget_table", lambda _run: None)


def small_options(n_frames: int) -> DemoOptions:
    """Six cameras of 64 x 48 in two rows."""
    return DemoOptions(width=64, height=48, n_frames=n_frames, cameras_per_row=3, path_poses=0, supersampling=1, depth_stride=0)


def write_small_capture(folder: Path, n_frames: int) -> Capture:
    """Film them."""
    return open_capture(write_demo(folder, small_options(n_frames), workers=1))


def small_protocol(n_frames: int, path_poses: int, metrics: tuple[str, ...]) -> Protocol:
    """Two test views, K = 2."""
    base = load_protocol("demo")
    return replace(
        base,
        views=Views(("cam00", "cam01"), "test"),
        frames=Frames(0, n_frames),
        synthesis=Synthesis(2),
        path=CameraPath(path_poses),
        measurement=replace(base.measurement, metrics=metrics, ceilings=False),
    )
