"""The smallest capture and protocol that a whole run can be made of."""

from dataclasses import replace
from pathlib import Path

import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.protocol import CameraPath, Frames, Protocol, Synthesis, Views, load_protocol
from helpers.packed_films import unpack_film

LABELS = ("no-blending", "distance-based")


def leave_out_pixels(patch: pytest.MonkeyPatch) -> None:
    """Let figures of reports be composed but not drawn, which takes longer than all else of a
    report.
    """
    from matplotlib.figure import Figure

    patch.setattr(Figure, "savefig", lambda _self, file, **_: Path(file).write_bytes(b"no pixels"))


def leave_out_figures(patch: pytest.MonkeyPatch) -> None:
    """Let reports be written without figures of runs and parts of errors, most of their time;
    `tests/reports` shows both.
    """
    from ggvs_eval.reports import report
    from ggvs_eval.reports.tables import error_budget

    patch.setattr(report, "_figures", lambda *_: [])
    patch.setattr(error_budget, "budget_table", lambda _run: None)


def write_small_capture(folder: Path, n_frames: int = 12) -> Capture:
    """Six packed cameras of 64 x 48 in two rows, without depth; protocols take as many of their
    twelve frames as they want.
    """
    assert n_frames <= 12
    return open_capture(unpack_film("small", folder, with_depth=False))


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
