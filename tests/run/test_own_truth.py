"""Renders that papers publish with their truth are scored without a capture and marked so; failed
calls leave nothing.
"""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import Views
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.tables_of_runs import tables_of_runs
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.command_line import refusal
from helpers.small_runs import small_protocol, write_small_capture

VIEW, FRAMES = "cam00", 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> Path:
    """A small room, a protocol of one view, blurred and late renders of it, and a run of the
    former; nobody changes it.
    """
    folder = tmp_path_factory.mktemp("own")
    capture = write_small_capture(folder / "room", FRAMES)
    protocol = replace(
        small_protocol(FRAMES, 0, ("PSNR", "SSIM", "TCC")), views=Views((VIEW,), "test")
    )
    (folder / "p.toml").write_text(protocol.to_toml(), encoding="utf-8")
    for frame in range(FRAMES):
        blurred = cv2.GaussianBlur(capture.frame(VIEW, frame), (5, 5), 1.0)
        write_image(frame_path(folder / "blurred" / VIEW, frame), blurred)
        write_image(frame_path(folder / "late" / VIEW, frame), capture.frame(VIEW, frame + 1))
    call("score", *place(folder, folder / "run"), "--renders", f"theirs={folder / 'blurred'}")
    return folder


def place(folder: Path, run: Path) -> tuple[object, ...]:
    return "--capture", folder / "room", "--protocol", folder / "p.toml", "--run", run


def call(*words: object) -> None:
    """A command line; errors of the user end it with their line."""
    run_command([*map(str, words), "--jobs", "1"])


def stack(pictures: Path) -> np.ndarray:
    """The pictures of a folder in order, (T, H, W, 3), floats in [0, 1]."""
    return (np.stack([read_image(file) for file in sorted(pictures.glob("*.png"))]) / 255).astype(
        np.float32
    )


def write_archive(folder: Path, file: Path, **changed: np.ndarray) -> Path:
    """An archive as 4DGV's: renders, truth, and what its authors measured of each frame."""
    truth, rendered = (
        stack(folder / "run" / "truth" / VIEW),
        stack(folder / "run" / "renders" / "theirs" / VIEW),
    )
    psnr = -10 * np.log10(np.mean((truth.astype(float) - rendered) ** 2, axis=(1, 2, 3)))
    arrays = {
        "renders": rendered,
        "gts": truth,
        "metrics": np.stack([np.full(len(psnr), 0.5), psnr], axis=1),
    } | changed
    file.parent.mkdir(parents=True, exist_ok=True)
    np.savez(file, **arrays)
    return file


def test_the_same_scores_with_and_without_the_capture(folder, tmp_path, capsys):
    """A compressed archive whose truth is the captured frames has the scores of its renders with
    the capture, to the last bit.
    """
    archive = write_archive(folder, tmp_path / f"{VIEW}.npz")
    np.savez_compressed(archive, **np.load(archive))
    call(
        "score",
        "--with-truth",
        "--renders",
        f"theirs={archive}",
        "--protocol",
        folder / "p.toml",
        "--run",
        tmp_path / "own",
    )
    assert "metrics column 1 is PSNR and agrees" in capsys.readouterr().out
    own, with_capture = Results.read(tmp_path / "own").table, Results.read(folder / "run").table
    for metric in ("PSNR", "SSIM", "TCC"):
        assert (
            own[own["metric"] == metric]["value"].tolist()
            == with_capture[with_capture["metric"] == metric]["value"].tolist()
        )
    call("score", *place(folder, tmp_path / "with"), "--renders", f"theirs={archive}")
    assert Results.read(tmp_path / "with").table["value"].tolist() == with_capture["value"].tolist()


def test_renders_next_to_their_truth_need_no_capture(folder, tmp_path, capsys):
    """Of renders/ and gt/ `score`, `doctor` and `explain` answer as with the capture; without
    either they say how.
    """
    pair = tmp_path / "mine"
    for name, source in (("renders", "renders/theirs"), ("gt", "truth")):
        for file in sorted((folder / "run" / source / VIEW).glob("*.png")):
            write_image(pair / name / file.name, read_image(file))
    call(
        "score",
        "--with-truth",
        "--renders",
        f"mine={pair}",
        "--protocol",
        folder / "p.toml",
        "--run",
        tmp_path / "own",
    )
    own, with_capture = Results.read(tmp_path / "own").table, Results.read(folder / "run").table
    assert own["value"].tolist() == with_capture["value"].tolist()
    psnr_db = with_capture[with_capture["metric"] == "PSNR"]["value"].mean()
    call("explain", pair, "psnr", f"{psnr_db:.3f}", "--with-truth")
    assert "conventions tried" in capsys.readouterr().out
    assert "--with-truth" in refusal("doctor", pair)
    assert "renders/ next to gt/" in refusal("doctor", pair / "gt", "--with-truth")
    call("doctor", pair, "--with-truth")
    assert "the sharpness of the renders is" in capsys.readouterr().out


@pytest.mark.slow
def test_own_truth_is_said_everywhere(folder, tmp_path, capsys):
    """Results, rows, tables for papers and the page say that the truth came with the renders;
    nothing is rendered there.
    """
    archive = write_archive(folder, tmp_path / f"{VIEW}.npz")
    run = tmp_path / "own"
    call(
        "score",
        "--with-truth",
        "--renders",
        f"theirs={archive}",
        "--protocol",
        folder / "p.toml",
        "--run",
        run,
    )
    assert "own truth" in capsys.readouterr().out
    assert Results.read(run).provenance["truth"] == "came with the renders"
    assert read_run(run).name("theirs").startswith("theirs (own truth)")
    latex = tables_of_runs([run], ["PSNR"], "latex")
    assert "theirs (own truth)" in latex
    assert "not against a capture" in latex
    page = write_report([run], with_figures=False).read_text(encoding="utf-8")
    assert "theirs (own truth)" in page
    assert "came with the renders" in page
    with pytest.raises(SystemExit, match="renders with their own truth"):
        call("render", run, "--methods", "no-blending")


def test_a_wrong_number_of_the_authors_is_told(folder, tmp_path, capsys):
    """One value in `metrics` that is not what the pictures give is named with its frame."""
    metrics = np.load(write_archive(folder, tmp_path / "a.npz"))["metrics"]
    metrics[3, 1] += 1.0
    archive = write_archive(folder, tmp_path / f"{VIEW}.npz", metrics=metrics)
    call(
        "score",
        "--with-truth",
        "--renders",
        f"theirs={archive}",
        "--protocol",
        folder / "p.toml",
        "--run",
        tmp_path / "own",
    )
    assert (
        "metrics column 1 is PSNR and differs in 1 frame, most in frame 3"
        in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda arrays: arrays | {"gts": arrays["gts"][:-1]}, "of one shape"),
        (
            lambda arrays: arrays | {"gts": arrays["gts"].transpose(0, 3, 1, 2)},
            "save frames.transpose(0, 2, 3, 1)",
        ),
        (lambda arrays: arrays | {"gts": 255 * arrays["gts"]}, "wanted floats in [0, 1]"),
        (
            lambda arrays: {name: array for name, array in arrays.items() if name != "gts"},
            "wanted arrays renders and gts",
        ),
    ],
    ids=["another length", "other axes", "another range", "no truth"],
)
def test_other_archives_are_refused_and_leave_nothing(folder, tmp_path, change, words):
    """Another length, other axes, another range or no truth is refused by name, and the call leaves
    no folder.
    """
    arrays = change(dict(np.load(write_archive(folder, tmp_path / "good.npz"))))
    np.savez(tmp_path / "bad.npz", **arrays)
    with pytest.raises(SystemExit) as refusal:
        call(
            "score",
            "--with-truth",
            "--renders",
            f"theirs={tmp_path / 'bad.npz'}",
            "--run",
            tmp_path / "scores" / "own",
        )
    assert words in str(refusal.value)
    assert not (tmp_path / "scores").exists()


def test_two_methods_share_one_truth(folder, tmp_path):
    """A second archive with the same truth becomes a second row; one with another truth is
    refused.
    """
    first = write_archive(folder, tmp_path / "a" / f"{VIEW}.npz")
    other = write_archive(
        folder, tmp_path / "b" / f"{VIEW}.npz", renders=stack(folder / "late" / VIEW)
    )
    run = tmp_path / "own"
    call(
        "score",
        "--with-truth",
        "--renders",
        f"a={first}",
        f"b={other}",
        "--protocol",
        folder / "p.toml",
        "--run",
        run,
    )
    assert {*Results.read(run).row_labels} == {"a", "b"}
    foreign = write_archive(
        folder, tmp_path / "c" / f"{VIEW}.npz", gts=stack(folder / "late" / VIEW)
    )
    with pytest.raises(SystemExit, match="wanted the reference of this run"):
        call(
            "score",
            "--with-truth",
            "--renders",
            f"c={foreign}",
            "--protocol",
            folder / "p.toml",
            "--run",
            run,
        )
    assert RunFolder(run).labels() == ["a", "b"]


@pytest.mark.parametrize(
    "renders",
    [("x=/nowhere",), (), ("truth=/tmp",)],
    ids=["no such renders", "none", "a name that is taken"],
)
@pytest.mark.parametrize("verb", ["score", "doctor"])
def test_a_failed_call_leaves_no_folder(folder, tmp_path, monkeypatch, verb, renders):
    """Neither the run folder nor `scores/` is there after a call that failed on its input; a run
    that was there stays.
    """
    monkeypatch.chdir(tmp_path)
    options = ["--capture", folder / "room", "--protocol", folder / "p.toml"]
    words = (
        ["--renders", *renders]
        if verb == "score" and renders
        else ["/nowhere"]
        if verb == "doctor"
        else []
    )
    with pytest.raises(SystemExit, match="ggvs-eval: "):
        call(verb, *words, *options)
    with pytest.raises(SystemExit, match="ggvs-eval: "):
        call(verb, *words, *options, "--run", "new/run")
    assert list(tmp_path.iterdir()) == []
    before = sorted((folder / "run").rglob("*"))
    with pytest.raises(SystemExit):
        call(verb, *(words or ["--renders", "x=/nowhere"]), *options, "--run", folder / "run")
    assert sorted((folder / "run").rglob("*")) == before


def test_checking_what_is_not_there_writes_nothing(tmp_path, monkeypatch):
    """A path without a capture is an error, no verdict in a file."""
    monkeypatch.chdir(tmp_path)
    with pytest.raises(SystemExit, match="wanted a folder or a file with a capture"):
        call("check", "nowhere")
    assert list(tmp_path.iterdir()) == []
