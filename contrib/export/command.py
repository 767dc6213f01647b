"""The verb of the command line that gives Gaussians to others' viewers: export."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import CommandError, RenderError
from ggvs_eval.pipelines.commands.flags import Layout

FPS = 30.0  # of a sequence whose capture is not given
Direction = Annotated[tuple[float, float, float] | None, tyro.conf.arg(metavar="X Y Z")]


def export(
    splats: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="SPLATS")],
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.glb")],
    capture: Path | None = None,
    fps: float | None = None,
    up: Direction = None,
    frames: int | None = None,
    degree: Literal[0, 1, 2, 3] | None = None,
    layout: Layout = None,
) -> None:
    """Write 3D Gaussians as one .glb (glTF, KHR_gaussian_splatting).

    A sequence becomes an animation.

    Args:
        splats: .ply, folder with one per instant, output of 4DGS, or a fit (RUN/fits/LABEL/all).
        out: file to write.
        capture: their capture; supplies frame rate, up direction, and clip length of 4DGS output.
        fps: frame rate, frames per second; the capture's, or 30, by default.
        up: up direction in the world; that of the capture's cameras, or +Y, by default.
        frames: number of instants, from the first; all by default.
        degree: highest degree of spherical harmonics, for a smaller file; all by default.
        layout: layout of the capture; detected by default.
    """
    from ggvs_eval.camera import up_direction
    from ggvs_eval.contrib.export.gltf import write_glb
    from ggvs_eval.pipelines.methods.sequence import open_sequence

    if out.suffix.lower() != ".glb":
        raise RenderError(f"{out}: wanted a .glb file name; use {out.with_suffix('.glb').name}")
    if not (fps is None or 0 < fps < float("inf")) or not (frames is None or frames > 0):
        raise CommandError(
            f"wanted --fps above 0 and --frames of at least 1, got {fps} and {frames}"
        )
    opened = open_capture(capture, layout) if capture else None
    sequence = open_sequence(splats, opened.n_frames if opened else None)
    rate = fps or (opened.fps if opened else 0) or FPS
    direction = up if up or not opened else tuple(up_direction(opened.cameras))
    instants = list(sequence.instants)[:frames]
    write_glb(out, instants, sequence.cloud, fps=rate, degree=degree, up=direction)
    length = (
        f"{len(instants)} instants at {rate:g} frames per second"
        if len(instants) > 1
        else "one instant"
    )
    print(f"{out}: {length}, {out.stat().st_size / 1e6:.1f} MB")
