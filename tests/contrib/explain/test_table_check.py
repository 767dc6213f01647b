"""A published table against scored runs: its cells are read from every format, and each gets the
verdict that was planted.
"""

import csv
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from skimage.metrics import structural_similarity

from ggvs_eval.contrib.explain.check import CheckedCell, Runs, check_cells, expected_by_chance
from ggvs_eval.contrib.explain.quoted_tables import QuotedCell, read_quoted
from ggvs_eval.contrib.explain.results_of_check import check_csv, check_text, summary, write_check
from ggvs_eval.errors import MetricError, ResultsError
from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import read_scores
from ggvs_eval.reports.tables_of_runs import tables_of_runs
from ggvs_eval.run_folder import RunFolder, frame_path, write_json
from helpers.run_folders import LABELS, NAMES, RunShape, write_run

METRICS = ("PSNR", "SSIM", "L1")
SHAPE = RunShape(frames=Frames(0, 8), poses=0, metrics=METRICS)
TEX = r"""
\begin{tabular}{l|cc|cc} \toprule
 & \multicolumn{2}{c|}{fern} & \multicolumn{2}{c}{Mean} \\ \cmidrule(lr){2-3}
Method & PSNR$\uparrow$ & SSIM (\%) & PSNR & FPS \\ \midrule
A~\cite{a} & \textbf{22.64} & 77.4 & 30.10$\pm$0.2 & 15 \\ % 99.99
\rowcolor{gray} B-2 & 21.0 & -- & \underline{31.2} & 3 \\[2pt]
\bottomrule \end{tabular}
"""
READ = [("A", "fern", "PSNR", "22.64"), ("A", "fern", "SSIM", "0.774"), ("A", "", "PSNR", "30.10")]
READ += [("B-2", "fern", "PSNR", "21.0"), ("B-2", "", "PSNR", "31.2")]


def scored(root, shape):
    """A run folder with measured values of its made-up pictures."""
    write_run(root, shape)
    write_json(
        root / "capture.json",
        RunFolder(root).capture_record() | {"digests": dict.fromkeys(shape.views, "made by hand")},
    )
    score(RunFolder(root))
    return root


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return scored(tmp_path_factory.mktemp("table_check") / "run", SHAPE)


@pytest.fixture(scope="module")
def still(tmp_path_factory):
    """Two frames of one view, since conventions of SSIM take a second per frame."""
    return scored(
        tmp_path_factory.mktemp("table_check") / "still",
        replace(SHAPE, views=("cam00",), frames=Frames(0, 2)),
    )


def quoted(text: str, metric: str = "PSNR", method: str = LABELS[0], row: int = 0) -> QuotedCell:
    return QuotedCell(method, "", metric, text, row, METRICS.index(metric))


def checked(run, *cells: QuotedCell) -> list[CheckedCell]:
    return check_cells(cells, Runs([read_scores(run)], {}))


def measured(run, metric: str, label: str = LABELS[0]) -> float:
    return (
        read_scores(run)
        .results.summary()
        .xs(label.partition("+")[0], level="method")[metric]
        .iloc[0]
    )


def read(tmp_path, name: str, text: str, metric: str = "") -> list[tuple[str, str, str, str]]:
    (tmp_path / name).write_text(text, encoding="utf-8")
    return [
        (one.method, one.scene, one.metric, one.text)
        for one in read_quoted(tmp_path / name, metric).cells
    ]


def test_a_latex_table_is_read(tmp_path):
    """Heads over several columns, rules, marks, per cent and comments; a column that is no metric
    is left out by name.
    """
    assert read(tmp_path, "paper.tex", TEX) == READ
    assert read_quoted(tmp_path / "paper.tex").left_out == {
        "Mean FPS": "names no metric of this tool"
    }


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("wide.csv", "scene,method,PSNR,SSIM\nfern,A,22.64,.774\nfern,B-2,21.0,\n"),
        ("semicolons.csv", "Scene;Method;PSNR (dB);SSIM\nfern;A;22,64;.774\n;B-2;21,0;-\n"),
        ("long.csv", "method,scene,metric,value\nA,fern,PSNR,22.64\nA,fern,SSIM,.774\nB-2,fern,PSNR,21.0\n"),  # noqa: E501
        (
            "page.md",
            "\n| scene | method | PSNR | SSIM |\n| - | - | -: | -: |\n| fern | **A** | `22.64` | "
            ".774 |\n| | B-2 | 21.0 | |\n",
        ),
    ],
)  # fmt: skip
def test_other_formats_give_the_same_cells(name, text, tmp_path):
    """Wide and long CSV, decimal commas, and the tables of a Markdown page."""
    assert read(tmp_path, name, text) == [
        ("A", "fern", "PSNR", "22.64"),
        ("A", "fern", "SSIM", ".774"),
        ("B-2", "fern", "PSNR", "21.0"),
    ]


def test_the_files_of_3dgs_are_tables(tmp_path):
    """results.json is read as it is, and per_view.json as the mean over its pictures; another file
    says what is wrong.
    """
    whole = '{"ours_30000": {"SSIM": 0.9383, "PSNR": 31.86, "speed": 3}}'
    assert read(tmp_path, "results.json", whole) == [
        ("ours_30000", "", "SSIM", "0.9383"),
        ("ours_30000", "", "PSNR", "31.86"),
    ]
    by_view = '{"room": {"ours": {"PSNR": {"00000.png": 30.0, "00001.png": 31.0}}}}'
    assert read(tmp_path, "per_view.json", by_view) == [("ours", "room", "PSNR", "30.5")]
    with pytest.raises(ResultsError, match="the table is not JSON"):
        read(tmp_path, "broken.json", "{")


def test_columns_can_be_scenes(tmp_path):
    """The field's per-scene table of one metric, which is named."""
    found = read(tmp_path, "scenes.csv", "Method,fern,flower,Avg.\nA,22.6,28.0,25.3\n", "psnr")
    assert found == [
        ("A", "fern", "PSNR", "22.6"),
        ("A", "flower", "PSNR", "28.0"),
        ("A", "", "PSNR", "25.3"),
    ]
    with pytest.raises(ResultsError, match=r"columns fern, flower, Avg.*--metric"):
        read_quoted(tmp_path / "scenes.csv")
    with pytest.raises(MetricError, match="wanted a metric of this tool, got 'psn'"):
        read_quoted(tmp_path / "scenes.csv", "psn")


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        (
            "paper.pdf",
            b"%PDF",
            r"wanted a table as \.csv, \.tsv, \.tex, \.md, \.json, got \.pdf; convert it",
        ),
        ("words.csv", b"method,PSNR\nA,good\n", "wanted numbers under heads such as PSNR"),
        ("empty.tex", b"", "wanted numbers under heads such as PSNR"),
        (
            "latin.csv",
            "méthode,PSNR\nA,30.1\n".encode("latin-1"),
            "wanted a table as text in UTF-8",
        ),
    ],
)
def test_what_is_no_table_is_one_line(name, content, message, tmp_path):
    """The wanted form, what came, and the file."""
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ResultsError, match=message):
        read_quoted(tmp_path / name)


@pytest.mark.slow
@pytest.mark.parametrize("to", ["latex", "markdown", "csv"])
def test_the_tools_own_table_is_reproduced(to, run, tmp_path):
    """Every cell, by the titles of its rows, in each format that `table` writes."""
    file = tmp_path / {"latex": "a.tex", "markdown": "a.md", "csv": "a.csv"}[to]
    file.write_text(tables_of_runs([run], METRICS, to), encoding="utf-8")

    found = check_cells(read_quoted(file).cells, Runs([read_scores(run)], {}))

    assert [(one.verdict, one.label) for one in found] == [
        ("reproduced", label) for label in LABELS for _ in METRICS
    ]
    expected, tail = expected_by_chance(found)
    assert expected < 2
    assert tail < 1e-3


@pytest.mark.slow
def test_each_planted_error_has_its_verdict(run):
    """A shifted number, one inside the interval, and what the runs do not have."""
    psnr = measured(run, "PSNR")
    (interval,) = [
        one for one in checked(run, quoted(f"{psnr + 0.01:.5f}")) if one.verdict == "undecided"
    ]

    found = checked(
        run,
        quoted(f"{psnr:.3f}"),
        quoted(f"{psnr + 5:.3f}"),
        quoted("30.00", method="somebody"),
        QuotedCell(LABELS[0], "elsewhere", "PSNR", "30.00", 0, 0),
        QuotedCell(LABELS[0], "", "LPIPS", "0.1", 0, 0),
    )

    assert [one.verdict for one in found] == ["reproduced", "not reproduced", *["not checked"] * 3]
    assert found[1].reason.startswith("off by +5")
    assert [one.reason.partition(";")[0] for one in found[2:]] == [
        f"no method 'somebody' in the runs ({', '.join(LABELS)})",
        "no run of the scene 'elsewhere'",
        "LPIPS was not measured",
    ]
    assert "within the interval" in interval.reason


@pytest.mark.slow
def test_a_number_of_another_convention_names_it(still):
    """SSIM of uniform windows, computed by scikit-image itself."""
    folder, view = RunFolder(still), "cam00"
    pairs = [
        [
            read_image(frame_path(place, at))
            for place in (folder.renders(LABELS[0], view), folder.truth(view))
        ]
        for at in (0, 1)
    ]
    uniform = np.mean(
        [structural_similarity(*pair, channel_axis=2, data_range=255) for pair in pairs]
    )

    (one,) = checked(still, quoted(f"{uniform:.6f}", "SSIM"))

    assert one.verdict == "other convention"
    assert "7" in one.reason
    assert one.by_chance < 0.01


@pytest.mark.slow
def test_a_chance_match_is_no_convention(run):
    """Without digits nearly every number fits some convention, so that the cell is not called
    explained.
    """
    (one,) = checked(run, quoted("26"))
    assert one.verdict == "not reproduced"
    assert "only a chance match" in one.reason
    assert one.by_chance > 0.25


@pytest.mark.slow
def test_equal_methods_are_not_distinguished(run):
    """The next worse number of a column is named where the paired test finds no difference."""
    cells = [quoted(f"{measured(run, 'PSNR'):.3f}"), quoted("99.0", method=LABELS[1], row=1)]
    assert [one.neighbour for one in checked(run, *cells)] == ["", ""]
    same = [cells[0], QuotedCell("twin", "", "PSNR", cells[0].text, 1, 0)]
    (one, other) = check_cells(same, Runs([read_scores(run)], {"twin": LABELS[0]}))
    assert one.neighbour == other.neighbour == ""  # a method has no difference to itself


class EqualRuns(Runs):
    """Runs that measured 1 everywhere and distinguish nothing."""

    def __init__(self):
        pass

    def label(self, method):
        return method

    def of_scene(self, scene):
        measurement = SimpleNamespace(lpips_net="vgg")
        return (SimpleNamespace(protocol=SimpleNamespace(sha256="", measurement=measurement)),)

    def value(self, metric, label, scene):
        return SimpleNamespace(value=1.0, low=None, high=None)

    def conventions(self, metric, label, scene):
        return {
            "VGG, inputs in [-1, 1]": 1.0,
            "AlexNet, inputs in [-1, 1]": 0.5,
            "AlexNet, inputs in [0, 1]": 0.4,
        }

    def outcome(self, metric, scene, label, other):
        return "equal"


def test_neighbours_are_of_one_metric_and_scene(tmp_path):
    """A long table has all numbers in one column, and the page a head for each metric and scene."""
    lines = [
        "A,fern,PSNR,30",
        "A,fern,SSIM,.9",
        "B,fern,PSNR,20",
        "B,fern,SSIM,.8",
        "B,room,PSNR,25",
        "C,room,PSNR,15",
    ]
    (tmp_path / "long.csv").write_text(
        "\n".join(["method,scene,metric,value", *lines]), encoding="utf-8"
    )

    found = check_cells(read_quoted(tmp_path / "long.csv").cells, EqualRuns())
    write_check(tmp_path, tmp_path / "long.csv", found, [])

    neighbours = {
        (one.label, one.quoted.scene, one.quoted.metric): one.neighbour
        for one in found
        if one.neighbour
    }
    assert neighbours == {
        ("A", "fern", "PSNR"): "not distinguished from B (equal)",
        ("A", "fern", "SSIM"): "not distinguished from B (equal)",
        ("B", "room", "PSNR"): "not distinguished from C (equal)",
    }
    page = (tmp_path / "index.html").read_text(encoding="utf-8")
    assert all(
        f'<th scope="col">{head}</th>' in page for head in ("fern PSNR", "fern SSIM", "room PSNR")
    )


@pytest.mark.parametrize(
    "head",
    [
        "SSIM (x100)",
        "SSIM x100",
        "100 x SSIM",
        "SSIM (x 10^2)",
        "SSIM (x10^-2)",
        "SSIM [1e-2]",
        "SSIM ×100",
        "SSIM (%)",
    ],
)
def test_the_scale_of_a_head_is_read(head, tmp_path):
    """In wide and long tables, whether it says what numbers were multiplied by or are to be; a
    cell's own per cent too.
    """
    assert read(tmp_path, "wide.csv", f"method,{head}\nA,77.4\n") == [("A", "", "SSIM", "0.774")]
    assert read(tmp_path, "long.csv", f"method,metric,value\nA,{head},77.4\n") == [
        ("A", "", "SSIM", "0.774")
    ]
    assert read(tmp_path, "cell.csv", "method,SSIM (100 x 100)\nA,77.4%\n") == [
        ("A", "", "SSIM", "0.774")
    ]


@pytest.mark.parametrize("head", ["LPIPS (Alex)", "LPIPS-AlexNet", "LPIPS_alex (x10)"])
@pytest.mark.parametrize(
    ("number", "verdict", "reason"),
    [
        (0.5, "other convention", "AlexNet, inputs in [-1, 1]"),
        (0.7, "not reproduced", "off by +0.2 under AlexNet, inputs in [-1, 1]"),
    ],
)
def test_the_network_of_a_head_is_read_first(head, number, verdict, reason, tmp_path):
    """A number is compared with the value that its head names, not with that of the protocol's
    network.
    """
    printed = 10 * number if "x10" in head else number
    (tmp_path / "a.csv").write_text(
        f"method,{head},LPIPS (VGG16)\nA,{printed},1.0\n", encoding="utf-8"
    )
    one, usual = check_cells(read_quoted(tmp_path / "a.csv").cells, EqualRuns())
    assert (one.verdict, one.reason.partition(";")[0]) == (verdict, reason)
    assert (usual.verdict, usual.reason) == ("reproduced", "")


def test_a_network_that_is_not_known_is_left_out(tmp_path):
    """No value of another one is taken for it."""
    (tmp_path / "a.csv").write_text("method,LPIPS (Squeeze),PSNR\nA,.1,30\n", encoding="utf-8")
    assert list(read_quoted(tmp_path / "a.csv").left_out) == ["LPIPS (Squeeze)"]


@pytest.mark.slow
def test_the_command_writes_page_table_and_badge(run, tmp_path, capsys):
    """It ends with 1 where a cell is not reproduced, and equal inputs give equal bytes."""
    psnr = measured(run, "PSNR")
    (tmp_path / "paper.csv").write_text(
        f"method,PSNR,FPS\nMine,{psnr:.2f},3\nNo Blending,{psnr + 5:.2f},3\n", encoding="utf-8"
    )
    words = [
        "--table",
        str(tmp_path / "paper.csv"),
        str(run),
        "--rows",
        f"Mine={LABELS[0]}",
        "--out",
    ]

    for out in ("a", "b"):
        with pytest.raises(SystemExit) as ended:
            run_command(["check-table", *words, str(tmp_path / out)])
        assert ended.value.code == 1

    printed = capsys.readouterr()
    assert "2 cells: 1 reproduced, 1 not reproduced; chance alone would match 0." in printed.out
    assert "column FPS: names no metric of this tool, not checked" in printed.err
    names = sorted(file.name for file in (tmp_path / "a").iterdir())
    assert names == ["badge.svg", "index.html", "table_check.csv"]
    assert [(tmp_path / "a" / name).read_bytes() for name in names] == [
        (tmp_path / "b" / name).read_bytes() for name in names
    ]
    assert "1 of 2 reproduced" in (tmp_path / "a" / "badge.svg").read_text(encoding="utf-8")
    with (tmp_path / "a" / "table_check.csv").open(encoding="utf-8") as file:
        assert [row["verdict"] for row in csv.DictReader(file)] == ["reproduced", "not reproduced"]


@pytest.mark.slow
def test_names_are_escaped(run, tmp_path):
    """A row's name is text on the page, whatever it holds."""
    found = checked(run, quoted("30.00", method="<script>alert(1)</script>"))
    write_check(tmp_path, tmp_path / "paper.csv", found, [read_scores(run)])
    assert "<script>" not in (tmp_path / "index.html").read_text(encoding="utf-8")
    assert check_csv(found).count("\n") == 2
    assert check_text(found).startswith(summary(found))


@pytest.mark.slow
def test_an_unknown_label_is_one_line(run):
    """With the nearest one that the runs have."""
    with pytest.raises(
        ResultsError,
        match=r"A=no-blendin: wanted a method of the runs, got 'no-blendin'; did you mean",
    ):
        Runs([read_scores(run)], {"A": "no-blendin"})
    assert Runs([read_scores(run)], {}).label(NAMES[LABELS[1]].upper()) == LABELS[1]
