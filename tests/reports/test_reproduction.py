"""The paper's values beside ours: each has a standing and a reason, and none is claimed that was
not measured on its terms.
"""

import csv
import io
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.files.images import write_image
from ggvs_eval.merged_results import merge_results
from ggvs_eval.metrics.registry import METRICS, metric_notes
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.protocol import Frames, Measurement, Synthesis, load_protocol
from ggvs_eval.reports.model.measured import MeasuredRun, MetricNote, read_scores
from ggvs_eval.reports.model.table import Cell, Table
from ggvs_eval.reports.page.page import template_environment
from ggvs_eval.reports.tables.published import published_values
from ggvs_eval.reports.tables.report_tables import main_tables
from ggvs_eval.reports.tables.reproduction import (
    STATUSES,
    Reproduction,
    blocks,
    evaluate_value,
    paper_methods,
    reproduce,
    reproduction_csv,
    reproduction_markdown,
)
from ggvs_eval.reports.tables.table_formats import to_latex, to_markdown
from ggvs_eval.results import Results, make_table
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, write_json
from ggvs_eval.statistics.pooling import MEAN
from helpers.run_folders import RunShape, write_run

ANY_FRAME = np.zeros((1014, 1352, 3), np.uint8)
PSNR_DB = {"ours": 31.2, "distance-based": 29.0, "fwd": 17.3}


def write_scored_run(
    root: Path, scene: str, protocol: str = "dynerf", **capture: object
) -> MeasuredRun:
    """A run under a packaged protocol, scored in PSNR alone, without the frames that nobody looks
    at here.
    """
    folder, terms = RunFolder(root), load_protocol(protocol)
    terms = replace(terms, measurement=replace(terms.measurement, metrics=("PSNR", "LPIPS")))
    views, frames = terms.views.test, range(terms.frames.count)
    record = {"scene": scene, "layout": "dynerf", "units_origin": "chosen by us", **capture}
    write_json(folder.root / "capture.json", record)
    folder.protocol_file.write_text(terms.to_toml(), encoding="utf-8")
    write_image(frame_path(folder.truth(views[0]), 0), ANY_FRAME)
    for label in PSNR_DB:
        stages = {
            "splat": [0.1] * len(frames),
            "tsdf": [0.06] * len(frames),
            "blend": [0.4] * len(frames),
        }
        write_json(folder.renders(label, views[0]) / JOB_FILE, {"seconds": stages, "threads": 2})
    random = np.random.default_rng(0)
    noise = random.standard_normal((len(views), 1)) + random.standard_normal(
        (len(views), len(frames))
    )
    rows = [
        (terms.dataset, scene, label, "", view, frame, "PSNR", value + 0.3 * noise[at, frame])
        for label, value in PSNR_DB.items()
        for at, view in enumerate(views)
        for frame in frames
    ]
    provenance = {"protocol_sha256": terms.sha256, "inputs": {}, "pooling": {"PSNR": MEAN.record()}}
    results = Results(make_table(rows), provenance, {"LPIPS": "weights of VGG absent"})
    notes = {
        name: MetricNote(name, **note) for name, note in metric_notes(("PSNR", "LPIPS")).items()
    }
    names = {label: METHODS[label].title for label in PSNR_DB}
    return MeasuredRun(folder, terms, results, tuple(PSNR_DB), names, frozenset({"ours"}), notes)


@pytest.fixture(scope="module")
def on_dynerf(tmp_path_factory) -> list[MeasuredRun]:
    """Both scenes of DyNeRF on the paper's terms."""
    root = tmp_path_factory.mktemp("dynerf")
    return [write_scored_run(root / scene, scene) for scene in ("sear_steak", "flame_steak")]


def find(
    entries: tuple[Reproduction, ...], table: str, dataset: str, method: str, metric: str
) -> Reproduction:
    """The one value of that name."""
    key = (table, dataset, method, metric)
    (found,) = [
        entry
        for entry in entries
        if (entry.table, entry.dataset, entry.method, entry.metric) == key
    ]
    return found


def test_every_published_value_has_a_standing_and_a_reason(on_dynerf):
    """Nothing that the paper prints is left out, no field is blank, and a number is shown where one
    was measured, else none.
    """
    entries = reproduce(on_dynerf)
    printed = [
        (value.table, value.scene, value.method, value.value)
        for value in published_values()
        if value.table
    ]
    assert [(entry.table, entry.dataset, entry.method, entry.paper) for entry in entries] == printed
    for entry in entries:
        assert entry.status in STATUSES
        assert entry.reason.strip()
        assert entry.ours.text.strip()
        assert (entry.ours.value is not None) == (entry.status in ("reproduced", "differs"))


def test_values_on_the_papers_terms_are_judged(on_dynerf):
    """On both scenes of DyNeRF the network's PSNR of 31.2 +- little is the paper's 31.17, and 29.0
    +- little is not its 26.08.
    """
    entries = reproduce(on_dynerf)
    ours = find(entries, "quality", "DyNeRF", "Ours", "PSNR")
    assert ours.status == "reproduced"
    assert ours.ours.value == pytest.approx(
        np.mean([run.results.summary()["PSNR"].max() for run in on_dynerf])
    )
    assert ours.reason.startswith("the paper's value is in this run's 95 % interval")
    assert ours.reason.endswith("on sear_steak, flame_steak")
    distance = find(entries, "ablation", "DyNeRF", "Distance-based Blending", "PSNR")
    assert distance.status == "differs"
    assert re.match(r"better by 2\.9\d dB; 95 % interval 2\d\.\d\d to 2\d\.\d\d", distance.reason)
    foreign = find(entries, "quality", "DyNeRF", "FWD", "PSNR")
    assert foreign.ours.value == pytest.approx(17.3, abs=1)
    assert foreign.reason.endswith(
        "on sear_steak, flame_steak; measured with FWD (retrained, compact)"
    )
    assert "retrained" not in ours.reason + distance.reason


def test_what_keeps_a_value_from_being_measured_is_named(on_dynerf):
    """Foreign weights, a method that was not rendered, a metric without a value, a data set without
    a run: each says its own.
    """
    entries = reproduce(on_dynerf)
    told = {
        ("quality", "DyNeRF", "IBRNet", "PSNR"): ("weights absent", "--weights ibrnet=FILE"),
        ("ablation", "DyNeRF", "No Blending", "PSNR"): ("not run", "--methods no-blending"),
        ("quality", "DyNeRF", "Ours", "LPIPS"): ("not run", "weights of VGG absent"),
        ("quality", "DyNeRF", "Ours", "SSIM"): ("not run", "SSIM is not in the protocol"),
        ("quality", "D3DMV", "Ours", "PSNR"): ("data absent", "no run on D3DMV here"),
        ("quality", "D3DMV", "ENeRF", "PSNR"): (
            "data absent",
            "weights of ENeRF are not included either",
        ),
    }
    for key, (status, reason) in told.items():
        entry = find(entries, *key)
        assert entry.status == status
        assert reason in entry.why


def test_times_stand_beside_the_papers_and_are_never_called_reproduced(on_dynerf):
    """100 ms of splatting are ten times the paper's 10; a stage that does not exist here
    says so.
    """
    entries = reproduce(on_dynerf)
    splat = find(entries, "timing", "DyNeRF", "Ours", "forward splatting")
    assert (splat.ours.text, splat.status, splat.unit) == ("100.0", "differs", "ms")
    assert splat.reason.startswith("10 times the paper's")
    assert find(entries, "timing", "DyNeRF", "Ours", "blending, TensorRT").status == "not run"
    assert (
        find(entries, "timing", "DyNeRF", "GPSG", "total (as its text says)").status
        == "weights absent"
    )


def test_one_scene_of_two_is_not_the_data_set(on_dynerf):
    """With flame_steak alone nothing on DyNeRF is reproduced; its value is told as one that does
    not compare.
    """
    entry = find(reproduce(on_dynerf[1:]), "quality", "DyNeRF", "Ours", "PSNR")
    assert (entry.status, entry.ours.text) == ("data absent", "not measured")
    assert "the paper's means also include sear_steak; Ours has 31." in entry.why


def test_a_single_frame_is_not_the_papers_protocol(tmp_path):
    """The real instant has DyNeRF in its name and nothing of it is counted: frames and size are
    named as the reason.
    """
    run = write_scored_run(tmp_path / "run", "flame_steak", "real_frame", layout="colmap")
    entries = reproduce([run])
    assert {entry.status for entry in entries} == {"data absent"}
    reason = find(entries, "quality", "DyNeRF", "Ours", "PSNR").reason
    assert "1 frame, not 100" in reason
    assert "1345 × 1008 pixels, not 1352 × 1014" in reason
    assert "(not comparable)" in find(entries, "quality", "DyNeRF", "Ours", "PSNR").remark


@pytest.mark.parametrize("dataset", ["Demo room", "DyNeRF"])
def test_the_demo_is_none_of_the_papers_data_sets(tmp_path, dataset):
    """A demo capture reproduces nothing, in whatever layout it was written and whatever its
    protocol calls it.
    """
    run = write_scored_run(tmp_path / "run", "sear_steak", units_origin="demo.json")
    run = replace(run, protocol=replace(run.protocol, dataset=dataset))
    entries = reproduce([run])
    assert {entry.status for entry in entries} == {"data absent"}
    assert all("none of the paper's data sets" in entry.reason for entry in entries)
    assert all("a demo capture" in entry.reason for entry in entries)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"frames": Frames(0, 50)}, "50 frames, not 100"),
        ({"synthesis": Synthesis(6, 1352, 1014)}, "K = 6, not 4"),
        (
            {"measurement": Measurement(("PSNR",), width=676, height=507)},
            "measured at 676 × 507, not 1352 × 1014",
        ),
    ],
)
def test_departures_from_the_terms_are_named(on_dynerf, changed, words):
    """A run of the paper's data on other terms counts as none, and says where it departs."""
    runs = [replace(run, protocol=replace(run.protocol, **changed)) for run in on_dynerf]
    entry = find(reproduce(runs), "quality", "DyNeRF", "Ours", "PSNR")
    assert entry.status == "data absent"
    assert words in entry.reason


@pytest.mark.parametrize(
    ("paper", "cell", "metric", "status", "reason"),
    [
        ("31.17", Cell("31.17", 31.1749), "PSNR", "reproduced", "the same to the printed digits"),
        (
            "31.17",
            Cell("31.40", 31.4, low=31.1, high=31.7, note="given this scene"),
            "PSNR",
            "reproduced",
            "given this scene",
        ),
        (
            "31.17",
            Cell("31.40", 31.4, low=31.3, high=31.5),
            "PSNR",
            "differs",
            "better by 0.23 dB; 95 % interval 31.30 to 31.50",
        ),
        (
            "31.17",
            Cell("30.00", 30.0, note="1 frame; an interval needs 2"),
            "PSNR",
            "differs",
            "no interval (1 frame",
        ),
        ("0.191", Cell("0.250", 0.25, low=0.24, high=0.26), "LPIPS", "differs", "worse by 0.059;"),
        ("2796", Cell("2796", 2796.4), "STED", "reproduced", "the same to the printed digits"),
        (
            "0.191",
            Cell("0.192", 0.192, low=0.1913, high=0.1927),
            "LPIPS",
            "reproduced",
            "is in this run's",
        ),
    ],
)
def test_a_value_is_reproduced_by_interval_or_digits(paper, cell, metric, status, reason):
    """A published value stands for all that round to it; outside our interval it differs, and the
    reason says by how much.
    """
    found, words = evaluate_value(paper, cell, metric, METRICS[metric].decimals)
    assert found == status
    assert reason in words


def test_the_papers_methods_are_ours_by_label_and_weights():
    """A method of the paper asks for the weights that its label asks for, or for none where ours
    ship; some are to come.
    """
    assert set(paper_methods()) == {value.method for value in published_values() if value.table}
    for method in paper_methods().values():
        if method.label in METHODS:
            spec = METHODS[method.label]
            asked, _, _ = spec.checkpoint.partition(",")
            assert method.weights == asked or (
                not method.weights and all(file.is_file() for file in spec.weights)
            )
        else:
            assert method.label.startswith("ours+")


def test_frames_of_others_count_by_the_methods_name(on_dynerf):
    """Frames that somebody else rendered with ENeRF and imported as `ENeRF` are held against the
    paper's ENeRF.
    """
    runs = []
    for run in on_dynerf:
        table = run.results.table[run.results.table["method"] == "distance-based"].assign(
            method="ENeRF"
        )
        runs.append(replace(run, labels=("ENeRF",), results=replace(run.results, table=table)))
    entry = find(reproduce(runs), "quality", "DyNeRF", "ENeRF", "PSNR")
    assert entry.status == "differs"
    assert entry.ours.value == pytest.approx(29.0, abs=0.1)


def test_formats_hold_every_value(on_dynerf):
    """The CSV has a line per value, Markdown one per measured value and reason; only numbers that
    do not exist are blank.
    """
    entries = reproduce(on_dynerf)
    lines = list(csv.DictReader(io.StringIO(reproduction_csv(entries))))
    assert [(line["paper"], line["status"]) for line in lines] == [
        (entry.paper, entry.status) for entry in entries
    ]
    for line, entry in zip(lines, entries, strict=True):
        assert line["reason"]
        assert (line["ours"] == "") == (entry.ours.value is None)
    differs = next(line for line in lines if line["status"] == "differs")
    assert float(differs["difference"]) == float(differs["ours"]) - float(differs["paper"])
    rows = [
        line
        for line in reproduction_markdown(entries).splitlines()
        if line.startswith("| ") and "| Paper |" not in line
    ]
    measured = [entry for entry in entries if entry.ours.value is not None]
    reasons = {
        (entry.table, entry.dataset, entry.status, entry.reason)
        for entry in entries
        if entry.ours.value is None
    }
    assert len(rows) == len(measured) + len(reasons)
    assert not any(re.search(r"\|\s*\|", row) for row in rows)


def test_values_that_lack_the_same_are_one_line(on_dynerf):
    """A table of the paper without a run is one line that counts its values; a measured value has a
    line of its own.
    """
    entries = reproduce(on_dynerf)
    by_title = {block.title: block for block in blocks(entries)}
    (absent,) = by_title["Quality on D3DMV"].lines
    values = sum((value.table, value.scene) == ("quality", "D3DMV") for value in published_values())
    assert (absent.method, absent.paper, absent.status) == (
        "5 methods",
        f"{values} values",
        "data absent",
    )
    lines = by_title["Quality on DyNeRF"].lines
    (ours,) = [line for line in lines if line.method == "Ours" and line.metric == "PSNR (dB)"]
    assert (ours.paper, ours.status) == ("31.17", "reproduced")
    (weights,) = [line for line in lines if line.method == "IBRNet"]
    assert (weights.metric, weights.status) == ("PSNR, SSIM, LPIPS, L1", "weights absent")
    counts = [
        int(line.paper.removesuffix(" values")) if line.paper.endswith(" values") else 1
        for line in lines
    ]
    assert sum(counts) == len(by_title["Quality on DyNeRF"].entries)


def quality_table(runs: list[MeasuredRun]) -> Table:
    return main_tables(runs, merge_results([run.results for run in runs]))[0]


def test_the_papers_rows_stand_beside_runs_on_its_terms(on_dynerf):
    """Both scenes of DyNeRF as the paper measured them have its rows in grey, in every format."""
    table = quality_table(on_dynerf)
    assert [row.name for row in table.rows if row.kind == "published"][-1] == "Ours (paper)"
    assert "| *Ours (paper)* | *31.17* | *0.191* |" in to_markdown([table])
    assert (
        r"\textcolor{gray}{Ours (paper)} & \textcolor{gray}{31.17} & \textcolor{gray}{0.191}"
        in to_latex([table])
    )
    macros = template_environment().from_string(
        '{% import "macros.html.j2" as macros %}{{ macros.table(table) }}'
    )
    assert '<tr class="published grey"' in macros.render(table=table)


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"synthesis": Synthesis(2, 1352, 1014)}, "K = 2, not 4"),
        ({"frames": Frames(0, 6)}, "6 frames, not 100"),
        ({"measurement": Measurement(("PSNR",), width=676, height=507)}, "measured at 676 × 507"),
    ],
)
def test_the_papers_rows_stand_beside_no_run_on_other_terms(on_dynerf, changed, words):
    """A run that calls its data set DyNeRF and departs from the paper's terms has none of its rows;
    the caption says why.
    """
    table = quality_table(
        [replace(run, protocol=replace(run.protocol, **changed)) for run in on_dynerf]
    )
    assert not [row for row in table.rows if row.kind == "published"]
    assert "The paper's values are not shown here: " in " ".join(table.notes)
    assert words in " ".join(table.notes)


def test_the_papers_rows_stand_beside_its_scenes_alone(on_dynerf):
    """Neither a mean over one of the paper's two scenes nor one over a third is beside the paper's
    mean.
    """
    for runs, words in (
        (on_dynerf[:1], "flame_steak"),
        ([*on_dynerf, on_dynerf[0].called("cook_spinach")], "cook_spinach"),
    ):
        table = quality_table(runs)
        assert not [row for row in table.rows if row.kind == "published"]
        assert words in " ".join(table.notes).split("The paper's values are not shown here: ")[1]


def test_a_demo_called_dynerf_has_none_of_the_papers_rows(tmp_path):
    """Nor has a folder of numbers alone, which does not say what was captured."""
    shape = RunShape(dataset="DyNeRF", metrics=("PSNR", "TCC"), poses=0)
    root = write_run(tmp_path / "run", shape)
    record = RunFolder(root).capture_record()
    write_json(root / "capture.json", record | {"units_origin": "demo.json"})
    for _ in ("demo", "numbers alone"):
        run = read_scores(root)
        for table in main_tables([run], run.results):
            assert all(row.kind != "published" for row in table.rows)
            assert "The paper's values are not shown here: " in " ".join(table.notes)
        (root / "capture.json").unlink(missing_ok=True)
