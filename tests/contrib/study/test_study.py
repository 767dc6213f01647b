"""A whole study of a video: verdicts that are known, what is resumed, and what is refused."""

from collections.abc import Sequence

import numpy as np
import pandas as pd
import pytest

from ggvs_eval.contrib.study import measure
from ggvs_eval.contrib.study.study import run_study
from ggvs_eval.contrib.study.takes import StudyOptions
from ggvs_eval.errors import CaptureError, MetricError
from ggvs_eval.files.images import write_image
from ggvs_eval.files.video import write_video
from ggvs_eval.metrics import registry
from ggvs_eval.metrics.metric import ViewMetric
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.statistics.rank_correlation import answer
from ggvs_eval.tasks import run_tasks
from ggvs_eval.tasks.task import Task
from helpers.command_line import refusal
from helpers.noise_scenes import clean_video

INTERRUPTED_AFTER = 5  # jobs: two takes and three of ten series
SMALL = {"frames": 6, "size": 48}
DEAF = ViewMetric(
    name="Deaf",
    kind="frame",
    function=lambda _rendered, truth: float(truth[0, 0, 0]),
    higher_is_better=True,
    describe="does not look at what is rendered",
    reference="planted",
)


@pytest.fixture(scope="module")
def videos(tmp_path_factory):
    """Two views of a moving face, as a folder of videos without calibration."""
    folder = tmp_path_factory.mktemp("face")
    for name, speed_px in (("left", 3.3), ("right", 5.1)):
        write_video(folder / f"{name}.mp4", clean_video(12, speed_px), fps=30)
    return folder


@pytest.fixture
def studied(videos, tmp_path, monkeypatch):
    monkeypatch.setitem(registry.METRICS.shipped, DEAF.name, DEAF)
    options = StudyOptions(
        ("PSNR", "SDV", "Flicker", "reprojection", DEAF.name),
        ("noise", "frozen", "switch"),
        **SMALL,
    )
    return run_study(tmp_path / "study", [videos], options), options, tmp_path / "study"


def test_verdicts_that_are_known(studied):
    """PSNR falls with noise in every clip; what ignores its input is blind to everything; a camera
    at rest has no path.
    """
    study, _, folder = studied
    answers = study["answers"]
    table = pd.read_csv(folder / "values.csv")

    assert (answers["noise"]["PSNR"]["correlation"], answers["noise"]["PSNR"]["verdict"]) == (
        1.0,
        "sees",
    )
    assert {answers[ladder][DEAF.name]["verdict"] for ladder in ("noise", "frozen")} == {"blind"}
    assert {answers[ladder][DEAF.name]["least_strength"] for ladder in ("noise", "frozen")} == {
        None
    }
    assert answers["switch"] == {}
    assert study["not_computed"]["switch"]["PSNR"] == "the camera is static"
    assert study["not_computed"]["noise"]["reprojection"] == "the camera is static"
    assert table[(table.metric == "SDV") & (table.ladder == "noise")].groupby(
        "take"
    ).size().to_list() == [6, 6]


@pytest.mark.slow
def test_an_interrupted_study_goes_on(studied, videos, tmp_path, monkeypatch):
    """What was measured before an interrupt is not measured again, and the outcome is that of a
    study in one go.
    """
    study, options, _ = studied
    ran: list[str] = []
    run = run_tasks.run_batch

    def interrupted(batch: Sequence[Task]) -> None:
        if len(ran) == INTERRUPTED_AFTER:
            raise KeyboardInterrupt
        ran.append(batch[0].name)
        run(batch)

    monkeypatch.setattr(run_tasks, "run_batch", interrupted)
    with pytest.raises(KeyboardInterrupt):
        run_study(tmp_path / "again", [videos], options)
    before, ran = ran, []

    assert run_study(tmp_path / "again", [videos], options) == study
    assert not set(before) & set(ran)
    assert len(before) == INTERRUPTED_AFTER


@pytest.mark.slow
def test_what_is_measured_stays(studied, videos, monkeypatch):
    """A second call runs no job; one more metric is measured beside those that are there, which
    stay as they are.
    """
    study, options, folder = studied
    measured: list[tuple[str, ...]] = []
    monkeypatch.setattr(
        measure, "_at", lambda *rest, at=measure._at: (measured.append(rest[-1]), at(*rest))[1]
    )

    assert run_study(folder, [videos], options) == study
    assert not measured
    more = run_study(
        folder, [videos], StudyOptions((*options.metrics, "L1"), options.ladders, **SMALL)
    )
    assert set(measured) == {("L1",)}
    assert more["answers"]["noise"]["PSNR"] == study["answers"]["noise"]["PSNR"]
    assert more["answers"]["noise"]["L1"]["correlation"] == 1.0
    measured.clear()
    assert run_study(folder, [videos], options) == study  # and L1 stays where it is
    run_study(folder, [videos], StudyOptions(("L1",), options.ladders, **SMALL))
    assert not measured


@pytest.mark.slow
def test_the_verb_writes_tables_and_a_figure(videos, tmp_path, capsys):
    """`ggvs-eval metric-study` prints what each metric is blind to, and writes values, tables and
    the figure.
    """
    out = tmp_path / "out"
    chosen = ["--metrics", "L1", "SDT", "--ladders", "colour", "--frames", "6", "--size", "48"]
    run_command(["metric-study", str(out), "--capture", str(videos), *chosen, "--jobs", "1"])
    printed = capsys.readouterr().out

    assert "| `L1` | colour | – | – |" in printed
    assert printed.splitlines()[-1] == str(out / "study.png")
    assert {"values.csv", "study.json", "study.md", "study.png"} <= {
        file.name for file in out.iterdir()
    }
    assert "Least strength distinguished from the original" in (out / "study.md").read_text(
        encoding="utf-8"
    )


def test_pictures_in_a_folder_are_one_view(tmp_path):
    """Frames without calibration, one folder: a study of one view, which no metric of several views
    can have.
    """
    for index, frame in enumerate(clean_video(6)):
        write_image(tmp_path / "frames" / f"{index:03d}.png", frame)
    study = run_study(
        tmp_path / "study", [tmp_path / "frames"], StudyOptions(("L1", "SDV"), ("blur",), **SMALL)
    )

    # of one clip nobody knows the spread
    assert study["answers"]["blur"]["L1"]["verdict"] == "unclear"
    assert study["not_computed"]["blur"]["SDV"] == "1 view; needs 2"


def test_what_is_refused(videos, tmp_path):
    """One line each: an unknown metric, no capture there, too few frames, no frames to speak of."""
    out = tmp_path / "out"

    assert "did you mean PSNR?" in refusal("metric-study", out, "--metrics", "PSNRR")
    assert "check it" in refusal("metric-study", out, "--capture", tmp_path / "absent")
    assert "by --frames" in refusal("metric-study", out, "--capture", videos, "--frames", 13)
    assert "at least 5 frames" in refusal("metric-study", out, "--frames", 4)
    assert "twice; rename one" in refusal("metric-study", out, "--capture", videos, videos)
    with pytest.raises(MetricError, match="at least 1 seed"):
        StudyOptions(seeds=0)
    with pytest.raises(CaptureError, match="truth or rendering"):
        StudyOptions(on="dream")  # type: ignore[arg-type]


def test_an_interval_holds_what_clips_say():
    """Rank correlations are averaged over clips and their interval spans what these say; ties and
    constants count as 0.
    """
    strengths = [0, 1, 2, 3]
    rising, falling, flat = [1.0, 2, 3, 4], [4.0, 3, 2, 1], [5.0, 5, 5, 5]
    divided = answer(strengths, {"a": [rising], "b": [falling], "c": [rising], "d": [falling]})
    agreed = answer(strengths, {"a": [falling], "b": [falling]})

    assert (divided.correlation, divided.verdict) == (0.0, "blind")
    assert divided.low < -0.9 < 0.9 < divided.high
    assert (agreed.correlation, agreed.verdict, agreed.least_strength) == (-1.0, "rewards", None)
    assert answer(strengths, {"a": [flat], "b": [flat]}).verdict == "blind"
    assert answer(strengths, {"a": [rising]}).verdict == "unclear"


def test_the_least_strength_exceeds_the_spread_over_clips():
    """Two clips that differ by 2 tell a step of 1 from none only once it has added up to more than
    their spread, sqrt(2).
    """
    rows = {"a": [[0.0, 1, 2, 3]], "b": [[2.0, 3, 4, 5]]}

    assert answer([0, 1, 2, 3], rows).least_strength == 2
    assert answer([1, 2, 3, 4], rows).least_strength is None  # the undegraded has no value
    assert np.isclose(answer([0, 1, 2, 3], rows).correlation, 1.0)
