"""Figures for papers: squares found where errors were planted, curves over K, files that are what
their suffix says.
"""

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
from matplotlib.figure import Figure

from ggvs_eval.errors import ResultsError
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import Frames
from ggvs_eval.reports import report
from ggvs_eval.reports.figures import paper_figures
from ggvs_eval.reports.figures.look import FigureLook, parse_width
from ggvs_eval.reports.figures.paper_figures import STRIP, write_figure
from ggvs_eval.reports.figures.regions import Square, find_regions, read_errors, square_side
from ggvs_eval.reports.figures.slices import most_different_row
from ggvs_eval.reports.figures.sweep_figures import draw_k, read_k_table
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.results import Results
from ggvs_eval.statistics.intervals import intervals
from helpers.command_line import refusal
from helpers.refusals import refused
from helpers.run_folders import RunShape, write_run
from helpers.small_runs import leave_out_pixels
from helpers.sweep_folders import write_sweep

SHAPE = RunShape(frames=Frames(2, 3), labels=("no-blending", "ours-geometric"))
SIDE = 10  # of the squares in frames of 64 x 48


def paint_planted(label: str, view: str, index: int) -> np.ndarray:
    """Grey frames. Both methods fail alike in the upper left; one alone in cam03, frame 3, less so
    in cam00, frame 2.
    """
    image = np.full((48, 64, 3), 100, np.uint8)
    if label != "truth":
        image[2 : 2 + SIDE, 3 : 3 + SIDE] = 200
    if label == "ours-geometric" and (view, index) == ("cam03", 3):
        image[30 : 30 + SIDE, 41 : 41 + SIDE] = 160
    if label == "ours-geometric" and (view, index) == ("cam00", 2):
        image[20 : 20 + SIDE, 50 : 50 + SIDE] = 140
    return image


@pytest.fixture(scope="module")
def planted(tmp_path_factory) -> Path:
    """A run of such frames; nobody changes it."""
    return write_run(tmp_path_factory.mktemp("figures") / "run", SHAPE, paint_planted)


@pytest.fixture
def sweep(tmp_path) -> Path:
    """Table of a sweep of two captures over K = 2, 4, 10 beside a row at the protocol's own K
    alone.
    """
    lines = [
        (capture, f"k{k}", method, 20.0 + k + (5.0 if capture == "b" else 0.0), 0.1 * k)
        for capture in ("a", "b")
        for k in (10, 2, 4)
        for method in ("Distance-based Blending", "GGVS (online)")
    ]
    lines += [
        ("mean", variant, method, psnr_db + 2.5, seconds)
        for _, variant, method, psnr_db, seconds in lines[:6]
    ]
    lines.append(("mean", "k4", "No Blending", 19.0, 0.1))
    columns = ["capture", "variant", "method", "PSNR", "s/frame"]
    pd.DataFrame(lines, columns=columns).to_csv(tmp_path / "sweep.csv", index=False)
    return tmp_path


def test_the_worst_square_is_where_the_error_was_planted(planted):
    """The rule finds the square to the pixel, scores it by its mean absolute error, and the next
    one overlaps none before.
    """
    run = read_run(planted)
    assert square_side((48, 64)) == SIDE
    first, second = find_regions(run, "worst", "ours-geometric", 2, view="cam03", frame=3)
    assert (first.top, first.left, first.score) == (2, 3, 100.0)
    assert (second.view, second.frame, second.top, second.left, second.score) == (
        "cam03",
        3,
        30,
        41,
        60.0,
    )
    errors = read_errors(run, "cam03", 3)
    assert set(errors) == {"no-blending", "ours-geometric"}
    assert (errors["ours-geometric"][35, 45], errors["no-blending"][35, 45]) == (60.0, 0.0)


def test_methods_differ_most_where_one_alone_fails(planted):
    """What all methods get wrong alike is no difference; over all views and frames the largest one
    is found.
    """
    (found,) = find_regions(read_run(planted), "different", "ours-geometric", 1)
    assert (found.view, found.frame, found.top, found.left, found.side) == (
        "cam03",
        3,
        30,
        41,
        SIDE,
    )
    assert found.score == pytest.approx(60.0)
    views = [
        region.view
        for region in find_regions(
            read_run(planted), "different", "ours-geometric", 5, one_per_view=True
        )
    ]
    assert views == ["cam03", "cam00"]
    assert len(find_regions(read_run(planted), "worst", "no-blending", 1, one_per_view=True)) == 1


def paint_with_holes(label: str, view: str, index: int) -> np.ndarray:
    """A textured picture, of which one method lacks a black edge; they differ a little on a plain
    patch and on texture.
    """
    y, x = np.mgrid[:48, :64]
    image = np.repeat((100 + 60 * ((x // 2 + y // 2) % 2)).astype(np.uint8)[..., None], 3, axis=2)
    image[14:30, 4:28] = 120
    if label == "no-blending":
        image[:6], image[-3:], image[:, -7:] = 0, 0, 0
        image[16:28, 8:24] += 30
        image[34:42, 36:48] += 25
    return image


def test_regions_rows_and_failures_lie_where_all_methods_have_pixels_and_texture(tmp_path):
    """The black frame edge of one method, the largest difference, is chosen by no rule; texture
    goes before a plain patch.
    """
    run = read_run(write_run(tmp_path / "run", SHAPE, paint_with_holes))
    for region in find_regions(run, "different", "no-blending", 2):
        rows, columns = (
            slice(region.top, region.top + region.side),
            slice(region.left, region.left + region.side),
        )
        picture = paint_with_holes("no-blending", "cam00", 2)[rows, columns]
        assert (picture.max(axis=2) > 0).mean() > 0.97
    (best,) = find_regions(run, "different", "no-blending", 1)
    assert (best.top in range(30, 43), best.left in range(30, 49)) == (True, True)
    (worst,) = find_regions(run, "worst", "no-blending", 1)
    assert worst.top >= 6
    assert worst.left + worst.side <= 58
    assert most_different_row(run.frame_folders("cam00"), run.frames) in range(6, 45)


@pytest.mark.slow
def test_the_figure_of_failures_is_about_our_method_itself(tmp_path, monkeypatch):
    """An ablation that stands first in the run is not taken for ours, by the command or by the
    report.
    """
    labels = ("ours-geometric+no-temporal", "ours-geometric", "no-blending")
    root = write_run(tmp_path / "run", replace(SHAPE, labels=labels))
    asked: list[str] = []
    monkeypatch.setattr(
        paper_figures,
        "draw_failures",
        lambda run, files, label, *rest: asked.append(label) or tuple(files),
    )
    write_figure(root, "failures", tmp_path / "failures.png")
    leave_out_pixels(monkeypatch)
    report.write_report([root], tmp_path / "report")
    assert asked == ["ours-geometric"] * 2


def test_figures_of_partial_or_imported_frames_name_a_way_out(tmp_path):
    """Without a path: `figure time`; with no whole method: what each lacks."""
    root = write_run(tmp_path / "run", replace(SHAPE, poses=0))
    with refused(ResultsError, "no method has frames along a camera path", "ggvs-eval figure time"):
        write_figure(root, "epi", tmp_path / "epi.png")
    results = Results.read(root)
    marks = {label: "partial in room: 1 of 2 views" for label in SHAPE.labels}
    replace(results, provenance=results.provenance | {"partial": marks}).write(root)
    with refused(
        ResultsError, "no-blending is partial in room: 1 of 2 views", "render the missing frames"
    ):
        write_figure(root, "crops", tmp_path / "crops.png")
    alone = write_run(tmp_path / "alone", RunShape(labels=("ours-geometric",)))
    with refused(ResultsError, "use --rule worst"):  # a single method differs from none
        write_figure(alone, "crops", tmp_path / "a.png")


@pytest.mark.parametrize(
    ("asked", "message"),
    [
        ({"view": "cam99"}, "no test view 'cam99'; use one of cam00, cam03"),
        ({"frame": 9}, "no frame 9; use 2 to 4"),
        ({"method": "nobody"}, "no complete renders of 'nobody'"),
        ({"boxes": 0}, "--boxes: wanted at least 1, got 0"),
        (
            {"methods": ("ours-geometric", "nobody")},
            "no complete renders of 'nobody'; use one of no-blending",
        ),
        ({"squares": (Square(60, 0, 8),)}, "square 60,0,8: leaves the picture of 64 x 48"),
        ({"has_scores": True, "metrics": ("FID",)}, "no FID; it has PSNR"),
    ],
)
def test_figures_refuse_what_is_not_there(planted, tmp_path, asked, message):
    """An unknown view, frame or method is an error that lists the known ones."""
    with pytest.raises(ResultsError, match=message):
        write_figure(planted, "crops", tmp_path / "a.png", **asked)


def drawn_figures(monkeypatch, module: str) -> list[Figure]:
    """Catch the figures that a module draws instead of writing them."""
    drawn: list[Figure] = []
    monkeypatch.setattr(
        f"ggvs_eval.reports.figures.{module}.save_figure",
        lambda figure, out: drawn.append(figure) or out,
    )
    return drawn


def texts(figure: Figure) -> list[str]:
    """Titles of all axes, and of the figure."""
    return [axes.get_title() or axes.get_title("left") for axes in figure.axes] + [
        figure.get_suptitle()
    ]


def test_squares_chosen_by_eye_are_cut_to_the_pixel(planted, tmp_path, monkeypatch):
    """The crop is what lies in the square of that view and frame, of the methods named, in their
    order.
    """
    drawn = drawn_figures(monkeypatch, "paper_figures")
    write_figure(
        planted,
        "crops",
        tmp_path / "a.png",
        view="cam03",
        frame=3,
        methods=("ours-geometric",),
        squares=(Square(41, 30, SIDE),),
    )
    _, _, truth, ours = drawn[0].axes
    assert np.array_equal(truth.images[0].get_array(), np.full((SIDE, SIDE, 3), 100))
    assert np.array_equal(ours.images[0].get_array(), np.full((SIDE, SIDE, 3), 160))
    assert ours.get_title() == "L1 60.0"


@pytest.mark.parametrize(
    ("kind", "module"), [("crops", "paper_figures"), ("time", "slices"), ("epi", "slices")]
)
def test_a_paper_chooses_methods_width_title_and_scores(
    planted, tmp_path, monkeypatch, kind, module
):
    """Methods stand in the order in which they are named, each with its scores; the title is the
    caption's.
    """
    drawn = drawn_figures(monkeypatch, module)
    options = {
        "methods": ("ours-geometric", "no-blending"),
        "has_scores": True,
        "metrics": ("PSNR",),
    }
    write_figure(
        planted, kind, tmp_path / "a.png", look=FigureLook(parse_width("84mm"), False), **options
    )
    write_figure(planted, kind, tmp_path / "b.png")
    assert drawn[0].get_figwidth() == pytest.approx(84 / 25.4)
    shown = " ".join(texts(drawn[0]))
    psnr_db = (
        read_run(planted).results.summary()["PSNR"].xs("ours-geometric", level="method").item()
    )
    assert f"PSNR {psnr_db:.2f}" in shown
    assert shown.index("GGVS (online)") < shown.index("No Blending")
    assert "row:" not in shown
    assert "boxes:" not in shown
    assert any("row:" in text or "boxes:" in text for text in texts(drawn[1]))


def test_strips_say_frames_and_seconds(planted, tmp_path, monkeypatch):
    """The vertical axis counts frames by their numbers, a second one seconds from the first of
    them.
    """
    drawn = drawn_figures(monkeypatch, "slices")
    write_figure(planted, "time", tmp_path / "a.png", row=7)
    strip = drawn[0].axes[1]
    assert strip.get_ylim() == (4.5, 1.5)
    (seconds,) = strip.child_axes
    drawn[0].draw_without_rendering()
    assert seconds.get_ylim() == pytest.approx((2.5 / 30, -0.5 / 30))
    assert drawn[0].axes[-1].get_xlabel() == "x (pixel)"


@pytest.mark.parametrize("width", ["3.3", "0in", "1e3in", "wide"])
def test_a_width_needs_its_unit(width):
    """A width without a unit, or at which nothing can be drawn, is refused."""
    with pytest.raises(ResultsError, match=r"such as 3\.3in"):
        parse_width(width)


def test_a_video_shows_all_beside_each_other(planted, tmp_path):
    """Every frame holds the truth and each method under a strip with its name; an odd size is made
    even.
    """
    (file,) = write_figure(
        planted, "video", tmp_path / "side", view="cam03", methods=("ours-geometric",)
    )
    video = VideoFrames(file)
    assert (file.name, video.n_frames, video.fps) == ("side.mp4", 3, 30.0)
    (frame,) = video.frames(1, 2)
    assert frame.shape == (STRIP + 48, 2 * 64, 3)
    assert abs(int(frame[STRIP + 35, 46].mean()) - 100) < 8
    assert abs(int(frame[STRIP + 35, 64 + 46].mean()) - 160) < 8
    assert frame[:STRIP].max() > 128
    with pytest.raises(ResultsError, match=r"must end in \.mp4"):
        write_figure(planted, "video", tmp_path / "side.avi")


@pytest.mark.slow
def test_a_name_without_suffix_writes_png_and_pdf(planted, tmp_path):
    """A figure of a run is written as both, under one name."""
    files = write_figure(planted, "crops", tmp_path / "crops")
    assert [file.name for file in files] == ["crops.png", "crops.pdf"]
    assert [file.read_bytes()[:4] for file in files] == [b"\x89PNG", b"%PDF"]


def test_k_table_is_the_mean_of_the_captures_in_order_of_k(sweep):
    """Of several captures the means are taken, K counts as a number, and a method has the K that it
    was evaluated at.
    """
    table = read_k_table(sweep)
    assert table.loc["GGVS (online)", "PSNR"].to_dict() == {2: 24.5, 4: 26.5, 10: 32.5}
    assert list(table.loc["GGVS (online)"].index) == [2, 4, 10]
    assert list(table.loc["No Blending"].index) == [4]


def test_k_figure_has_a_panel_per_metric_and_one_for_time(sweep, tmp_path, monkeypatch):
    """PSNR and seconds are drawn from the table's numbers over K; a metric that the sweep lacks is
    refused by name.
    """
    drawn = drawn_figures(monkeypatch, "sweep_figures")
    draw_k(sweep, tmp_path / "k.png")
    quality, seconds = drawn[0].axes
    line = next(each for each in quality.containers if each.get_label() == "GGVS (online)").lines[0]
    assert (list(line.get_xdata()), list(line.get_ydata())) == ([2, 4, 10], [24.5, 26.5, 32.5])
    assert (quality.get_ylabel(), seconds.get_ylabel()) == ("PSNR (dB)", "seconds per frame")
    with refused(ResultsError, "TCC", "PSNR, s/frame"):
        draw_k(sweep, tmp_path / "k.png", ("TCC",))


def test_k_figure_has_the_intervals_of_its_runs(tmp_path, monkeypatch):
    """A number of the table has the interval that it has in the table of its run; one that no run
    has, has none.
    """
    write_sweep(tmp_path)
    lines = pd.read_csv(tmp_path / "sweep.csv")
    shutil.rmtree(tmp_path / "k3")
    run = read_run(write_run(tmp_path / "k3", RunShape(k=3)))
    bounds = intervals(run.results, "PSNR", "Demo room")["ours-geometric"]
    lines.loc[(lines["variant"] == "k3") & (lines["method"] == "GGVS (online)"), "PSNR"] = (
        bounds.value
    )
    lines.to_csv(tmp_path / "sweep.csv", index=False)
    drawn = drawn_figures(monkeypatch, "sweep_figures")
    draw_k(tmp_path, tmp_path / "k.png")
    ours = next(each for each in drawn[0].axes[0].containers if each.get_label() == "GGVS (online)")
    segments = ours.lines[2][0].get_segments()
    assert [abs(high - low) > 0 for (_, low), (_, high) in segments] == [False, True, False]
    assert [y for _, y in segments[1]] == pytest.approx([bounds.low, bounds.high])


def test_k_figure_needs_a_sweep_over_k(planted, tmp_path):
    """A run folder is no sweep, and a sweep at one K has no curve; both say what to run."""
    assert "ggvs-eval sweep k" in refusal("figure", "k", planted, tmp_path / "k.png")
    pd.DataFrame([("k4", "GGVS (online)", 30.0)], columns=["variant", "method", "PSNR"]).to_csv(
        tmp_path / "sweep.csv", index=False
    )
    assert "at least two numbers of source views, got 1" in refusal(
        "figure", "k", tmp_path, tmp_path / "k.png"
    )


@pytest.mark.slow
def test_command_line_writes_the_figures(planted, sweep, tmp_path, capsys):
    """`ggvs-eval figure KIND RUN OUT` prints the files that it has written."""
    run_command(
        ["figure", "crops", str(planted), str(tmp_path / "c"), "--rule", "worst", "--boxes", "1"]
    )
    run_command(["figure", "k", str(sweep), str(tmp_path / "k.pdf"), "--metrics", "PSNR"])
    files = [Path(line) for line in capsys.readouterr().out.split()]
    assert [file.name for file in files] == ["c.png", "c.pdf", "k.pdf"]
    assert all(file.stat().st_size > 1000 for file in files)
