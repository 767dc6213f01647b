"""Reports of small run folders: every number where it belongs, nothing loaded, nothing left
blank.
"""

import re
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import GgvsError, RenderError, ResultsError
from ggvs_eval.files.images import write_image
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.figures.curves import curve_panels
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.page.page import render_page
from ggvs_eval.reports.page.pictures import compare_frames, error_map
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report, with_sections
from ggvs_eval.reports.tables.table_formats import escape_latex
from ggvs_eval.run_folder import RunFolder, frame_path, read_json, write_json
from helpers.page_reader import PageReader
from helpers.refusals import refused
from helpers.run_folders import LABELS, NAMES, RunShape, write_run
from helpers.whole_run import copy_of

SMALL = RunShape(views=("cam00",), metrics=("PSNR", "LPIPS"), poses=0)
NASTY = '<script>alert("x")</script> & | _100%_ $x^2$ {y} \\z #1 ~'


@pytest.fixture(scope="module")
def small_run(tmp_path_factory) -> Path:
    """A run with views, frames and a path of everything; nobody changes it."""
    return write_run(tmp_path_factory.mktemp("reports") / "run")


@pytest.fixture(scope="module")
def report(whole_run) -> Path:
    """Folder of a report with every figure."""
    return whole_run / "report"


def test_report_is_whole(report):
    """A report is a page, tables of each kind and the figures, and no temporary file stays
    behind.
    """
    names = {str(file.relative_to(report)) for file in report.rglob("*") if file.is_file()}
    curves = {
        f"curves_{metric}"
        for metric in ("PSNR", "PSNR_cc", "PSNR_static", "PSNR_disoccluded", "SSIM", "L1", "TCC")
    }
    figures = {"crops", "failures", "epi", "x-t_cam00", "x-t_cam01"} | curves
    tables = {
        f"{name}.{kind}" for name in ("tables", "reproduction") for kind in ("md", "csv", "tex")
    }
    assert names == {"index.html", "tables.xlsx", "job.json"} | tables | {
        f"figures/{name}.png" for name in figures
    }


def test_page_loads_nothing(report):
    """Every address in the page is a picture or a video inside it or a place in it, and its policy
    forbids the rest.
    """
    text = (report / "index.html").read_text(encoding="utf-8")
    page = PageReader(text)
    assert page.addresses
    assert all(
        re.match(r"data:image/(png|webp);base64,|data:video/mp4;base64,|#", address)
        for address in page.addresses
    )
    assert not {"link", "iframe", "object", "embed", "base"} & set(page.tags)
    assert not re.search(r"url\(|@import|\bfetch\(|XMLHttpRequest|import\(", text)
    assert "default-src 'none'" in text


@pytest.mark.slow
def test_open_findings_of_check_are_on_the_page(tmp_path):
    """What `check` found is on the first screen and in full in "What was measured"; an unchecked
    capture has the command.
    """
    run = RunFolder(write_run(tmp_path / "run"))
    assert "was not checked" in render_page(with_sections(Report(read_groups([run.root]))))
    repeats = {
        "question": "frozen frames",
        "measured": "frames 3, 9 repeat the one before",
        "advice": "give the original video",
    }
    findings = [
        {"subject": name, "verdict": "bad", "values": {}, **repeats} for name in ("cam01", "cam02")
    ]
    fine = {
        "subject": "rig",
        "question": "noise",
        "verdict": "ok",
        "measured": "2",
        "values": {},
        "advice": "",
    }
    write_json(run.check_record, {"findings": [fine, *findings]})
    page = render_page(with_sections(Report(read_groups([run.root]))))
    assert "Check found faults in room: frozen frames." in page
    assert (
        "<dt>frozen frames, cam01, cam02</dt><dd>frames 3, 9 repeat the one before; give the "
        "original video</dd>" in page
    )


def test_places_linked_in_the_page_exist(report):
    """Each link leads to a section, or to a place of a viewer: `#room/view/frame/...`."""
    text = (report / "index.html").read_text(encoding="utf-8")
    links = re.findall(r'href="#([^"]+)"', text)
    assert links
    rooms = re.findall(r'data-address="([^"]*)"', text)
    assert all(f'id="{link}"' in text or link.partition("/")[0] in rooms for link in links)


def test_names_are_harmless(tmp_path):
    """Markup in the names of methods and scenes is shown, not obeyed, in every format."""
    names = tuple((NAMES | {"ours-geometric": NASTY}).items())
    run = write_run(tmp_path / "run", replace(SMALL, names=names, scene=NASTY))
    report = write_report([run], with_figures=False).parent
    text = (report / "index.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert NASTY in PageReader(text).texts
    assert PageReader(text).tags.count("script") == 3
    assert "<script" not in (report / "tables.md").read_text(encoding="utf-8")
    assert escape_latex(NASTY) in (report / "tables.tex").read_text(encoding="utf-8")


def test_no_run_and_a_run_twice_are_refused(small_run, tmp_path):
    """A report needs a run, and each run once; the message says which was given twice."""
    with refused(ResultsError, "one run"):
        write_report([])
    with refused(ResultsError, "run: ", "2 times"):
        write_report([small_run, small_run.parent / "." / "run"], tmp_path / "report")


@pytest.mark.slow
def test_two_scenes_share_one_page(tmp_path):
    """Two scenes under one protocol have one main table, the mean over both, and a viewer, heat
    maps and linked slices each.
    """
    shapes = (replace(SMALL, scene=scene, poses=2) for scene in ("room", "kitchen"))
    runs = [write_run(tmp_path / shape.scene, shape) for shape in shapes]
    page = PageReader(
        write_report(runs, tmp_path / "report", with_figures=False).read_text(encoding="utf-8")
    )
    assert page.tags.count("select") == 2 * (3 + 1 + 1)
    assert "room, kitchen" in page.texts


def lose_renders(run: Path) -> None:
    shutil.rmtree(run / "renders")


def lose_a_frame(run: Path) -> None:
    frame_path(run / "renders" / "no-blending" / "cam03", 4).unlink()


def exchange_the_protocol(run: Path) -> None:
    shutil.copy(
        write_run(run.with_name("other"), RunShape(frames=Frames(0, 3))) / "protocol.toml",
        run / "protocol.toml",
    )


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lose_renders, ("renders",)),
        (lose_a_frame, ("No Blending in cam03", "lacks 4")),
        (exchange_the_protocol, ("score` again",)),
    ],
)
def test_what_does_not_belong_to_its_results_is_named(damage, words, tmp_path):
    """Renders or a frame that were deleted after scoring, and results of another protocol than the
    one that lies beside them.
    """
    run = write_run(tmp_path / "run")
    damage(run)
    with refused(GgvsError, *words):
        write_report([run])


@pytest.mark.slow
def test_single_frame_is_enough(tmp_path):
    """A run of one frame has a report that says once that nothing is drawn over time: no curves,
    heat maps, slices or videos.
    """
    run = write_run(
        tmp_path / "run",
        RunShape(frames=Frames(0, 1), metrics=("PSNR", "TCC")),
        not_computed={"TCC": "1 frame; needs 2"},
    )
    text = write_report([run], with_figures=False).read_text(encoding="utf-8")
    assert text.count("is neither reported nor drawn") == 1
    assert not re.search(
        r'id="(curves|heat|videos)"|Over time <|over time, t downwards|<video', text
    )
    assert 'id="views"' in text
    assert "not computed: 1 frame; needs 2" in text
    assert "of the only frame of each view" in text


@pytest.mark.slow
def test_run_without_path_says_so(tmp_path):
    """Without frames along a camera path the page says that there is no epipolar plane image, and
    the rest is there.
    """
    page = write_report([write_run(tmp_path / "run", SMALL)], with_figures=False)
    assert "there is no epipolar plane image" in page.read_text(encoding="utf-8")


@pytest.mark.slow
def test_equal_inputs_give_equal_bytes(whole_run, report, tmp_path):
    """A second report of the same run is the same to the bit, wherever the run lies."""
    again = write_report([copy_of(whole_run, tmp_path / "run").root]).parent
    for file in report.rglob("*.*"):
        if not file.name.startswith("."):
            assert file.read_bytes() == (again / file.relative_to(report)).read_bytes(), file


def test_page_tells_nothing_of_the_machine(whole_run, report):
    """Neither the folder of the run nor the path of the capture stands in the page, only their
    names.
    """
    text = (report / "index.html").read_text(encoding="utf-8")
    assert str(whole_run.parent) not in text
    assert "ggvs-eval prepare run --capture room" in text


@pytest.mark.slow
def test_page_names_the_depth(tmp_path):
    """The facts and commands of a run name the matcher of its depth, without folders; a measured
    scale has four digits.
    """
    run = write_run(tmp_path / "run", SMALL)
    (run / "depth.json").write_text('{"matcher": "sgbm+itermvs:/home/somebody/model.ckpt"}')
    record = read_json(run / "capture.json") | {"units_per_metre": 8.481877397921176}
    write_json(run / "capture.json", record)
    text = (write_report([run], with_figures=False).parent / "index.html").read_text(
        encoding="utf-8"
    )
    assert "depth by" in text
    assert "<dt>units per metre</dt><dd>8.482</dd>" in text
    assert "protocol.toml --matcher sgbm+itermvs:model.ckpt" in text
    assert "/home/somebody" not in text


def test_error_map_is_black_where_right_and_bright_where_wrong(tmp_path):
    """Equal pixels are the first colour of magma, differences at or above the full scale the last,
    whatever their size.
    """
    truth = np.full((4, 6, 3), 100, np.uint8)
    rendered = truth.copy()
    rendered[0, 0], rendered[1, 1] = 164, 255
    errors = error_map(rendered, truth, tmp_path)
    assert errors[2, 2].sum() < 10
    assert errors[0, 0].sum() > 600
    np.testing.assert_array_equal(errors[0, 0], errors[1, 1])


def test_frame_of_another_size_is_refused(tmp_path):
    """A render whose size is not the truth's is an error that names the file and both sizes."""
    run = write_run(tmp_path / "run")
    file = frame_path(run / "renders" / "no-blending" / "cam00", 3)
    write_image(file, np.zeros((24, 32, 3), np.uint8))
    with refused(RenderError, "0003.png", "64 x 48", "32 x 24"):
        compare_frames(read_run(run))


@pytest.mark.slow
def test_pictures_shrink_to_their_budget(tmp_path):
    """With less room the frames get narrower, and their bytes stay within the budget."""
    run = read_run(write_run(tmp_path / "run", RunShape(width=480, height=96)))
    wide, narrow = compare_frames(run), compare_frames(run, 150_000)
    assert wide.width == 480 > narrow.width
    texts = [
        text for view in narrow.images.values() for pictures in view.values() for text in pictures
    ]
    assert len(texts) == 2 * 4 * 4
    assert sum(map(len, texts)) * 3 / 4 <= 150_000 * 1.05


def test_curves_of_one_metric_share_their_axes(small_run):
    """Panels of a metric have the same bounds in every view, and every point lies inside the
    drawing.
    """
    panels = [panel for panel in curve_panels(read_run(small_run)) if panel.metric == "TCC"]
    assert [panel.view for panel in panels] == ["cam00", "cam03"]
    assert len({panel.bounds for panel in panels}) == 1
    points = [
        float(n)
        for panel in panels
        for curve in panel.curves
        for n in re.findall(r"[\d.]+", panel.points(curve))
    ]
    assert len(points) == 2 * len(LABELS) * 3 * 2
    assert all(10 <= x <= 330 for x in points[::2])
    assert all(10 <= y <= 146 for y in points[1::2])
    assert [text for _, text in panels[0].value_ticks()] == ["0.3", "0.4", "0.5", "0.6", "0.7"]
