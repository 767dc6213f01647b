"""The verb of the command line that films demo captures: film."""

from dataclasses import replace

import tyro

from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.pipelines.commands.flags import ONE_PER_CORE, Jobs, Output


def film(
    out: Output,
    room: tyro.conf.OmitArgPrefixes[DemoOptions] = DemoOptions(),  # noqa: B008 - frozen
    seconds: float | None = None,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Film a procedural demo capture in the layout of a data set.

    Args:
        out: folder to write; absent, or holding this demo.
        room: room, rig and sensors.
        seconds: length of the videos, seconds, instead of --n-frames.
        jobs: parallel processes, at least 1.
    """
    from ggvs_eval.contrib.worlds.demo import write_demo

    if seconds is not None:
        room = replace(room, n_frames=round(seconds * room.fps))
    print(write_demo(out, room, jobs))
