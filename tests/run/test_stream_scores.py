"""Streaming scores of a run: the renders, re-indexed by the times that they took, through the code
of every other score.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from ggvs_eval.errors import ProtocolError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.pipelines.run import score_view
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.protocol import StatedTime, Stream, load_protocol
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, read_json, write_json
from helpers.render_folders import VIEWS, make_run, rendered, truth, write_folders

METRICS = ("PSNR", "SSIM", "TCC", "STED", "L1", "SDT")
FRAMES = range(0, 7)
FPS = 10.0


def run_of(
    root: Path, stream: Stream, ms: dict[str, tuple[float, ...]], name: str = "run"
) -> RunFolder:
    """A run of methods with these times, all with the same frames."""
    made = make_run(root / name, ("PSNR",), FRAMES)
    stated = tuple(StatedTime(method, times) for method, times in ms.items())
    set_protocol(made, replace(stream, stated=stated))
    for method in ms:
        import_renders(made, method, write_folders(root / f"{name}-{method}", FRAMES))
    return made


def set_protocol(run: RunFolder, stream: Stream) -> None:
    """The run's protocol, streamed."""
    protocol = run.protocol()
    measurement = replace(protocol.measurement, metrics=METRICS)
    run.protocol_file.write_text(
        replace(protocol, measurement=measurement, stream=stream).to_toml()
    )


def numbers(results: Results, row: str) -> dict[str, float]:
    """Metric -> number of a method, or of what is seen of it."""
    summary = results.summary().droplevel("dataset")
    return {str(name): float(value) for name, value in summary.loc[(row, "")].items()}


def measured(run: RunFolder, label: str, view: str = VIEWS[0]) -> dict[str, Any]:
    """The record of each metric of a method in a view."""
    return {
        file.parent.name: read_json(file)
        for file in (run.scores(view) / label).glob(f"*/{JOB_FILE}")
    }


def test_infinitely_fast_is_the_plain_score(tmp_path):
    """Every score of the screen is the plain one, to the last bit, parts included, and the frames
    are the same files.
    """
    run = run_of(tmp_path, Stream(fps=FPS), {"fast": (0.0,)})
    results = score(run)

    assert numbers(results, "fast@screen") == numbers(results, "fast")
    assert frame_path(run.renders("fast@screen", VIEWS[0]), 3).samefile(
        frame_path(run.renders("fast", VIEWS[0]), 3)
    )
    assert run.labels() == ["fast"]
    assert run.shown_names["fast@screen"] == "fast, on the screen"


def test_a_method_of_two_frames_is_held_against_the_truth_two_frames_later(tmp_path):
    """PSNR by hand; instants without a picture have no frame and no value; the plain scores are
    what they were.
    """
    run = run_of(
        tmp_path, Stream(fps=FPS, pipelined=True), {"fast": (0.0,), "slow": (100.0, 100.0)}
    )
    results = score(run)

    by_frame = results.per_frame("PSNR", VIEWS[0])[("slow@screen", "")].dropna()
    assert by_frame.to_dict() == pytest.approx(
        {at: psnr(rendered(VIEWS[0], at - 2), truth(VIEWS[0], at)) for at in FRAMES if at >= 2}
    )
    assert numbers(results, "slow@screen")["PSNR"] < numbers(results, "fast@screen")["PSNR"] - 3
    assert numbers(results, "slow") == numbers(results, "fast")
    record = read_json(run.stream_record)["methods"]["slow"]
    assert (record["latency_ms"], record["shown"], record["dark"]) == (pytest.approx(200.0), 5, 2)
    assert record["stages_ms"] == {"stated 1": 100.0, "stated 2": 100.0}


def test_a_still_scene_does_not_care(tmp_path):
    """Where nothing moves, an old picture is as good as a new one."""
    run = run_of(tmp_path, Stream(fps=FPS), {"fast": (0.0,), "slow": (250.0,)})
    for view in VIEWS:
        for folder in (run.truth(view), *(run.renders(label, view) for label in ("fast", "slow"))):
            still = read_image(frame_path(folder, 0))
            for frame in FRAMES:
                frame_path(folder, frame).unlink()
                write_image(frame_path(folder, frame), still)
    results = score(run)

    fast, slow = numbers(results, "fast"), numbers(results, "slow@screen")
    assert slow["PSNR"] == pytest.approx(fast["PSNR"], abs=1e-12)
    assert slow["SSIM"] == pytest.approx(fast["SSIM"], abs=1e-12)


def test_scores_are_stale_when_the_screen_changes_and_not_when_a_time_does(tmp_path, monkeypatch):
    """95 ms and 100 ms of a frame show the same; 105 ms do not, and then the row of the screen
    alone is measured again.
    """
    run = run_of(tmp_path, Stream(fps=FPS), {"one": (95.0,)})
    score(run)
    before = measured(run, "one"), measured(run, "one@screen")
    passes: list[list[str]] = []
    original = score_view._score_methods

    def counting(*arguments: Any) -> Any:
        passes.append([folder.parent.name for folder in arguments[2]])
        return original(*arguments)

    monkeypatch.setattr(score_view, "_score_methods", counting)
    set_protocol(run, Stream(fps=FPS, stated=(StatedTime("one", (100.0,)),)))
    score(run)
    assert passes == []
    assert read_json(run.stream_record)["methods"]["one"]["latency_ms"] == pytest.approx(100.0)

    set_protocol(run, Stream(fps=FPS, stated=(StatedTime("one", (105.0,)),)))
    score(run)
    assert passes == [["one@screen"]] * len(VIEWS)
    assert measured(run, "one") == before[0]
    assert measured(run, "one@screen")["PSNR"]["values"] != before[1]["PSNR"]["values"]

    set_protocol(run, Stream(fps=FPS, stated=(StatedTime("one", (1000.0,)),)))
    assert set(score(run).row_labels) == {"one"}
    assert not run.renders("one@screen", "").exists()


@pytest.mark.slow
def test_a_metric_of_every_so_many_frames_that_meets_no_instant_says_so(tmp_path):
    """LPIPS at every eighth frame looks at the first alone, which has no picture yet."""
    run = run_of(tmp_path, Stream(fps=FPS), {"slow": (100.0,)})
    protocol = run.protocol()
    measurement = replace(protocol.measurement, metrics=("PSNR", "LPIPS"), lpips_every=8)
    run.protocol_file.write_text(replace(protocol, measurement=measurement).to_toml())

    assert "lpips_every" in score(run).why_absent("LPIPS", "slow@screen", VIEWS[0])


@pytest.mark.parametrize(
    ("record", "reason"),
    [
        (None, "stated"),
        ({"fit": {"look_ahead": "sequence", "seconds": 9, "instants": 7}}, "offline"),
        ({"fit": {"look_ahead": "past", "seconds": 63, "instants": 7}}, "9 s"),
        ({"identity": {"splats": "ab12"}}, "stated"),
    ],
)
def test_who_is_not_on_the_screen_says_why(record, reason, tmp_path):
    """Frames of others, a fit to the whole clip, a fit that takes longer than the clip: no row, and
    the reason in the record.
    """
    run = run_of(tmp_path, Stream(fps=FPS), {"one": (0.0,), "other": (0.0,)})
    set_protocol(run, Stream(fps=FPS, stated=(StatedTime("one", (0.0,)),)))
    for view in VIEWS if record else ():
        write_json(
            run.renders("other", view) / JOB_FILE,
            {"versions": {}, "identity": {}, "seconds": {"all": [0.0] * 7}, **record},
        )
    results = score(run)

    assert set(results.row_labels) == {"one", "other", "one@screen"}
    assert reason in read_json(run.stream_record)["methods"]["other"]["absent"]


def test_the_clock_is_the_median_without_each_first_frame(tmp_path):
    """Stages of all views, as the table of times has them; depth that was computed before takes no
    time unless one is stated.
    """
    run = run_of(tmp_path, Stream(fps=FPS), {"one": (0.0,)})
    for view, times in zip(VIEWS, ([9.0, 0.02, 0.02, 0.04], [9.0, 0.03, 0.03, 0.9]), strict=True):
        write_json(
            run.renders("one", view) / JOB_FILE,
            {"seconds": {"blend": times, "splat": [0.01] * 4}, "identity": {}},
        )
    write_json(run.depth_record, {"matcher": "sgbm"})

    def stages(stream: Stream) -> dict[str, float]:
        set_protocol(run, stream)
        score(run)
        return dict(read_json(run.stream_record)["methods"]["one"]["stages_ms"])

    assert stages(Stream(fps=FPS)) == pytest.approx({"blend": 30.0, "splat": 10.0})
    assert stages(Stream(fps=FPS, depth_ms=50)) == pytest.approx(
        {"depth": 50.0, "blend": 30.0, "splat": 10.0}
    )
    write_json(run.depth_record, {"matcher": "live"})
    write_json(run.live_depth_record, {"seconds": [0.1, 0.2, 0.3], "threads": 1})
    assert stages(Stream(fps=FPS)) == pytest.approx({"depth": 200.0, "blend": 30.0, "splat": 10.0})


def test_the_protocol_keeps_its_stream(tmp_path):
    """A table of its own: read back as written, part of the hash where it is there and of no older
    one, wrong values refused.
    """
    plain = load_protocol("demo")
    streamed = replace(plain, stream=Stream(fps=30.0, stated=(StatedTime("mine", (12.0, 20.0)),)))
    file = tmp_path / "mine.toml"
    file.write_text(streamed.to_toml())

    assert load_protocol(file) == streamed
    assert load_protocol(file).sha256 == streamed.sha256 != plain.sha256
    assert "stream" not in plain.to_toml()
    for broken, named in (
        (replace(streamed, stream=Stream(fps=0)), "stream.fps"),
        (replace(streamed, stream=Stream(fps=30, depth_ms=-1)), "stream.depth_ms"),
        (
            replace(streamed, stream=Stream(fps=30, stated=(StatedTime("mine", ()),))),
            "stream.stated",
        ),
        (replace(streamed, stream=Stream(fps=30.0, warm_up=24)), "stream.warm_up"),
    ):
        file.write_text(broken.to_toml())
        with pytest.raises(ProtocolError, match=named):
            load_protocol(file)


def test_a_protocol_of_an_earlier_version_says_where_its_metrics_of_the_screen_are(
    tmp_path, capsys
):
    """It is read without them, and one line says so."""
    protocol = load_protocol("demo")
    metrics = (*protocol.measurement.metrics, "PSNR_stream", "TCC_stream")
    file = tmp_path / "earlier.toml"
    file.write_text(
        replace(protocol, measurement=replace(protocol.measurement, metrics=metrics)).to_toml()
    )

    assert load_protocol(file) == load_protocol(file) == protocol
    (line,) = capsys.readouterr().err.splitlines()
    assert "PSNR_stream, TCC_stream" in line
    assert "METHOD@screen" in line
