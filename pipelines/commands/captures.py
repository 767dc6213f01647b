"""The verbs of the command line that deal with captures alone: demo, get, protocol."""

import sys
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.datasets.public_captures import find_scene, get_capture
from ggvs_eval.errors import ProtocolError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.pipelines.commands.flags import (
    CAPTURE_DEFAULTS,
    CaptureFlags,
    CaptureFolder,
    Output,
)
from ggvs_eval.protocol import Stream, checked_protocol
from ggvs_eval.synthetic.shipped import MAIN, RoomName

MOST_NAMES = 6  # of cameras in one line


def demo(out: Output, room: RoomName = MAIN, quick: bool = False) -> None:
    """Unpack a demo capture (a procedural dynamic room) in seconds.

    Args:
        out: folder to write; absent, or holding this demo.
        room: room to unpack: the main one (DyNeRF's layout) or a small one.
        quick: main room, sample renders and a short protocol (a few seconds); other options are
            ignored.
    """
    from ggvs_eval.synthetic.shipped import write_quick, write_room

    print(write_quick(out) if quick else write_room(out, room))


def get(
    scene: Annotated[str, tyro.conf.Positional, tyro.conf.arg(metavar="DATASET:SCENE")],
) -> None:
    """Download a public capture; its name then works as --capture.

    Examples: n3v:flame_steak, immersive:02_Flames, panoptic:basketball. A stopped download resumes.
    Size and SHA-256 of the first download are stored; a later one must match.

    Args:
        scene: data set and scene; `n3v:` lists the scenes of a data set, `llff` names what to fetch
            by hand.
    """
    dataset, name = find_scene(scene)
    print(dataset.terms(name), file=sys.stderr)
    print(get_capture(scene))


def protocol(
    capture: CaptureFolder,
    out: Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT.toml")],
    checked: Annotated[Path | None, tyro.conf.arg(name="check")] = None,
    test: Annotated[tuple[str, ...], tyro.conf.arg(metavar="CAMERA ...")] = (),
    metrics: Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...")] = (),
    start: int = 0,
    frames: int | None = None,
    path_poses: int | None = None,
    stream: Annotated[float | None, tyro.conf.arg(metavar="FPS")] = None,
    reading: CaptureFlags = CAPTURE_DEFAULTS,
) -> None:
    """Propose a protocol for a capture and explain its test views.

    `run` uses the same protocol if none is given. The file can be edited.

    Args:
        capture: capture.
        out: TOML file to write.
        checked: JSON file of `check`; faulty cameras are not held out.
        test: cameras to hold out as test views; chosen by rule by default.
        metrics: metrics to measure; those of the layout's protocol by default.
        start: first instant to evaluate, from 0.
        frames: number of instants to evaluate, from the first; at most 100 by default.
        path_poses: poses of the camera path for view consistency.
        stream: frame rate of the cameras, fps, at which the displayed frames are also scored.
        reading: capture reading.
    """
    from ggvs_eval.metrics.registry import select_metrics
    from ggvs_eval.pipelines.inspection.table import text_table
    from ggvs_eval.pipelines.run.suggest_protocol import (
        hold_out,
        propose_protocol,
        published_protocols,
        read_doubts,
    )

    if out.exists():
        raise ProtocolError(
            f"{out}: wanted a new file for the protocol, got an existing one; choose another name"
        )
    opened = reading.open(capture)
    doubts = read_doubts(checked) if checked else {}
    proposal = propose_protocol(opened, doubts)
    if test:
        proposal = hold_out(proposal, opened, tuple(dict.fromkeys(test)), doubts)
    terms = proposal.protocol.shortened(frames, path_poses)
    if not 0 <= start < opened.n_frames:
        raise ProtocolError(
            f"--start {start}: wanted an instant of {capture}, 0 to {opened.n_frames - 1}"
        )
    terms = replace(
        terms,
        frames=replace(
            terms.frames, start=start, count=min(terms.frames.count, opened.n_frames - start)
        ),
    )
    if metrics:
        select_metrics(metrics)
        terms = replace(terms, measurement=replace(terms.measurement, metrics=metrics))
    if terms != proposal.protocol or test:  # a protocol of the user's own spares no frame
        terms = replace(terms, measurement=replace(terms.measurement, lpips_every=1))
    if stream is not None:
        terms = checked_protocol(terms.streamed(Stream(fps=stream)), "--stream")
    with atomic_file(out) as unfinished:
        unfinished.write_text(terms.to_toml(), encoding="utf-8")
    print(
        text_table({"cameras": 0, "reason for holding out, or not": 1}, _together(proposal.reasons))
    )
    print(
        f"{out}: {len(terms.views.test)} test views, K = {terms.synthesis.k}, {terms.frames.count} "
        f"frames"
    )
    published: dict[str, list[str]] = {}
    for standard in published_protocols(opened):
        choice = (
            f"{standard.name} ({', '.join(standard.views.test)} held out, "
            f"{standard.frames.count} frames)"
        )
        published.setdefault(standard.dataset, []).append(choice)
    for dataset, choices in published.items():
        print(f"if this is {dataset}: --protocol {' or '.join(choices)} evaluates as published")


def _together(reasons: Mapping[str, str]) -> list[tuple[str, str]]:
    """Return the cameras of one reason in one line: their names, of many the first, the last and
    their number.
    """
    names: dict[str, list[str]] = {}
    for name, reason in reasons.items():
        names.setdefault(reason, []).append(name)
    return [
        (
            ", ".join(cameras)
            if len(cameras) <= MOST_NAMES
            else f"{cameras[0]} ... {cameras[-1]} ({len(cameras)})",
            reason,
        )
        for reason, cameras in names.items()
    ]
