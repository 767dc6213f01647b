"""`make results`: every table of the pages has a measurement, carries the code it came from, and is
remade when that changes.
"""

import dataclasses
import re
import subprocess
import sys

import pytest

from ggvs_eval.synthetic.shipped import write_room
from ggvs_eval.tasks.identity import rooms_of
from helpers.places import ROOT

pytestmark = [
    pytest.mark.skipif(
        not (ROOT / "docs").is_dir(), reason="an installed wheel has no pages; a checkout has"
    ),
]

if (ROOT / "tools").is_dir():
    sys.path.insert(0, str(ROOT / "tools" / "docs"))
    import figure_tables
    import fill_tables
    import make_results
    import result_plan
    import result_tables
    from result_plan import Measurement


@pytest.fixture
def bench(tmp_path, monkeypatch):
    """A measurement that writes a number to a file, its page with a table, and its source, all in a
    folder of their own.
    """
    (tmp_path / "source.py").write_text("from ggvs_eval.metrics.image.psnr import psnr\n")
    page = tmp_path / "page.md"
    page.write_text("before\n<!-- numbers -->\nold\n<!-- /numbers -->\nafter\n")
    for module in (result_plan, fill_tables, make_results):
        monkeypatch.setattr(module, "ROOT", tmp_path)
    for module in (result_plan, make_results):
        monkeypatch.setattr(module, "RECORDS", tmp_path / "records")

    def measurement():
        result_plan._of_source.cache_clear()
        made = Measurement(
            "numbers",
            ("sh -c 'echo {data} >> calls; date +%N > number'",),
            1,
            sources=("source.py",),
        )
        monkeypatch.setattr(fill_tables, "MEASUREMENTS", {"numbers": made})
        monkeypatch.setattr(make_results, "MEASUREMENTS", {"numbers": made})
        return made

    table = fill_tables.Table(
        page, "numbers", "numbers", lambda: (tmp_path / "number").read_text().strip()
    )
    monkeypatch.setattr(fill_tables, "TABLES", (table,))
    monkeypatch.setattr(fill_tables, "_draw_metric_study", lambda: None)
    return tmp_path, page, measurement


def run(monkeypatch, *arguments):
    """`make results` with options."""
    monkeypatch.setattr(sys, "argv", ["make_results.py", "--data", "DATA", *arguments])
    return make_results.main()


def test_what_is_stale_is_measured_once_and_written(bench, monkeypatch, capsys):
    """A table is made, carries its code, and is made again only when that code has changed; the
    check names it until then.
    """
    folder, page, measurement = bench
    made = measurement()
    assert [table.name for table in fill_tables.older_tables()] == ["numbers"]
    assert run(monkeypatch) == 0
    once = page.read_text()
    assert f"<!-- /numbers: {made.identity[:12]} -->\nafter" in once
    assert "old" not in once
    assert fill_tables.older_tables() == []
    assert run(monkeypatch) == 0
    assert (folder / "calls").read_text() == "DATA\n"

    (folder / "source.py").write_text("from ggvs_eval.metrics.image.psnr import psnr as measure\n")
    again = measurement()
    assert again.identity != made.identity
    monkeypatch.setattr(sys, "argv", ["fill_tables.py", "--check"])
    fill_tables.main()
    told = capsys.readouterr().out.splitlines()[-1]
    for part in (
        "page.md",
        "numbers",
        made.identity[:12],
        again.identity[:12],
        "make results ONLY=numbers",
    ):
        assert part in told
    assert run(monkeypatch) == 0
    assert (folder / "calls").read_text() == "DATA\n" * 2
    assert page.read_text() != once


def test_a_plan_writes_nothing(bench, monkeypatch, capsys):
    """The plan says name, minutes, state and tables, and leaves page and folder as they are, as do
    numbers of unknown code.
    """
    folder, page, measurement = bench
    measurement()
    before = page.read_text()
    assert run(monkeypatch, "--plan") == 0
    line = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("numbers"))
    assert [word for word in ("1", "never made", "page.md#numbers") if word in line] == [
        "1",
        "never made",
        "page.md#numbers",
    ]
    assert page.read_text() == before
    assert not (folder / "records").exists()
    (folder / "number").write_text("42\n")  # of any code, as it has no record
    fill_tables.fill()
    assert page.read_text() == before


def test_what_fails_is_named_and_leaves_its_table(bench, monkeypatch, capsys):
    """A command that fails ends with 1, is in the log of progress, and neither its table nor its
    record is touched.
    """
    folder, page, measurement = bench
    measurement()
    broken = Measurement("numbers", ("sh -c 'echo half; exit 3'",), 1, sources=("source.py",))
    monkeypatch.setattr(make_results, "MEASUREMENTS", {"numbers": broken})
    monkeypatch.setattr(fill_tables, "MEASUREMENTS", {"numbers": broken})
    before = page.read_text()
    assert run(monkeypatch) == 1
    assert "numbers" in capsys.readouterr().err
    assert page.read_text() == before
    assert not broken.record.exists()
    assert "failed with 3" in (folder / "records" / "progress.log").read_text()


@pytest.mark.slow
def test_every_table_of_the_pages_is_made_by_a_measurement():
    """Markers and tables are the same set, each table's measurement is one of the plan's, and each
    of these has an identity.
    """
    pages = [ROOT / "README.md", *(ROOT / "docs").glob("*.md"), ROOT / "benchmarks" / "RESULTS.md"]
    marked = {
        (page, name)
        for page in pages
        for name in re.findall(r"^<!-- (\w+) -->$", page.read_text("utf-8"), re.MULTILINE)
    }
    made = {(table.page, table.name) for table in fill_tables.TABLES}
    assert marked - {(ROOT / "docs" / "protocol.md", "keys")} == made
    for table in fill_tables.TABLES:
        assert (
            table.measurement == fill_tables.CARDS or table.measurement in result_plan.MEASUREMENTS
        )
        assert re.fullmatch(r"\w*", table.identity)
    assert len({each.identity for each in result_plan.MEASUREMENTS.values()}) == len(
        result_plan.MEASUREMENTS
    )


def test_what_the_cards_say_is_on_the_pages():
    """How long networks learned and how well is on every page in the words and figures of the
    cards, and the marker says so.
    """
    told = [table for table in fill_tables.TABLES if table.measurement == fill_tables.CARDS]
    assert sorted(table.name for table in told) == ["learned", "learned", "learned_table"]
    for table in told:
        assert table.place.search(table.page.read_text("utf-8"))[2].strip() == table.make()
        assert table.identity == fill_tables.CARDS
    sentence = figure_tables.learned_sentence()
    assert "unknown" not in sentence
    card = (ROOT / "pipelines" / "weights" / "enerf.md").read_text("utf-8")
    minutes = re.search(r"Minutes of one core in all: (\d+)$", card, re.MULTILINE)[1]
    assert f"ENeRF {minutes} on" in sentence
    pixels = re.search(r"^- Pixels of target views: (\d+) million", card, re.MULTILINE)[1]
    ours = figure_tables._table_of_card("blend", figure_tables.AS_MANY_PIXELS)
    with_as_many = next(row["psnr_db"] for row in ours if row["million pixels"] == float(pixels))
    row = next(
        row
        for row in figure_tables.learned_table().splitlines()
        if row.startswith("| ENeRF (retrained, compact) |")
    )
    assert row.split(" | ")[1] == pixels
    assert row.endswith(f" | {with_as_many:.2f} |")


def test_the_readme_shows_the_run_that_the_other_pages_show():
    """Its means are those of docs/results.md, and its row of one view is that of the table of
    views.
    """

    def rows(page, name):
        table = next(
            table for table in fill_tables.TABLES if (table.page, table.name) == (page, name)
        )
        head, _, *lines = [
            line.strip("| ").split(" | ")
            for line in table.place.search(page.read_text("utf-8"))[2].splitlines()
            if line
        ]
        return {line[0]: dict(zip(head, line, strict=True)) for line in lines}

    shown = rows(fill_tables.README, "real_frame")
    means, views = (
        rows(fill_tables.RESULTS, "real_frame"),
        rows(fill_tables.BENCH, "real_frame_views"),
    )
    in_one_view = shown.pop("GGVS (online), cam00")
    assert in_one_view["PSNR"] == views["GGVS (online)"]["cam00"]
    assert len(shown) == len(result_tables.FRONT_METHODS)
    for name, row in shown.items():
        assert row["PSNR"] == means[name]["PSNR"].partition(" ")[0]


@pytest.mark.slow
def test_the_demo_of_the_plan_is_that_of_the_main_job(tmp_path):
    """Where `make reports` has been, what measures on its capture finds it and goes on."""
    films = {
        command
        for measurement in result_plan.MEASUREMENTS.values()
        for command in measurement.commands
        if command.startswith(f"ggvs-eval demo {result_plan.DEMO_CAPTURE}")
    }
    assert films
    write_room(tmp_path / result_plan.DEMO_CAPTURE)
    for film in films:
        subprocess.run(
            [sys.executable, "-m", "ggvs_eval", *film.split()[1:]], cwd=tmp_path, check=True
        )


INTERVALS = {"statistics.intervals", "statistics.autocorrelation"}
SGBM = {
    "pipelines.offline.stereo.sgbm",
    "pipelines.offline.depth.consistency",
    "pipelines.offline.stereo.fusion",
}
FILM = {f"contrib.worlds.{name}" for name in ("demo", "film.film", "room.room", "film.options")}
# Measurement -> modules whose change makes its tables older than the code.
MUST_COUNT = {
    "rooms_ablations": INTERVALS | SGBM | FILM,
    "real_frame_folds": {"results"} | SGBM,
    "offline": {"reports.tables.costs", "synthetic.shipped"} | INTERVALS | SGBM,
    "stream_real": {"metrics.time.on_screen", "pipelines.run.screens"} | SGBM,
    "real_frame": {"reports.tables.error_budget"} | SGBM,
    "rooms_k": {"reports.figures.sweep_figures"} | SGBM | FILM,
    "real_path": {"reports.tables.report_tables"} | INTERVALS | SGBM,
    "real_video": INTERVALS | SGBM,
    "real_video_itermvs": {
        "pipelines.offline.itermvs.network",
        "pipelines.offline.itermvs.estimator",
    }
    | SGBM,
}


@pytest.mark.slow
def test_an_identity_holds_all_that_makes_its_numbers():
    """Statistics, tables, the command's own matcher and the film count; of matchers and tables that
    a command has not, none.
    """
    plan = result_plan.MEASUREMENTS
    counted = {
        name: {room for module in plan[name].modules for room in rooms_of(module)}
        for name in MUST_COUNT
    }
    for name, modules in MUST_COUNT.items():
        lacking = {rooms_of(f"ggvs_eval.{module}")[-1] for module in modules}.difference(
            counted[name]
        )
        assert not lacking, f"{name} does not count {lacking}"
    assert "ggvs_eval.pipelines.offline.stereo.sgbm" not in plan["long_room"].modules
    assert not any("itermvs" in room for room in counted["real_video"])
    assert not any("worlds.film" in room for room in counted["real_path"])


@pytest.mark.slow
def test_a_change_of_a_table_makes_it_older(monkeypatch):
    """Another function, or another of its constants, makes the tables of its measurements older
    than the code, and no others.
    """

    def identities() -> dict[str, str]:
        return {
            name: dataclasses.replace(measurement).identity
            for name, measurement in result_plan.MEASUREMENTS.items()
        }

    before = identities()
    monkeypatch.setattr(result_tables, "USUAL_VIEW", "cam05")
    after = identities()
    assert {name for name in before if before[name] != after[name]} == {"real_frame"}


def test_the_bytes_of_foreign_weights_count():
    """A checkpoint that does not ship is known by its digest; every one that a command names has
    one.
    """
    named = {
        file
        for each in result_plan.MEASUREMENTS.values()
        for line in each.commands
        for file in re.findall(r"{weights}/(\S+)", line)
    }
    assert named == set(result_plan.CHECKPOINTS)
    assert all(re.fullmatch("[0-9a-f]{64}", digest) for digest in result_plan.CHECKPOINTS.values())
