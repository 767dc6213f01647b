"""Partial renders in a report: marked, not ranked, and left out of the pictures."""

import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from ggvs_eval.files.images import write_image
from ggvs_eval.merged_results import merge_results
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.reports.report import write_report
from ggvs_eval.run_folder import RunFolder
from helpers.render_folders import FRAMES, make_run, truth, write_folders


@pytest.fixture(scope="module")
def partial_run(tmp_path_factory) -> RunFolder:
    """Two whole methods, and a perfect one of one view and two frames, with its report; nobody
    changes it.
    """
    tmp_path = tmp_path_factory.mktemp("partial")
    run = make_run(tmp_path / "run", ("PSNR",))
    import_renders(run, "a", write_folders(tmp_path / "a"))
    import_renders(run, "b", write_folders(tmp_path / "b"))
    for frame in FRAMES[:2]:
        write_image(tmp_path / "c" / "cam00" / f"{frame:04d}.png", truth("cam00", frame))
    import_renders(run, "c", tmp_path / "c", allow_partial=True)
    score(run)
    write_report([run.root], with_figures=False)
    return run


def test_a_partial_row_is_marked_and_not_ranked(partial_run):
    """The row's name and the caption say that it is partial; though its numbers are best, it is not
    bold.
    """
    lines = (partial_run.report / "tables.md").read_text().splitlines()
    rows = [line for line in lines if line.startswith("| c ")]
    assert rows
    assert all(line.startswith("| c (partial) |") and "**" not in line for line in rows)
    assert any(
        "c is partial in room: 0 of 2 views complete, 2 of 6 frames (cam00); it is not ranked."
        in line
        for line in lines
    )
    assert any(line.startswith("| a | ") for line in lines)
    assert any(
        "b (faulty) shows the same frames as a, so it is not ranked" in line for line in lines
    )


@pytest.mark.slow
def test_a_run_of_partial_renders_alone_has_a_page(partial_run, tmp_path):
    """With nothing to compare with there is still a table and a page, figures and all."""
    run = RunFolder(Path(shutil.copytree(partial_run.root, tmp_path / "run")))
    for label in ("a", "b"):
        shutil.rmtree(run.root / "renders" / label)
    score(run)

    assert "c (partial)" in write_report([run.root]).read_text()


def test_nothing_is_said_of_images_that_nobody_knows(partial_run):
    """Frames that others rendered are not said to be made from the protocol's sources, in tables or
    on the page.
    """
    assert "other cameras" not in (partial_run.report / "index.html").read_text()
    for name in ("index.html", "tables.md", "tables.tex"):
        assert "source views" not in (partial_run.report / name).read_text()


def test_marks_survive_merging(partial_run):
    """Results of several scenes in one keep the marks of each."""
    results = score(partial_run)
    inputs = {
        name.replace("room/", "hall/"): f"{digest} too"
        for name, digest in results.provenance["inputs"].items()
    }
    other = replace(
        results,
        table=results.table.assign(scene="hall"),
        provenance=results.provenance | {"inputs": inputs},
    )

    merged = merge_results([results, other])

    assert merged.scenes == ("room", "hall")
    assert merged.provenance["partial"] == results.provenance["partial"]
