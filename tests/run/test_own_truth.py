"""Renders that papers publish with their truth are scored without a capture and marked so; failed calls leave nothing."""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.tables_of_runs import tables_of_runs
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path
from ggvs_eval.synthetic.shipped import FIXED, LATE, PROTOCOL, QUICK_ROOM, quick_protocol

VIEW, FRAMES = "cam00", 4


@pytest.fixture(scope="module")
def quick(quick_demo, tmp_path_factory) -> Path:
    """The quick demo under a protocol of one view and cheap metrics, scored with its capture; nobody changes it."""
    folder = Path(shutil.copytree(quick_demo, tmp_path_factory.mktemp("own") / "quick"))
    protocol = quick_protocol()
    cheap = replace(
        protocol,
        views=replace(protocol.views, test=(VIEW,)),
        frames=replace(protocol.frames, count=FRAMES),
        measurement=replace(protocol.measurement, metrics=("PSNR", "SSIM", "TCC"), ceilings=False),
    )
    (folder / PROTOCOL).write_text(cheap.to_toml(), encoding="utf-8")
    for name in (FIXED, LATE):
        for frame in cheap.frames.numbers:
            one = frame_path(folder / "one" / name / VIEW, frame)
            one.parent.mkdir(parents=True, exist_ok=True)
            one.symlink_to(frame_path(folder / name / VIEW, frame))
    call("score", "--capture", folder / QUICK_ROOM, "--protocol", folder / PROTOCOL, "--run", folder / "run", "--renders",
         f"theirs={folder / 'one' / FIXED}")  # fmt: skip
    return folder


def call(*words: object) -> None:
    """A command line; errors of the user end it with their line."""
    run_command([*map(str, words), "--jobs", "1"])


def stack(folder: Path) -> np.ndarray:
    """The pictures of a folder in order, (T, H, W, 3), floats in [0, 1]."""
    return (np.stack([read_image(file) for file in sorted(folder.glob("*.png"))]) / 255).astype(np.float32)


def write_archive(quick: Path, file: Path, **changed: np.ndarray) -> Path:
    """An archive as 4DGV's: renders, truth, and what its authors measured of each frame."""
    truth, rendered = stack(quick / "run" / "truth" / VIEW), stack(quick / "run" / "renders" / "theirs" / VIEW)
    psnr = -10 * np.log10(np.mean((truth.astype(float) - rendered) ** 2, axis=(1, 2, 3)))
    arrays = {"renders": rendered, "gts": truth, "metrics": np.stack([np.full(len(psnr), 0.5), psnr], axis=1)} | changed
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez(file, **arrays)
    return file


@pytest.mark.slow
def test_the_same_scores_with_and_without_the_capture(quick, tmp_path, capsys):
    """A compressed archive whose truth is the captured frames has the scores of its renders with the capture, to the last bit."""
    archive = write_archive(quick, tmp_path / f"{VIEW}.npz")
    np.savez_compressed(archive, **np.load(archive))
    call("score", "--with-truth", "--renders", f"theirs={archive}", "--protocol", quick / PROTOCOL, "--run", tmp_path / "own")
    assert "metrics column 1 is PSNR and agrees" in capsys.readouterr().out
    own, with_capture = Results.read(tmp_path / "own").table, Results.read(quick / "run").table
    for metric in ("PSNR", "SSIM", "TCC"):
        assert own[own["metric"] == metric]["value"].tolist() == with_capture[with_capture["metric"] == metric]["value"].tolist()
    call("score", "--capture", quick / QUICK_ROOM, "--protocol", quick / PROTOCOL, "--run", tmp_path / "with", "--renders",
         f"theirs={archive}")  # fmt: skip
    assert Results.read(tmp_path / "with").table["value"].tolist() == with_capture["value"].tolist()


@pytest.mark.slow
def test_own_truth_is_said_everywhere(quick, tmp_path, capsys):
    """Results, rows, tables for papers and the page say that the truth came with the renders; nothing is rendered there."""
    archive = write_archive(quick, tmp_path / f"{VIEW}.npz")
    run = tmp_path / "own"
    call("score", "--with-truth", "--renders", f"theirs={archive}", "--protocol", quick / PROTOCOL, "--run", run)
    assert "own truth" in capsys.readouterr().out
    assert Results.read(run).provenance["truth"] == "came with the renders"
    assert read_run(run).name("theirs") == "theirs (own truth)"
    latex = tables_of_runs([run], ["PSNR"], "latex")
    assert "theirs (own truth)" in latex
    assert "not against a capture" in latex
    page = write_report([run], with_figures=False).read_text(encoding="utf-8")
    assert "theirs (own truth)" in page
    assert "came with the renders" in page
    with pytest.raises(SystemExit, match="renders with their own truth"):
        call("render", run, "--methods", "no-blending")


@pytest.mark.slow
def test_a_wrong_number_of_the_authors_is_told(quick, tmp_path, capsys):
    """One value in `metrics` that is not what the pictures give is named with its frame."""
    metrics = np.load(write_archive(quick, tmp_path / "a.npz"))["metrics"]
    metrics[3, 1] += 1.0
    archive = write_archive(quick, tmp_path / f"{VIEW}.npz", metrics=metrics)
    call("score", "--with-truth", "--renders", f"theirs={archive}", "--protocol", quick / PROTOCOL, "--run", tmp_path / "own")
    assert "metrics column 1 is PSNR and differs in 1 frame, most in frame 3" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arrays: arrays | {"gts": arrays["gts"][:-1]}, "of one shape"),
        (lambda arrays: arrays | {"gts": arrays["gts"].transpose(0, 3, 1, 2)}, "save frames.transpose(0, 2, 3, 1)"),
        (lambda arrays: arrays | {"gts": 255 * arrays["gts"]}, "wanted floats in [0, 1]"),
        (lambda arrays: {name: array for name, array in arrays.items() if name != "gts"}, "wanted arrays renders and gts"),
    ],
    ids=["another length", "other axes", "another range", "no truth"],
)
def test_other_archives_are_refused_and_leave_nothing(quick, tmp_path, change, words):
    """Another length, other axes, another range or no truth is refused by name, and the call leaves no folder."""
    arrays = change(dict(np.load(write_archive(quick, tmp_path / "good.npz"))))
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(SystemExit) as refusal:
        call("score", "--with-truth", "--renders", f"theirs={tmp_path / 'bad.npz'}", "--run", tmp_path / "scores" / "own")
    assert words in str(refusal.value)
    assert not (tmp_path / "scores").exists()


@pytest.mark.slow
def test_two_methods_share_one_truth(quick, tmp_path):
    """A second archive with the same truth becomes a second row; one with another truth is refused."""
    first = write_archive(quick, tmp_path / "a" / f"{VIEW}.npz")
    other = write_archive(quick, tmp_path / "b" / f"{VIEW}.npz", renders=stack(quick / "one" / LATE / VIEW))
    run = tmp_path / "own"
    call("score", "--with-truth", "--renders", f"a={first}", f"b={other}", "--protocol", quick / PROTOCOL, "--run", run)
    assert {*Results.read(run).row_labels} == {"a", "b"}
    foreign = write_archive(quick, tmp_path / "c" / f"{VIEW}.npz", gts=stack(quick / "one" / LATE / VIEW))
    with pytest.raises(SystemExit, match="wanted the reference of this run"):
        call("score", "--with-truth", "--renders", f"c={foreign}", "--protocol", quick / PROTOCOL, "--run", run)
    assert RunFolder(run).labels() == ["a", "b"]


@pytest.mark.slow
@pytest.mark.parametrize(
    "renders", [("x=/nowhere",), (), ("truth=/tmp",)], ids=["no such renders", "none", "a name that is taken"]
)
@pytest.mark.parametrize("verb", ["score", "doctor"])
def test_a_failed_call_leaves_no_folder(quick, tmp_path, monkeypatch, verb, renders):
    """Neither the run folder nor `scores/` is there after a call that failed on its input; a run that was there stays."""
    monkeypatch.chdir(tmp_path)
    options = ["--capture", quick / QUICK_ROOM, "--protocol", quick / PROTOCOL]
    words = ["--renders", *renders] if verb == "score" and renders else ["/nowhere"] if verb == "doctor" else []
    with pytest.raises(SystemExit, match="ggvs-eval: "):
        call(verb, *words, *options)
    with pytest.raises(SystemExit, match="ggvs-eval: "):
        call(verb, *words, *options, "--run", "new/run")
    assert list(tmp_path.iterdir()) == []
    before = sorted((quick / "run").rglob("*"))
    with pytest.raises(SystemExit):
        call(verb, *(words or ["--renders", "x=/nowhere"]), *options, "--run", quick / "run")
    assert sorted((quick / "run").rglob("*")) == before


@pytest.mark.slow
def test_doctor_leaves_nothing_where_scores_are_kept(quick, tmp_path, monkeypatch, capsys):
    """Without --run neither `scores/` nor anything else is written, where there are scores too."""
    monkeypatch.chdir(tmp_path)
    call("doctor", quick / "one" / FIXED, "--capture", quick / QUICK_ROOM, "--protocol", quick / PROTOCOL)
    assert list(tmp_path.iterdir()) == []
    call("score", "--capture", quick / QUICK_ROOM, "--protocol", quick / PROTOCOL, "--renders", f"a={quick / 'one' / FIXED}")
    before = sorted(tmp_path.rglob("*"))
    call("doctor", quick / "one" / FIXED, "--capture", quick / QUICK_ROOM)
    assert sorted(tmp_path.rglob("*")) == before


def test_checking_what_is_not_there_writes_nothing(tmp_path, monkeypatch):
    """A path without a capture is an error, no verdict in a file."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="wanted a folder or a file with a capture"):
        call("check", "nowhere")
    assert list(tmp_path.iterdir()) == []
