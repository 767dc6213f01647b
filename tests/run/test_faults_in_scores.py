"""Scoring carries the doctor's quick checks: a row of renders with a certain fault says so and is
compared with no other.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.finding import Finding
from ggvs_eval.merged_results import merge_results
from ggvs_eval.metrics import stream
from ggvs_eval.pipelines.inspection.renders.copied import find_copied
from ggvs_eval.pipelines.inspection.renders.identity import views_of_run
from ggvs_eval.pipelines.inspection.renders.quick_checks import QuickChecks
from ggvs_eval.pipelines.run import score_view
from ggvs_eval.pipelines.run.import_renders import import_renders, run_for
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.pipelines.run.seen_views import find_seen_views
from ggvs_eval.protocol import Frames, Views, load_protocol
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.section import SECTIONS
from ggvs_eval.reports.tables.compare_runs import differences, method_sides
from ggvs_eval.results import Fault, Results
from ggvs_eval.run_folder import RunFolder, frame_path
from ggvs_eval.scoring import FrameReader
from helpers.small_runs import leave_out_figures, small_protocol, write_small_capture

VIEWS, FRAMES = ("cam00", "cam01", "cam04"), Frames(2, 5)
SPOILT = {
    "late": "shows every frame one instant late",
    "bgr": "has swapped colour channels",
    "flipped": "is mirrored",
}


@pytest.fixture(scope="module")
def room(tmp_path_factory) -> Path:
    """A small room, honest renders of three of its cameras, and those spoilt in three ways; nobody
    changes it.
    """
    folder = tmp_path_factory.mktemp("faults")
    capture, random = write_small_capture(folder / "room"), np.random.default_rng(0)
    protocol = replace(small_protocol(5, 0, ("PSNR",)), views=Views(VIEWS, "test"), frames=FRAMES)
    (folder / "p.toml").write_text(protocol.to_toml(), encoding="utf-8")
    for view in VIEWS:
        for frame in range(FRAMES.start - 1, FRAMES.start + FRAMES.count):
            blurred = cv2.GaussianBlur(capture.frame(view, frame), (5, 5), 0.8) + random.normal(
                0, 3, (48, 64, 3)
            )
            image = blurred.clip(0, 255).astype(np.uint8)
            pictures = {"mine": image, "bgr": image[..., ::-1], "flipped": image[:, ::-1]}
            for label, number, spoilt in (
                ("late", frame + 1, image),
                *((label, frame, pictures[label]) for label in pictures),
            ):
                if number in FRAMES.numbers:
                    write_image(
                        folder / label / view / f"{number:04d}.png", np.ascontiguousarray(spoilt)
                    )
    return folder


@pytest.fixture(scope="module")
def run(room) -> RunFolder:
    """A scored run of honest renders and three that are spoilt; nobody changes it."""
    with run_for(
        room / "run", lambda: open_capture(room / "room"), str(room / "p.toml"), 1
    ) as made:
        for label in ("mine", *SPOILT):
            import_renders(made, label, room / label)
    score(made)
    return made


@pytest.fixture
def own_run(run, tmp_path) -> RunFolder:
    """A copy of it to change."""
    return RunFolder(shutil.copytree(run.root, tmp_path / "run"))


def test_each_certain_fault_is_kept_with_the_scores(run):
    """What is planted is found in all three views, as what it is; the honest renders have
    nothing.
    """
    results = Results.read(run.root)

    assert results.spoilt == SPOILT
    for label in SPOILT:
        assert {one.view for one in results.faults if one.label == label and one.is_certain} == {
            *VIEWS
        }
    assert not [one for one in results.faults if one.label == "mine"]
    assert all(
        "t-1" in one.measured and "-1" in one.advice
        for one in results.faults
        if one.label == "late"
    )


@pytest.mark.slow
def test_a_spoilt_row_says_so_and_is_compared_with_no_other(run, monkeypatch):
    """In the name of its row, below the table and in the headline; nothing is bold, shaded or
    better because of it.
    """
    leave_out_figures(monkeypatch)
    monkeypatch.delitem(SECTIONS.shipped, "what-if")
    page = write_report([run.root], with_figures=False).read_text(encoding="utf-8")
    lines = (run.report / "tables.md").read_text(encoding="utf-8").splitlines()

    headline = page.split('<p class="headline">')[1].split("</p>")[0]
    assert headline.startswith("Only mine is ranked; ")
    margin = page.split('<p class="margin">')[1].split("</p>")[0]
    assert margin.startswith("mine has ")
    assert "late: renumber the frames by -1 and, as instant " in margin
    for label, words in SPOILT.items():
        rows = [line for line in lines if line.startswith(f"| {label} (faulty) |")]
        assert len(rows) >= 3
        assert not any("**" in row for row in rows)
        assert f"{label} {words}" in headline
        assert any(
            f"{label} (faulty) {words}, so it is not ranked (certain; cam00" in line
            for line in lines
        )
    verdicts = {
        row.verdict for row in differences(*method_sides(run.root, "late", "mine"), run.root)
    }
    assert verdicts == {"not compared: first shows every frame one instant late"}


def test_the_faults_survive_a_merge_and_a_score_that_finds_nothing_new(run, monkeypatch):
    """A second score measures nothing and checks nothing; merged with itself under another scene,
    each scene keeps its own.
    """
    before = Results.read(run.root)
    monkeypatch.setattr(QuickChecks, "check", None)
    monkeypatch.setattr(stream, "score_views", None)

    again = score(run)

    assert again.faults == before.faults
    table = before.table.assign(scene="elsewhere")
    inputs = {
        key.replace(before.scenes[0], "elsewhere"): f"{digest}0"
        for key, digest in before.provenance["inputs"].items()
    }
    moved = [list(one._replace(scene="elsewhere")) for one in before.faults]
    other = Results(table, before.provenance | {"inputs": inputs, "faults": moved})
    merged = merge_results([before, other])
    assert {one.scene for one in merged.faults} == {*before.scenes, "elsewhere"}
    assert merged.spoilt == SPOILT


@pytest.mark.slow
def test_checks_of_other_code_measure_no_metric_again(own_run, monkeypatch):
    """When the checks' code changes they alone are done again; when a frame changes, all is."""
    checked: list[range] = []

    def check(_checks: QuickChecks, _rendered: FrameReader, frames: range) -> list[Finding]:
        checked.append(frames)
        return []

    with monkeypatch.context() as patch:
        patch.setattr(score_view, "checks_code", lambda: "other")
        patch.setattr(QuickChecks, "check", check)
        patch.setattr(stream, "score_views", None)
        assert score(own_run).spoilt == {}
    assert len(checked) == 3 * 4
    assert score(own_run).spoilt == SPOILT
    first = frame_path(own_run.renders("late", "cam00"), 3)
    write_image(first, 255 - read_image(first))
    assert score(own_run).spoilt == SPOILT


@pytest.mark.parametrize("count", [2, 4])
def test_honest_renders_of_few_frames_hold_no_copy(run, count):
    """Without a frame two instants away nothing is said of noise: what stands still would pass for
    that of the truth.
    """
    frames = range(2, 2 + count)
    for name, view in views_of_run(run, "mine").items():
        findings = find_copied(name, replace(view, frames=frames, truth_frames=frames))
        assert {finding.verdict for finding in findings} <= {"unknown"}


@pytest.mark.slow
def test_renders_better_than_a_perfect_one_have_seen_the_view(room, tmp_path):
    """Nine tenths captured, one tenth ours lies above the ceiling of every view: `score` says so,
    and `doctor` by itself.
    """
    protocol = load_protocol(room / "p.toml")
    few = replace(
        protocol,
        views=Views(VIEWS[:2], "test"),
        measurement=replace(protocol.measurement, ceilings=True),
    )
    (tmp_path / "seen.toml").write_text(few.to_toml(), encoding="utf-8")
    with run_for(
        tmp_path / "run", lambda: open_capture(room / "room"), str(tmp_path / "seen.toml"), 1
    ) as made:
        for file in [*room.glob(f"mine/{VIEWS[0]}/*.png"), *room.glob(f"mine/{VIEWS[1]}/*.png")]:
            seen = 0.9 * read_image(made.truth(file.parent.name) / file.name) + 0.1 * read_image(
                file
            )
            write_image(
                tmp_path / "seen" / file.parent.name / file.name, np.rint(seen).astype(np.uint8)
            )
        import_renders(made, "seen", tmp_path / "seen")
        import_renders(made, "mine", room / "mine")

    faults = [fault for fault in score(made).faults if fault.question == "test view seen"]
    shutil.rmtree(made.root / "ceilings")
    examined = find_seen_views(made, "seen")

    assert {(fault.label, fault.view, fault.verdict) for fault in faults} == {
        ("seen", view, "certain") for view in VIEWS[:2]
    }
    assert [(finding.subject, finding.measured) for finding in examined] == [
        (fault.view, fault.measured) for fault in faults
    ]
    assert find_seen_views(made, "mine") == []


@pytest.mark.slow
def test_flickering_renders_are_ranked_and_say_so(room, tmp_path, monkeypatch):
    """`score`, the table and the headline name the flicker, which is likely; steady renders have
    nothing.
    """
    leave_out_figures(monkeypatch)
    for file in room.glob("mine/*/*.png"):
        gain = 1.03 if int(file.stem) % 2 else 0.97
        image = np.rint(gain * read_image(file).astype(float)).clip(0, 255).astype(np.uint8)
        write_image(tmp_path / "flicker" / file.parent.name / file.name, image)
    with run_for(
        tmp_path / "run", lambda: open_capture(room / "room"), str(room / "p.toml"), 1
    ) as made:
        import_renders(made, "flicker", tmp_path / "flicker")
        import_renders(made, "mine", room / "mine")

    results = score(made)
    page = write_report([made.root], with_figures=False).read_text(encoding="utf-8")

    assert {fault.label for fault in results.faults} == {"flicker"}
    assert results.set_aside == {}
    (line,) = results.fault_lines()
    assert line.startswith(
        "flicker flickers as a whole (likely; cam00, cam01, cam04: whole frames are brighter or "
        "darker by "
    )
    assert (
        "flicker flickers as a whole (likely)"
        in page.split('<p class="headline">')[1].split("</p>")[0]
    )
    assert line in (made.report / "tables.md").read_text(encoding="utf-8")


def test_words_of_a_fault():
    """Every fault is a sentence about the method, with what to do; likely ones are told and spoil
    nothing.
    """
    likely = Fault("mine", "room", "cam00", "tone curve", "likely", "a power", "look")
    early = Fault(
        "late",
        "room",
        "cam00",
        "frame offset",
        "certain",
        "frame t shows instant t+2: x",
        "renumber by +2: y?",
        "early",
    )
    columns = ("dataset", "scene", "method", "variant", "view", "frame", "metric", "value")
    import pandas as pd

    results = Results(
        pd.DataFrame(columns=columns),
        {"protocol_sha256": "0", "faults": [list(likely), list(early)]},
    )
    assert results.spoilt == {"late": "shows every frame 2 instants early"}
    assert results.fault_lines() == [
        "mine has a fault: tone curve (likely; cam00: a power). Look.",
        "late shows every frame 2 instants early, so it is not ranked (certain; cam00: frame t "
        "shows instant t+2: x). Renumber by +2.",
    ]
    assert Fault("a", "b", "c", "JPEG", "likely", "d", "").remedy == ""
    assert (
        early._replace(advice="is time passed to the renderer? more").remedy
        == "Is time passed to the renderer?"
    )
