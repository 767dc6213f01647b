"""The verb of the command line that questions metrics: metric-study."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggvs_eval.pipelines.commands.flags import ONE_PER_CORE, Jobs, Output

Captures = Annotated[
    tuple[Path, ...],
    tyro.conf.arg(metavar="CAPTURE|VIDEOS|VIDEO ...", help_behavior_hint="(default: the demo)"),
]
Metrics = Annotated[
    tuple[str, ...],
    tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(default: those that cost little)"),
]
Ladders = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="LADDER ...", help_behavior_hint="(default: all)")
]


def metric_study(
    out: Output,
    capture: Captures = (),
    metrics: Metrics = (),
    ladders: Ladders = (),
    frames: int = 12,
    size: int = 168,
    on: Literal["truth", "rendering"] = "truth",
    seeds: int = 1,
    jobs: Jobs = ONE_PER_CORE,
) -> None:
    """Measure how each metric responds to known degradations.

    Writes OUT/values.csv, study.json, study.md and study.png. A second call resumes.

    Args:
        out: folder to create or resume.
        capture: captures, folders of videos or of pictures, or videos.
        metrics: metric names, or all.
        ladders: degradations: blur, noise, shift, colour, compression, flicker, drift, frozen,
            late, wobble, switch, jump, boiling.
        frames: frames per clip, and poses per stretch of a camera path.
        size: shorter side of the images, pixels.
        on: degraded images: captured frames (truth), or a method's rendering of them.
        seeds: repetitions of each degradation per clip.
        jobs: parallel processes, at least 1.
    """
    from ggvs_eval.contrib.study.study import run_study
    from ggvs_eval.contrib.study.study_figure import draw_study
    from ggvs_eval.contrib.study.study_tables import absence_list, study_text, verdict_table
    from ggvs_eval.contrib.study.takes import StudyOptions
    from ggvs_eval.files.atomic import write_text

    study = run_study(
        out,
        capture,
        StudyOptions(
            metrics=metrics, ladders=ladders, seeds=seeds, frames=frames, size=size, on=on
        ),
        jobs,
    )
    write_text(out / "study.md", study_text(study))
    print(verdict_table([study]))
    if absent := absence_list(study):
        print(absent)
    print(draw_study({", ".join(study["captures"]): out}, out / "study.png"))
