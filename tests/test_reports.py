"""Reports of small run folders: every number where it belongs, nothing loaded, nothing left blank."""

import csv
import hashlib
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import RenderError, ResultsError
from ggvs_eval.images import write_image
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.comparison import compare_frames, error_map
from ggvs_eval.reports.curves import curve_panels
from ggvs_eval.reports.measured import read_run
from ggvs_eval.reports.published import published_rows, read_published
from ggvs_eval.reports.report import write_report
from ggvs_eval.reports.table import Cell, Column, Row, Table, format_value, rank, shade
from ggvs_eval.reports.table_formats import escape_latex, to_latex, to_markdown
from ggvs_eval.reports.tables import main_tables
from ggvs_eval.reports.timing import timing_table
from ggvs_eval.results import Results
from ggvs_eval.run_folder import frame_path
from run_folders import LABELS, NAMES, RunShape, write_run

SMALL = RunShape(views=("cam00",), metrics=("PSNR", "LPIPS"), poses=0)
NASTY = '<script>alert("x")</script> & | _100%_ $x^2$ {y} \\z #1 ~'


class PageReader(HTMLParser):
    """What a page would load, run and show."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.addresses: list[str] = []
        self.tags: list[str] = []
        self.texts: list[str] = []
        self.feed(text)

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [value for name, value in attrs if name in {"src", "href", "srcset", "data", "action"}]

    def handle_data(self, data):
        self.texts.append(data.strip())


@pytest.fixture(scope="module")
def run(tmp_path_factory) -> Path:
    """A whole run; nobody changes it."""
    return write_run(tmp_path_factory.mktemp("reports") / "run")


@pytest.fixture(scope="module")
def report(run, tmp_path_factory) -> Path:
    """Folder of its report."""
    return write_report([run], tmp_path_factory.mktemp("reports") / "report").parent


def test_report_is_whole(report):
    """A report is a page, three kinds of tables and the figures, and no temporary file stays behind."""
    names = {str(file.relative_to(report)) for file in report.rglob("*") if file.is_file()}
    figures = {"epi.png", "x-t_cam00.png", "x-t_cam03.png"} | {
        f"curves_{m}.png" for m in ("PSNR", "PSNR_cc", "SSIM", "LPIPS", "L1", "TCC")
    }
    assert names == {"index.html", "tables.md", "tables.csv", "tables.tex"} | {f"figures/{name}" for name in figures}


def test_page_loads_nothing(report):
    """Every address in the page is a picture inside it or a place in it, and its policy forbids the rest."""
    text = (report / "index.html").read_text(encoding="utf-8")
    page = PageReader(text)
    assert page.addresses
    assert all(re.match(r"data:image/(png|webp);base64,|#", address) for address in page.addresses)
    assert not {"link", "iframe", "object", "embed", "base"} & set(page.tags)
    assert not re.search(r"url\(|@import|\bfetch\(|XMLHttpRequest|import\(", text)
    assert "default-src 'none'" in text


def test_places_linked_in_the_page_exist(report):
    """Each link of the navigation leads to a section."""
    text = (report / "index.html").read_text(encoding="utf-8")
    links = re.findall(r'href="#([^"]+)"', text)
    assert links
    assert all(f'id="{link}"' in text for link in links)


def test_every_number_is_the_summary_rounded(run, report):
    """Each cell of the main tables is the value of Results.summary, rounded as the table of decimals says."""
    summary = Results.read(run).summary()
    rows = list(csv.DictReader((report / "tables.csv").open(encoding="utf-8")))
    page = PageReader((report / "index.html").read_text(encoding="utf-8"))
    labels = {name: label for label, name in NAMES.items()}
    main = [row for row in rows if row["table"] in {"quality", "consistency"}]
    assert len(main) == len(LABELS) * 9
    for row in main:
        method, _, variant = labels[row["method"]].partition("+")
        value = summary.loc[("Demo room", method, variant), row["column"]]
        assert float(row["value"]) == value
        assert row["shown"] == format_value(row["column"], value)
        assert row["shown"] in page.texts
        assert row["shown"] in (report / "tables.md").read_text(encoding="utf-8")
        assert row["shown"] in (report / "tables.tex").read_text(encoding="utf-8")


def test_views_have_their_own_numbers(run, report):
    """Each cell of the table per view is the mean over the frames of that view."""
    rows = list(csv.DictReader((report / "tables.csv").open(encoding="utf-8")))
    values = Results.read(run).per_view("TCC")
    shown = {(row["method"], row["column"]): float(row["value"]) for row in rows if row["table"] == "view-TCC"}
    assert shown == {
        (NAMES["+".join(filter(None, key))], view): values.loc[key, view] for key in values.index for view in ("cam00", "cam03")
    }


@pytest.mark.parametrize(
    ("metric", "value", "text"),
    [
        ("PSNR", 31.1749, "31.17"),
        ("SSIM", 0.9355, "0.935"),
        ("L1", 5.0, "5.00"),
        ("STED", 2796.4, "2796"),
        ("STED", 68.7612, "68.76"),
        ("STED", 0.56312, "0.5631"),
        ("STED", 0.0, "0.000"),
        ("PSNR", float("inf"), "∞"),
    ],
)
def test_values_are_rounded_as_the_paper_does(metric, value, text):
    """Decimals are fixed per metric; STED has four significant digits; a perfect picture has infinite PSNR."""
    assert format_value(metric, value) == text


def test_missing_metric_says_why(tmp_path):
    """Where a metric could not be computed its reason stands in the cell, and no cell is blank or NaN."""
    run = write_run(tmp_path / "run", SMALL, not_computed={"LPIPS": "weights absent, run `make install`"})
    report = write_report([run]).parent
    for name in ("index.html", "tables.md", "tables.csv", "tables.tex"):
        text = re.sub(r"base64,[\w+/=]+", "", (report / name).read_text(encoding="utf-8"))
        assert "not computed: weights absent" in text
        assert not re.search(r"<td[^>]*>\s*</td>|\| +\||& +&|\bnan\b", text, re.IGNORECASE)


def test_best_is_bold_and_the_better_half_blue():
    """The best printed value is marked, ties together; published rows take no part, however good they are."""
    cells = [Cell("1.0", 1.0), Cell("2.0", 2.0), Cell("3.0", 2.98), Cell("3.0", 3.0)]
    rows = [Row(str(index), (cell,)) for index, cell in enumerate(cells)] + [Row("paper", (Cell("9.0", 9.0),), "published")]
    ranked = [row.cells[0] for row in rank([Column("PSNR", "dB", True)], rows)]
    assert [cell.best for cell in ranked] == [False, False, True, True, False]
    assert [cell.shade > 0 for cell in ranked] == [False, False, True, True, False]
    falling = [row.cells[0] for row in rank([Column("L1", "", False)], rows)]
    assert [cell.best for cell in falling] == [True, False, False, False, False]


def test_blue_is_the_papers():
    """The shade follows the gain curve of the paper's TeX, here evaluated by hand at three quarters of the range."""
    assert shade(0.5, True) == shade(0.2, False) == 0.0
    assert shade(1.0, True) == shade(1.0, False) == 1.0
    assert shade(0.75, True) == pytest.approx(0.5 / (2.0 * 0.5 + 1.0))
    assert shade(0.75, False) == pytest.approx(0.5 / ((1 / 0.15 - 2) * 0.5 + 1.0))


def test_alone_nobody_is_best(tmp_path):
    """A single method is neither marked nor shaded, for want of a comparison."""
    run = read_run(write_run(tmp_path / "run", RunShape(labels=("ours-geometric",))))
    cells = [cell for table in main_tables([run], run.results) for row in table.rows for cell in row.cells]
    assert not any(cell.best or cell.shade for cell in cells)


def test_names_are_harmless(tmp_path):
    """Markup in the names of methods and scenes is shown, not obeyed, in every format."""
    names = tuple((NAMES | {"ours-geometric": NASTY}).items())
    run = write_run(tmp_path / "run", replace(SMALL, names=names, scene=NASTY))
    report = write_report([run]).parent
    text = (report / "index.html").read_text(encoding="utf-8")
    assert "<script>alert" not in text
    assert NASTY in PageReader(text).texts
    assert PageReader(text).tags.count("script") == 2
    assert "<script" not in (report / "tables.md").read_text(encoding="utf-8")
    assert escape_latex(NASTY) in (report / "tables.tex").read_text(encoding="utf-8")


def test_latex_escapes_every_special_character():
    """Each character that TeX obeys prints as itself."""
    assert escape_latex("a_b 50% & {x} #1 $y$ ~ ^ \\") == (
        r"a\_b 50\% \& \{x\} \#1 \$y\$ \textasciitilde{} \textasciicircum{} \textbackslash{}"
    )


def test_latex_is_balanced(report):
    """Every environment is closed, every row of a tabular has as many cells as columns."""
    text = (report / "tables.tex").read_text(encoding="utf-8")
    assert re.findall(r"\\begin\{(\w+)\}", text).count("table") == text.count(r"\end{table}")
    for columns, body in re.findall(r"\\begin\{tabular\}\{(l+c*)\}(.*?)\\end\{tabular\}", text, re.DOTALL):
        rows = [line for line in body.splitlines() if line.endswith(r"\\")]
        assert {len(re.findall(r"(?<!\\)&", row)) for row in rows} == {len(columns) - 1}
    assert re.search(r"\\cellcolor\[rgb\]\{0\.750, 0\.750, 1\}\\textbf\{", text)


def test_published_rows_stand_beside_their_own_dataset_only():
    """DyNeRF has the paper's rows with the paper's digits; a demo room has none; what the paper lacks is said."""
    rows = published_rows("quality", "dynerf", ("PSNR", "PSNR_cc"))
    assert [row.name for row in rows][-1] == "Ours (paper)"
    assert [cell.text for cell in rows[-1].cells] == ["31.17", "not reported"]
    assert {row.kind for row in rows} == {"published"}
    assert published_rows("quality", "Demo room", ("PSNR",)) == ()


def test_published_values_are_whole():
    """The packaged tables hold 5 methods x 3 datasets x 4 metrics twice, 5 ablations x 4 metrics, and the stages' times."""
    counts = {
        name: sum(len(metrics) for methods in read_published(name).values() for metrics in methods.values())
        for name in ("quality", "consistency", "ablation", "timing")
    }
    assert counts == {"quality": 60, "consistency": 60, "ablation": 20, "timing": 6}


def test_published_rows_are_grey_everywhere(tmp_path):
    """Beside measured DyNeRF values the paper's rows are set apart in the page, in Markdown and in LaTeX."""
    report = write_report([write_run(tmp_path / "run", replace(SMALL, dataset="DyNeRF"))]).parent
    assert '<tr class="published">' in (report / "index.html").read_text(encoding="utf-8")
    assert "| *Ours (paper)* | *31.17* | *0.191* |" in (report / "tables.md").read_text(encoding="utf-8")
    assert r"\textcolor{gray}{Ours (paper)} & \textcolor{gray}{31.17} & \textcolor{gray}{0.191}" in (
        report / "tables.tex"
    ).read_text(encoding="utf-8")


def test_different_protocols_are_refused(run, tmp_path):
    """Runs under two protocols do not get a common table; the message names both hashes."""
    other = write_run(tmp_path / "other", RunShape(frames=Frames(0, 3)))
    with pytest.raises(ResultsError, match="different protocols"):
        write_report([run, other], tmp_path / "report")
    with pytest.raises(ResultsError, match="at least one run"):
        write_report([])


def test_stale_results_are_refused(tmp_path):
    """Results of another protocol than the one that lies beside them are not reported."""
    run, other = write_run(tmp_path / "run"), write_run(tmp_path / "other", RunShape(frames=Frames(0, 3)))
    shutil.copy(other / "protocol.toml", run / "protocol.toml")
    with pytest.raises(ResultsError, match="score` again"):
        write_report([run])


def test_two_scenes_share_one_page(tmp_path):
    """Two scenes under one protocol have one main table, the mean over both, and a comparison each."""
    shapes = (replace(SMALL, scene=scene, poses=2) for scene in ("room", "kitchen"))
    runs = [write_run(tmp_path / shape.scene, shape) for shape in shapes]
    page = PageReader(write_report(runs, tmp_path / "report").read_text(encoding="utf-8"))
    assert page.tags.count("select") == 6
    assert "room, kitchen" in page.texts
    assert (tmp_path / "report" / "figures" / "run1" / "epi.png").is_file()


def test_run_without_renders_is_refused(tmp_path):
    """Results whose frames were all deleted are not reported; the message says what to run."""
    run = write_run(tmp_path / "run")
    shutil.rmtree(run / "renders")
    with pytest.raises(ResultsError, match="no frames under renders"):
        write_report([run])


def test_missing_frame_is_named(tmp_path):
    """A frame that was deleted after scoring is an error that names method, view and frame."""
    run = write_run(tmp_path / "run")
    frame_path(run / "renders" / "no-blending" / "cam03", 4).unlink()
    with pytest.raises(RenderError, match="No Blending in cam03 lacks 4"):
        write_report([run])


def test_single_frame_is_enough(tmp_path):
    """A run of one frame has a report that says why there are no curves and no slices over time."""
    run = write_run(
        tmp_path / "run", RunShape(frames=Frames(0, 1), metrics=("PSNR", "TCC")), not_computed={"TCC": "1 frame; needs 2"}
    )
    text = write_report([run]).read_text(encoding="utf-8")
    assert "there is no curve" in text
    assert "there is no slice over time" in text
    assert "not computed: 1 frame; needs 2" in text
    assert "of the only frame of each view" in text


def test_run_without_path_says_so(tmp_path):
    """Without frames along a camera path the page says that there is no epipolar plane image, and the rest is there."""
    report = write_report([write_run(tmp_path / "run", SMALL)]).parent
    assert "there is no epipolar plane image" in (report / "index.html").read_text(encoding="utf-8")
    assert not (report / "figures" / "epi.png").exists()


def test_equal_inputs_give_equal_bytes(run, report, tmp_path):
    """A second report of the same run is the same to the bit, wherever it is written."""
    again = write_report([run], tmp_path / "again").parent
    files = sorted(file.relative_to(report) for file in report.rglob("*") if file.is_file())
    digests = [[hashlib.sha256((folder / file).read_bytes()).hexdigest() for file in files] for folder in (report, again)]
    assert digests[0] == digests[1]


def test_page_tells_nothing_of_the_machine(run, report):
    """Neither the folder of the run nor the path of the capture stands in the page, only their names."""
    text = (report / "index.html").read_text(encoding="utf-8")
    assert "/home/somebody" not in text
    assert str(run.parent) not in text
    assert "ggvs-eval prepare run --capture room" in text


def test_times_leave_out_the_first_frame(run):
    """Median and 95th percentile are over all frames but each view's first, and the total is the sum of the stages."""
    table = timing_table(read_run(run))
    assert [column.name for column in table.columns] == ["splat", "blend", "total"]
    assert [cell.text for cell in table.rows[0].cells] == ["11.0 (12.0)", "22.0 (24.0)", "33.0 (36.0)"]
    assert "K = 2, 64 × 48, 2 threads" in table.caption


def test_frames_of_others_have_no_times(tmp_path):
    """Frames that came without a record of their making say so instead of a time."""
    run = write_run(tmp_path / "run")
    for record in (run / "renders" / "no-blending").rglob("job.json"):
        record.unlink()
    assert {cell.text for cell in timing_table(read_run(run)).rows[0].cells} == {"not computed: no times recorded"}


def test_error_map_is_black_where_right_and_bright_where_wrong(tmp_path):
    """Equal pixels are the first colour of magma, differences at or above the full scale the last, whatever their size."""
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
    with pytest.raises(RenderError, match=r"0003\.png: wanted 64 x 48 pixels as the truth has, got 32 x 24"):
        compare_frames(read_run(run))


def test_pictures_shrink_to_their_budget(tmp_path):
    """With less room the frames get narrower, and their bytes stay within the budget."""
    run = read_run(write_run(tmp_path / "run", RunShape(width=480, height=96)))
    wide, narrow = compare_frames(run), compare_frames(run, 150_000)
    assert wide.width == 480 > narrow.width
    texts = [text for view in narrow.images.values() for pictures in view.values() for text in pictures]
    assert len(texts) == 2 * 4 * 4
    assert sum(map(len, texts)) * 3 / 4 <= 150_000 * 1.05


def test_curves_of_one_metric_share_their_axes(run):
    """Panels of a metric have the same bounds in every view, and every point lies inside the drawing."""
    panels = [panel for panel in curve_panels(read_run(run)) if panel.metric == "TCC"]
    assert [panel.view for panel in panels] == ["cam00", "cam03"]
    assert len({panel.bounds for panel in panels}) == 1
    points = [float(n) for panel in panels for curve in panel.curves for n in re.findall(r"[\d.]+", panel.points(curve))]
    assert len(points) == 2 * len(LABELS) * 3 * 2
    assert all(10 <= x <= 330 for x in points[::2])
    assert all(10 <= y <= 146 for y in points[1::2])
    assert [text for _, text in panels[0].value_ticks()] == ["0.3", "0.4", "0.5", "0.6", "0.7"]


def test_empty_table_formats():
    """A table without rows is still a valid table in Markdown and LaTeX."""
    table = Table("quality", "Quality", "Nothing yet.", (Column("PSNR", "dB", True),), ())
    assert "| Method | PSNR (dB) ↑ |" in to_markdown([table])
    assert "Method & PSNR (dB)$\\uparrow$" in to_latex([table])
