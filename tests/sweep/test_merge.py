"""Runs of several machines become one: the same table as of one machine, differences told, nothing
half-made.
"""

import dataclasses
import json
import shutil
import socket

import numpy as np
import pytest

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.errors import ProtocolError, ResultsError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.run.evaluate import measure, render
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.pipelines.sweep.merging import merge as merging
from ggvs_eval.pipelines.sweep.merging.merge import merge_runs
from ggvs_eval.protocol import Protocol, Stream, Synthesis
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, read_json, write_json
from helpers.command_line import refusal
from helpers.refusals import refused
from helpers.small_runs import LABELS, small_protocol, write_small_capture
from helpers.tasks_left import tasks_left

METRICS = ("PSNR", "L1", "SDT", "SDV")


@pytest.fixture(scope="module")
def demo_capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 2)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    return small_protocol(2, 0, METRICS)


@pytest.fixture(scope="module")
def machines(demo_capture, protocol, tmp_path_factory):
    """One run with both methods, and the same work done on two machines, one method each."""
    root = tmp_path_factory.mktemp("machines")
    whole = prepare(root / "whole", demo_capture, protocol, labels=LABELS)
    for name in ("a", "b"):
        shutil.copytree(root / "whole", root / name)
    render(whole)
    score(whole.run)
    for name, label in zip(("a", "b"), LABELS, strict=True):
        render(prepare(root / name, demo_capture, protocol, labels=[label]))
        score(RunFolder(root / name))
    return root


def values(run: RunFolder) -> dict[str, dict]:
    """Records of all scores of one view."""
    folder = run.scores("cam00")
    return {
        file.parent.relative_to(folder).as_posix(): read_json(file)
        for file in folder.glob(f"*/*/{JOB_FILE}")
    }


@pytest.fixture
def runs(machines, tmp_path):
    for name in ("a", "b"):
        shutil.copytree(machines / name, tmp_path / name)
    return tmp_path


def test_merged_runs_give_the_table_of_one_machine(machines, runs, capsys):
    """Two methods rendered apart and merged have the values of both rendered together, views'
    deviation included.
    """
    run_command(["merge", str(runs / "out"), str(runs / "a"), str(runs / "b"), "--jobs", "1"])

    merged, whole = (Results.read(root).summary() for root in (runs / "out", machines / "whole"))
    np.testing.assert_array_equal(merged.to_numpy(), whole.to_numpy())
    assert list(merged.columns) == list(whole.columns)
    assert RunFolder(runs / "out").labels() == list(LABELS)
    assert "SDV" in capsys.readouterr().out


def test_a_merged_run_goes_on(demo_capture, protocol, runs):
    """Nothing is left to do in a merged run: no frame is decoded, rendered or measured again."""
    merged = merge_runs(runs / "out", [runs / "a", runs / "b"])
    before = values(merged)
    assert tasks_left(plan_run(RunRequest(runs / "out", demo_capture, protocol, LABELS))) == []

    prepared = prepare(runs / "out", demo_capture, protocol, labels=LABELS)

    assert render(prepared) == 0
    assert set(before) == {
        f"{label}/{name}" for label in LABELS for name in ("PSNR", "L1", "checks")
    }
    score(merged)
    assert values(merged) == before


def test_views_of_two_machines(demo_capture, protocol, machines, tmp_path):
    """Shards that rendered other views of the same methods have, merged and scored, the table of
    one machine.
    """
    for name, view in (("a", "cam00"), ("b", "cam01")):
        shutil.copytree(machines / "whole", tmp_path / name)
        run = RunFolder(tmp_path / name)
        for label in LABELS:
            shutil.rmtree(run.renders(label, "cam01" if view == "cam00" else "cam00"))
        shutil.rmtree(run.scores("cam01" if view == "cam00" else "cam00"))

    merged = merge_runs(tmp_path / "out", [tmp_path / "a", tmp_path / "b"])

    expected = Results.read(machines / "whole").summary()
    np.testing.assert_array_equal(score(merged).summary().to_numpy(), expected.to_numpy())


def test_what_is_missing_is_told(runs, capsys):
    """Without all views there is a merged run but no table, and the missing views are named."""
    shutil.rmtree(RunFolder(runs / "b").renders("distance-based", "cam01"))

    run_command(["merge", str(runs / "out"), str(runs / "a"), str(runs / "b"), "--jobs", "1"])

    assert "distance-based lacks cam01" in capsys.readouterr().err
    assert not (runs / "out" / "results.parquet").is_file()


def test_other_pictures_of_one_job_are_refused(runs):
    """Two runs with different pixels of one job cannot be merged; both folders are named, and
    nothing is left behind.
    """
    shutil.copytree(
        RunFolder(runs / "a").renders("no-blending", ""),
        RunFolder(runs / "b").renders("no-blending", ""),
    )
    file = frame_path(RunFolder(runs / "b").renders("no-blending", "cam01"), 1)
    write_image(file, 255 - read_image(file))

    message = refusal("merge", runs / "out", runs / "a", runs / "b")

    assert f"{runs / 'a'}/renders/no-blending/cam01" in message
    assert f"{runs / 'b'}/renders/no-blending/cam01" in message
    assert "1 of 2 files" in message
    assert sorted(item.name for item in runs.iterdir()) == ["a", "b"]


def test_other_values_of_one_method_are_refused(runs):
    """Values of one method that differ by more than rounding are refused; by rounding, or with the
    times, they may.
    """
    for folder in ("renders/no-blending", "scores/cam00/no-blending"):
        shutil.copytree(runs / "a" / folder, runs / "b" / folder)
    first, second = (
        RunFolder(runs / name).scores("cam00") / "no-blending" / "L1" for name in ("a", "b")
    )
    record = read_json(first / JOB_FILE)
    record["values"][0][2] *= 1 + 1e-9
    write_json(second / JOB_FILE, record)
    merge_runs(runs / "rounded", [runs / "a", runs / "b"])

    record["values"][0][2] += 0.5
    write_json(second / JOB_FILE, record)
    with refused(ResultsError, str(first), str(second), "values"):
        merge_runs(runs / "out", [runs / "a", runs / "b"])

    for folder in (first, second):  # what is on a screen follows the times
        folder.parent.rename(folder.parent.with_name("no-blending@screen"))
    merge_runs(runs / "screens", [runs / "a", runs / "b"])


def test_other_protocols_are_refused(runs, protocol):
    """Runs of different protocols are refused, and the message says where they differ; so are
    captured frames of other bytes.
    """
    other = dataclasses.replace(protocol, synthesis=Synthesis(3))
    toml = (runs / "b" / "protocol.toml").read_text()
    (runs / "b" / "protocol.toml").write_text(other.to_toml())
    with refused(ProtocolError, "protocol.synthesis.k", "2 and 3"):
        merge_runs(runs / "out", [runs / "a", runs / "b"])
    (runs / "b" / "protocol.toml").write_text(toml)
    file = frame_path(RunFolder(runs / "b").truth("cam00"), 0)
    write_image(file, 255 - read_image(file))

    with refused(ResultsError, "truth/cam00", "different bytes, first 0000.png"):
        merge_runs(runs / "out", [runs / "a", runs / "b"])


def test_other_captures_are_refused_and_moved_ones_taken(runs):
    """A capture under another path is the same; one with other frames is not."""
    file = runs / "b" / "capture.json"
    record = json.loads(file.read_text())
    file.write_text(json.dumps(record | {"path": "/elsewhere/demo", "place": {}, "scene": "other"}))
    merge_runs(runs / "moved", [runs / "a", runs / "b"])

    file.write_text(json.dumps(record | {"digests": record["digests"] | {"cam02": "0"}}))
    with refused(ProtocolError, "capture.digests.cam02"):
        merge_runs(runs / "out", [runs / "a", runs / "b"])


def test_a_killed_merge_leaves_nothing_half_made(runs, monkeypatch):
    """What stops in the middle leaves no run; leftovers of a killed process go when the same merge
    is called again.
    """

    def stopped(source, destination):
        if destination.name == "0001.png":
            raise KeyboardInterrupt
        shutil.copy2(source, destination)

    (runs / f".out.{socket.gethostname().replace('.', '-')}.4194304000.tmp").mkdir()
    monkeypatch.setattr(merging, "link_file", stopped)
    with pytest.raises(KeyboardInterrupt):
        merge_runs(runs / "out", [runs / "a", runs / "b"])
    assert sorted(item.name for item in runs.iterdir()) == ["a", "b"]

    monkeypatch.undo()
    assert merge_runs(runs / "out", [runs / "a", runs / "b"]).labels() == list(LABELS)


def test_links_save_room_and_copies_do_not_depend(runs):
    """By default pictures are stored once; with `copy` the merged run has its own."""
    linked, copied = (
        merge_runs(runs / "linked", [runs / "a", runs / "b"]),
        merge_runs(runs / "copied", [runs / "a", runs / "b"], True),
    )

    file = frame_path(RunFolder(runs / "a").renders("no-blending", "cam00"), 0)
    assert frame_path(linked.renders("no-blending", "cam00"), 0).samefile(file)
    assert not frame_path(copied.renders("no-blending", "cam00"), 0).samefile(file)


def test_neither_an_existing_folder_nor_one_run_is_merged(runs):
    """Nothing is merged into a folder that is there, and a single run needs no merging."""
    assert "got an existing one" in refusal("merge", runs / "a", runs / "a", runs / "b")
    assert "at least two" in refusal("merge", runs / "out", runs / "a")


@pytest.mark.slow
def test_live_depth_and_fits_are_merged(demo_capture, protocol, tmp_path):
    """The seconds of live depth and the fitted scenes of the first run that has them come along:
    the stream has its table.
    """
    streamed = protocol.streamed(Stream(fps=1.0))
    for name, label in zip(("a", "b"), LABELS, strict=True):
        measure(
            plan_run(
                RunRequest(
                    tmp_path / name, demo_capture, streamed, [label], DepthRunOptions("live")
                )
            ),
            1,
        )
        fit = tmp_path / name / "fits" / "3dgs" / "all"
        fit.mkdir(parents=True)
        (fit / "scene.npz").write_text(name)
        (fit / JOB_FILE).write_text(json.dumps({"sha256": name}))

    run_command(
        ["merge", str(tmp_path / "out"), str(tmp_path / "a"), str(tmp_path / "b"), "--jobs", "1"]
    )

    for name in ("live_depth.json", "fits/3dgs/all/scene.npz"):
        assert (tmp_path / "out" / name).read_bytes() == (tmp_path / "a" / name).read_bytes()
    assert {*Results.read(tmp_path / "out").row_labels} == {
        *LABELS,
        *(f"{label}@screen" for label in LABELS),
    }
    kept = {item.name for item in (tmp_path / "a").iterdir()} - {"report"}
    assert {item.name for item in (tmp_path / "out").iterdir()} >= kept


def test_a_merged_run_that_cannot_be_scored_is_not_there(runs):
    """A picture of another size is refused by name, and no folder is left: the next call can be
    made.
    """
    for name in ("a", "b"):
        shutil.rmtree(runs / name / "scores")
    file = frame_path(RunFolder(runs / "b").renders("distance-based", "cam01"), 1)
    picture = read_image(file)
    write_image(file, picture[:-2])

    message = refusal("merge", runs / "out", runs / "a", runs / "b", "--jobs", "1")

    assert f"{runs / 'out'}/renders/distance-based/cam01" in message
    assert sorted(item.name for item in runs.iterdir()) == ["a", "b"]
    write_image(file, picture)
    run_command(["merge", str(runs / "out"), str(runs / "a"), str(runs / "b"), "--jobs", "1"])
    assert (runs / "out" / "results.parquet").is_file()
