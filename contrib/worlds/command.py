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
    """Film a demo capture: a procedural dynamic room or garden in the layout of a data set, with exact depth.

    Args:
        out: folder to write; absent, or holding this very demo.
        room: the room, the rig and the sensors.
        seconds: length of the videos, instead of --n-frames.
        jobs: processes.
    """
    from ggvs_eval.contrib.worlds.demo import write_demo

    if seconds is not None:
        room = replace(room, n_frames=round(seconds * room.fps))
    print(write_demo(out, room, jobs))
