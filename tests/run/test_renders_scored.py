"""From renders of others to a table: whole ones, partial ones that are marked, and the command line
around it.
"""

import hashlib
import re
import shlex
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.run.evaluate import report
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.prepare import prepare_truth
from ggvs_eval.pipelines.run.score import plan_scores, score
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views, load_protocol
from ggvs_eval.reports.model.measured import read_scores
from ggvs_eval.reports.page.page import reproduce
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.captures import write_dynerf
from helpers.command_line import refusal
from helpers.refusals import refused
from helpers.render_folders import FRAMES, make_run, rendered, truth, write_folders

pytestmark = [pytest.mark.usefixtures("no_figures")]

METRICS = ("PSNR", "L1", "TCC", "SDT", "SDV")


@pytest.fixture
def truth_run(tmp_path) -> RunFolder:
    return make_run(tmp_path / "run", METRICS)


def partial_folder(folder: Path) -> Path:
    """cam02 without frame 3, cam00 with a frame 4 of another size."""
    write_folders(folder)
    (folder / "cam02" / "0003.png").unlink()
    write_image(folder / "cam00" / "0004.png", np.zeros((24, 32, 3), np.uint8))
    return folder


def cells(results: Results, method: str) -> dict[tuple[str | None, int, str], float]:
    rows = results.table[results.table["method"] == method]
    views = [None if view != view else view for view in rows["view"]]  # pandas writes NaN for None
    return dict(
        zip(zip(views, rows["frame"], rows["metric"], strict=True), rows["value"], strict=True)
    )


def test_partial_renders_are_scored_where_they_are_and_marked(truth_run, tmp_path):
    """What is there has the values it would have in whole renders; what is not has no value; the
    results say which row.
    """
    import_renders(truth_run, "whole", write_folders(tmp_path / "whole"))
    import_renders(truth_run, "some", partial_folder(tmp_path / "some"), allow_partial=True)

    results = score(truth_run)
    whole, some = cells(results, "whole"), cells(results, "some")

    mark = "partial in room: 0 of 2 views complete, 4 of 6 frames (cam02, cam00)"
    assert Results.read(truth_run.root).provenance["partial"] == {"some": mark}
    frames = {("cam02", 2), ("cam02", 4), ("cam00", 2), ("cam00", 3)}
    assert {(view, frame) for view, frame, metric in some if metric == "L1"} == frames
    # no pair across the gap
    assert {(view, frame) for view, frame, metric in some if metric == "TCC"} == {("cam00", 2)}
    # where both views are there
    assert {(view, frame) for view, frame, metric in some if metric == "SDV"} == {(None, 2)}
    for place in ((*cell, metric) for cell in frames for metric in ("PSNR", "L1")):
        assert some[place] == whole[place]
    assert some[("cam00", 2, "TCC")] == whole[("cam00", 2, "TCC")]
    assert some[("cam00", -1, "SDT")] == pytest.approx(
        np.std([some[("cam00", t, "L1")] for t in (2, 3)], ddof=1)
    )
    assert results.not_computed == {}


def test_the_announced_time_is_of_what_is_left(truth_run, tmp_path):
    """Methods that are scored already are not counted again."""
    for label in ("a", "b"):
        import_renders(truth_run, label, write_folders(tmp_path / label))
    words = "scoring 6 frames of each of 2 methods takes about "
    assert plan_scores(truth_run, ["a", "b"]).time_words(1).startswith(words)
    score(truth_run)
    for label in ("c", "d"):
        import_renders(truth_run, label, write_folders(tmp_path / label))

    assert plan_scores(truth_run, ["a", "b", "c", "d"]).time_words(1).startswith(words)
    # six frames are not worth a line
    assert plan_scores(truth_run, ["a", "b", "c"]).time_words(1) == ""


def test_a_view_that_is_missing_has_no_row(truth_run, tmp_path):
    """One of two views: its values alone, the mean over it alone, and a reason for what
    needs two.
    """
    folder = write_folders(tmp_path / "theirs")
    shutil.rmtree(folder / "cam02")
    record = import_renders(truth_run, "some", folder, allow_partial=True)

    results = score(truth_run)

    assert record["partial"] == "1 of 2 views complete, 3 of 6 frames (cam00)"
    assert "missing: some in cam02 lacks all 3 frames" in record["notes"]
    assert set(results.table["view"]) == {"cam00"}
    levels = [
        np.abs(rendered("cam00", frame).astype(float) - truth("cam00", frame)).mean()
        for frame in FRAMES
    ]
    assert results.summary()["L1"].item() == pytest.approx(np.mean(levels))
    assert results.not_computed["SDV"] == "1 view; needs 2"
    pictures = b"".join((folder / "cam00" / f"000{frame}.png").read_bytes() for frame in FRAMES)
    assert results.provenance["renders"] == {"some/cam00": hashlib.sha256(pictures).hexdigest()}
    assert results.provenance["inputs"]["room/cam00"] == "ab12"
    assert results.provenance["imported"]["some"]["sha256"] == record["sha256"]
    assert results.provenance["imported"]["some"]["source"] == "theirs"


def test_a_metric_of_one_view_has_no_reason_beside_its_value(truth_run, tmp_path):
    """What one view cannot have is named as lacking there; as not computed counts what no
    view has.
    """
    names = (*METRICS, "PSNR_disoccluded")
    protocol = truth_run.protocol()
    protocol = replace(protocol, measurement=replace(protocol.measurement, metrics=names))
    truth_run.protocol_file.write_text(protocol.to_toml())
    for view, size in (("cam00", 12), ("cam02", 5)):  # 25 pixels are too few
        for frame in FRAMES:
            mask = np.zeros(truth(view, frame).shape, np.uint8)
            mask[:size, :size] = 255
            write_image(frame_path(truth_run.disoccluded(view), frame), mask)
    for label in ("a", "b"):
        import_renders(truth_run, label, write_folders(tmp_path / label))

    results = score(truth_run)

    assert set(results.table["metric"]) & set(results.not_computed) == set()
    assert set(results.per_view("PSNR_disoccluded").columns) == {"cam00"}
    assert [(one.metric, one.label, one.view) for one in results.absences] == [
        ("PSNR_disoccluded", label, "cam02") for label in ("a", "b")
    ]
    assert "pixels" in results.why_absent("PSNR_disoccluded", "a", "cam02")
    (table,) = [
        one
        for one in main_tables([read_scores(truth_run.root)], results)
        if "PSNR_disoccluded" in {c.name for c in one.columns}
    ]
    assert "PSNR_disoccluded is a mean without cam02 (in no frame" in " ".join(table.notes)
    assert "not computed" not in {cell.text for row in table.rows for cell in row.cells}


def test_partial_renders_that_were_completed_lose_their_mark(truth_run, tmp_path):
    """Importing the completed folder under the same name replaces frames, values and mark."""
    folder = partial_folder(tmp_path / "some")
    import_renders(truth_run, "some", folder, allow_partial=True)
    before = score(truth_run).provenance

    write_folders(folder)
    import_renders(truth_run, "some", folder)
    after = score(truth_run)

    assert before["partial"]
    assert not after.provenance["partial"]
    assert cells(after, "some")[("cam02", 3, "L1")] == pytest.approx(3, abs=0.2)
    # no partial import excuses what gets lost
    frame_path(truth_run.renders("some", "cam00"), 3).unlink()
    with refused(RenderError, "some in cam00", "lacks 3"):
        score(truth_run)


@pytest.fixture
def coffee_folder(tmp_path) -> Path:
    return write_dynerf(tmp_path / "coffee")


@pytest.fixture
def protocol_path(tmp_path) -> Path:
    protocol = Protocol(
        "p",
        "Tiny",
        Views(("cam01", "cam02"), "by hand"),
        Frames(1, 3),
        Synthesis(2),
        Measurement(METRICS),
    )
    (tmp_path / "p.toml").write_text(protocol.to_toml())
    return tmp_path / "p.toml"


@pytest.fixture
def theirs(coffee_folder, tmp_path) -> Path:
    """The captured frames, 4 levels brighter."""
    opened = open_capture(coffee_folder)
    for view in ("cam01", "cam02"):
        for frame, image in enumerate(opened.frames(view, 1, 4), 1):
            write_image(
                tmp_path / "theirs" / view / f"{frame:04d}.png",
                np.minimum(image, 251) + np.uint8(4),
            )
    return tmp_path / "theirs"


def command(*arguments: str | Path) -> None:
    run_command([str(argument) for argument in arguments])


def test_one_command_scores_renders_of_a_capture(
    coffee_folder, protocol_path, theirs, tmp_path, capsys, monkeypatch
):
    """`score --renders --capture --protocol` makes a run of the truth alone under scores/ and
    prints the table.
    """
    monkeypatch.chdir(tmp_path)

    command(
        "score",
        "--renders",
        f"mine={theirs}",
        "--capture",
        coffee_folder,
        "--protocol",
        protocol_path,
        "--jobs",
        "1",
    )

    run = RunFolder(tmp_path / "scores" / "coffee")
    assert "mine" in capsys.readouterr().out
    assert sorted(folder.name for folder in (run.root / "truth").iterdir()) == ["cam01", "cam02"]
    assert not run.depth.exists()
    assert Results.read(run.root).summary()["L1"].item() == pytest.approx(4.0, abs=0.05)
    command("score", run.root, "--renders", theirs, "--jobs", "1")  # goes on with its own protocol
    assert set(Results.read(run.root).table["method"]) == {"mine", "theirs"}


@pytest.mark.slow
def test_the_commands_of_the_page_repeat_a_run_of_renders(
    coffee_folder, protocol_path, theirs, tmp_path, capsys, monkeypatch
):
    """Pasted where the run was made they make it again, without depth; no report of it states a K
    that nobody knows.
    """
    monkeypatch.chdir(tmp_path)
    (tmp_path / "RENDERS").mkdir()
    theirs.rename("RENDERS/mine")
    command(
        "score",
        "--renders",
        "RENDERS/mine",
        "--capture",
        "coffee",
        "--protocol",
        protocol_path,
        "--jobs",
        "1",
    )
    run = RunFolder(tmp_path / "scores" / "coffee")
    printed = reproduce(read_scores(run.root), run.capture_record()["path"])
    for folder in ("renders", "scores"):
        shutil.rmtree(run.root / folder)

    for line in printed:
        run_command(shlex.split(line)[1:])
    command("table", run.root)

    assert printed[-1] == "ggvs-eval report scores/coffee"
    assert len(printed) == 2
    assert Results.read(run.root).summary()["L1"].item() == pytest.approx(4.0, abs=0.05)
    page = (run.report / "index.html").read_text(encoding="utf-8")
    assert '"run": "scores/coffee"' in page
    texts = [
        page,
        capsys.readouterr().out,
        *((run.report / f"tables.{kind}").read_text() for kind in ("md", "tex")),
    ]
    assert not [text for text in texts if re.search(r"\bK = \d", text)]


def test_the_numbering_is_printed_and_can_be_said(
    coffee_folder, protocol_path, theirs, tmp_path, capsys
):
    """Frames 0-2 of a protocol of 1-3: refused with the option that settles it; with it scored, and
    one line says how.
    """
    for file in sorted(theirs.rglob("*.png")):
        file.rename(file.with_name(f"{int(file.stem) - 1:04d}.png"))
    place = (
        "--run",
        tmp_path / "run",
        "--capture",
        coffee_folder,
        "--protocol",
        protocol_path,
        "--jobs",
        "1",
    )
    arguments = ("score", "--renders", theirs, *place)

    message = refusal(*arguments)
    command(*arguments, "--first-frame", "0")

    assert "or give --first-frame 0 if number 0 shows instant 1" in message
    lines = capsys.readouterr().err.splitlines()
    assert (
        "theirs: numbered by --first-frame 0: 0-2 are used as the instants 1-3 of the capture"
        in lines
    )
    assert Results.read(tmp_path / "run").summary()["L1"].item() == pytest.approx(4.0, abs=0.05)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "label"),
    [
        ("enerf", "enerf-renders"),
        pytest.param("my renders (2)", "my-renders-2", marks=pytest.mark.slow),
    ],
)
def test_a_folder_may_be_called_as_a_method_is(
    name, label, coffee_folder, protocol_path, theirs, tmp_path, capsys
):
    """doctor, explain and score find a free name for it; who names renders so explicitly is
    told.
    """
    folder = theirs.rename(tmp_path / name)
    place = (
        "--run",
        tmp_path / "run",
        "--capture",
        coffee_folder,
        "--protocol",
        protocol_path,
        "--jobs",
        "1",
    )

    with pytest.raises(SystemExit):  # these frames were made of the captured ones, and it says so
        command("doctor", folder, *place)
    command("explain", folder, "l1", "4.00", *place)
    command("score", "--renders", folder, *place)

    assert capsys.readouterr().out.startswith(f"{label}\n")
    assert set(Results.read(tmp_path / "run").table["method"]) == {label}
    words = ("score", "--renders", f"{name}={folder}", *place)
    if name == "enerf":
        command(*words)
        assert (
            f"{folder}: called {label} here, since enerf is a built-in method"
            in capsys.readouterr().err
        )
    else:
        assert f"give another: --renders {label}=PATH" in refusal(*words)


def test_incomplete_renders_end_with_one_line_unless_allowed(
    coffee_folder, protocol_path, theirs, tmp_path, capsys
):
    """Exit 1 with the gaps and the way out; with --allow-partial the table is followed by what the
    row stands on.
    """
    shutil.rmtree(theirs / "cam02")
    place = (
        "--run",
        tmp_path / "run",
        "--capture",
        coffee_folder,
        "--protocol",
        protocol_path,
        "--jobs",
        "1",
    )
    arguments = ("score", "--renders", f"a={theirs}", *place)
    with pytest.raises(SystemExit) as caught:
        command(*arguments)
    message = str(caught.value.code)

    command(*arguments, "--allow-partial")

    assert message.startswith("ggvs-eval: ")
    assert "a in cam02 lacks all 3 frames" in message
    assert "\n" not in message
    assert (
        "a is partial in coffee: 1 of 2 views complete, 3 of 6 frames (cam01)"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--renders", "a=THEIRS"), "wanted a run folder, or --capture CAPTURE"),
        (("RUN", "--run", "RUN"), "wanted one run folder"),
        (("RUN", "--protocol", "dynerf"), "holds a run of another protocol"),
    ],
)
def test_what_contradicts_itself_is_refused(
    arguments, message, coffee_folder, protocol_path, theirs, tmp_path
):
    """No run and no capture, two runs, or another protocol than the run's: one line each."""
    prepare_truth(tmp_path / "run", open_capture(coffee_folder), load_protocol(protocol_path))
    given = [
        text.replace("RUN", str(tmp_path / "run")).replace("THEIRS", str(theirs))
        for text in arguments
    ]

    with pytest.raises(SystemExit) as caught:
        command("score", *given)

    assert message in str(caught.value.code)


def test_imported_frames_survive_their_folder(tmp_path):
    """It may be renamed or emptied: the same run scores and reports as before."""
    run = make_run(tmp_path / "run", ("PSNR",))
    import_renders(run, "b", write_folders(tmp_path / "b"))
    table = score(run).table
    shutil.rmtree(tmp_path / "b")
    shutil.rmtree(run.root / "scores")
    assert score(run).table.equals(table)
    assert report([run.root]).is_file()


def test_linked_renders_that_were_moved_are_named(tmp_path):
    """Once they are elsewhere, report and score name the method, the place and the way out."""
    run = make_run(tmp_path / "run", ("PSNR",))
    import_renders(run, "b", write_folders(tmp_path / "b"), link=True)
    table = score(run).table
    (tmp_path / "b").rename(tmp_path / "moved")

    for call in (lambda: report([run.root]), lambda: score(run)):
        with refused(RenderError, f"the frames of b in {tmp_path / 'b'}/", "--renders b=NEWPLACE"):
            call()
    import_renders(run, "b", tmp_path / "moved", link=True)
    assert score(run).table.equals(table)


@pytest.mark.slow
def test_doctor_leaves_no_trace(coffee_folder, protocol_path, theirs, tmp_path, monkeypatch):
    """Without --run nothing is written where `score` writes, be it that the call fails; a run there
    lends its protocol.
    """
    monkeypatch.chdir(tmp_path)
    place = ("--capture", coffee_folder, "--jobs", "1")
    with pytest.raises(SystemExit):
        command("doctor", tmp_path / "nowhere", *place, "--protocol", protocol_path)
    with pytest.raises(SystemExit):  # these frames were made of the captured ones, and it says so
        command("doctor", theirs, *place, "--protocol", protocol_path)
    assert not (tmp_path / "scores").exists()

    command("score", "--renders", f"mine={theirs}", *place, "--protocol", protocol_path)
    before = sorted(tmp_path.glob("scores/*/renders/*"))
    with pytest.raises(SystemExit):
        command("doctor", theirs, *place)
    assert sorted(tmp_path.glob("scores/*/renders/*")) == before
