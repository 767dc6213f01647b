"""The verb of the command line that questions metrics: metric-study."""

from pathlib import Path
from typing import Annotated, Literal

import tyro

from ggvs_eval.pipelines.commands.flags import ONE_PER_CORE, Jobs, Output

Captures = Annotated[
    tuple[Path, ...], tyro.conf.arg(metavar="CAPTURE|VIDEOS|VIDEO ...", help_behavior_hint="(default: the demo)")
]
Metrics = Annotated[tuple[str, ...], tyro.conf.arg(metavar="METRIC ...", help_behavior_hint="(default: those that cost little)")]
Ladders = Annotated[tuple[str, ...], tyro.conf.arg(metavar="LADDER ...", help_behavior_hint="(default: all)")]


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
    """Plant degradations of known strength in true frames, and find out which metric sees which and what it is blind to.

    Writes OUT/values.csv, study.json, study.md and study.png. What is measured already is not measured again.

    Args:
        out: folder to write or to continue with.
        capture: captures, folders of videos or of pictures, or videos.
        metrics: names, or all; parts of an image are measured where they are named.
        ladders: degradations: blur, noise, shift, colour, compression, flicker, drift, frozen, late, wobble, switch, jump,
            boiling.
        frames: of a clip, and poses of a stretch of a camera path.
        size: of the images' shorter side, pixels.
        on: what the degradations are planted in: the truth, or the method's rendering of it, where its own errors compete.
        seeds: how often each degradation is planted in each clip.
        jobs: processes.
    """
    from ggvs_eval.contrib.study.study import run_study
    from ggvs_eval.contrib.study.study_figure import draw_study
    from ggvs_eval.contrib.study.study_tables import absence_list, study_text, verdict_table
    from ggvs_eval.contrib.study.takes import StudyOptions
    from ggvs_eval.files.atomic import write_text

    study = run_study(out, capture, StudyOptions(metrics, ladders, seeds, frames, size, on), jobs)
    write_text(out / "study.md", study_text(study))
    print(verdict_table([study]))
    if absent := absence_list(study):
        print(absent)
    print(draw_study({", ".join(study["captures"]): out}, out / "study.png"))
