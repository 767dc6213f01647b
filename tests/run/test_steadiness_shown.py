"""Steadiness without truth wherever it is shown: run tables, page, CSV and LaTeX, and the verb for
videos without a run.
"""

import csv
import io
import re
from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.files.images import write_image
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.pipelines.run.score_path import path_tasks, read_paths
from ggvs_eval.pipelines.run.steadiness import measure_steadiness
from ggvs_eval.protocol import Measurement
from ggvs_eval.reports.figures.curves import curve_panels
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.page.heat_map import heat_maps
from ggvs_eval.reports.tables.report_tables import main_tables, view_tables
from ggvs_eval.reports.tables.table_formats import to_csv, to_latex, to_markdown
from ggvs_eval.run_folder import frame_path, write_json
from ggvs_eval.tasks.run_tasks import run_tasks
from helpers.command_line import refusal
from helpers.render_folders import FRAMES, VIEWS, make_run, rendered, write_folders


def test_sharpness_stands_beside_what_blur_would_win(tmp_path):
    """The protocol asks for mTV alone: its sharpness is the next column of the table in every
    format, and has its curves.
    """
    folder = make_run(tmp_path / "run", ("PSNR", "mTV"))
    for name in ("one", "other"):
        import_renders(folder, name, write_folders(tmp_path / name))
    score(folder)
    run = read_run(folder.root)
    table = next(table for table in main_tables([run], run.results) if table.key == "no_reference")
    lines = list(csv.DictReader(io.StringIO(to_csv([(run.protocol, [table])]))))

    assert [column.name for column in table.columns] == ["mTV", "Sharpness"]
    assert all(cell.value is not None for row in table.rows for cell in row.cells)
    assert [line["column"] for line in lines] == ["mTV", "Sharpness"] * 2
    for text in (to_latex([table]), to_markdown([table])):
        assert re.search(r"mTV [^\n]*(&|\|) Sharpness ", text)
    assert (
        {panel.metric for panel in curve_panels(run)}
        == {heat.metric for heat in heat_maps(run)}
        == {"PSNR", "mTV", "Sharpness"}
    )
    assert {"view-mTV", "view-Sharpness"} <= {table.key for table in view_tables(run)}


def test_colmap_is_run_along_a_path_where_the_protocol_names_it(tmp_path):
    """Its metrics get values beside the path's others, and another protocol's path is not stale by
    them.
    """
    folder = make_run(tmp_path / "run", ("PSNR", "E_warp", "COLMAP_matches"))
    cameras = [
        Camera(f"path{pose}", np.diag([50.0, 50.0, 1.0]), np.eye(4), 64, 48, near=1.0, far=9.0)
        for pose in range(5)
    ]
    write_json(
        folder.path_record,
        {"cameras": [camera.to_json() for camera in cameras], "sources": [()] * 5},
    )
    for pose in range(5):
        write_image(frame_path(folder.path("one"), pose), rendered(VIEWS[0], 2 + pose % 3))
    protocol = folder.protocol()
    (task,) = path_tasks(folder, protocol, ["one"])
    run_tasks([task], 1, "path")
    record = read_paths([task])["one"]
    (other,) = path_tasks(folder, replace(protocol, measurement=Measurement(("E_warp",))), ["one"])

    assert {"COLMAP_registered", "COLMAP_matches", "path_sharpness"} <= {
        name for name, _, _ in record["values"]
    }
    assert "no depth" in record["not_computed"]["E_warp"]
    assert task.inputs["code"] != other.inputs["code"]


def write_video(folder, frames):
    for index, frame in enumerate(frames):
        write_image(folder / f"{index}.png", frame)
    return folder


def test_a_folder_of_views_is_measured_as_score_takes_it(tmp_path):
    """Each view has a row, and their mean one more; the mean is that of the views."""
    for view, step in (("cam00", 1), ("cam01", 2)):
        write_video(
            tmp_path / "renders" / view, [rendered(VIEWS[0], frame) for frame in FRAMES[::step]]
        )
    values = measure_steadiness({"mine": tmp_path / "renders"}).values
    assert list(values) == ["mine cam00", "mine cam01", "mine, mean of 2 views"]
    first, second, mean = (row["mTV"] for row in values.values())
    assert mean == pytest.approx((first + second) / 2)
    assert first != second


def test_videos_are_measured_without_a_run(tmp_path, capsys):
    """Two folders become two rows, steadiness and sharpness side by side, also in a file; sizes
    that differ are told.
    """
    frames = [rendered(VIEWS[0], frame) for frame in FRAMES]
    ours, still = (
        write_video(tmp_path / "ours", frames),
        write_video(tmp_path / "still", frames[:1] * 4),
    )

    run_command(
        ["steadiness", f"ours={ours}", f"still={still}", "--out", str(tmp_path / "table.csv")]
    )
    shown = capsys.readouterr().out
    values = {
        (line["method"], line["column"]): line["value"]
        for line in csv.DictReader((tmp_path / "table.csv").open())
    }

    assert "| Method | mTV ↓ | Sharpness ↑ | mTV2 ↓ |" in shown
    assert "% of white" in shown
    assert "ours: 3 frames of 64 x 48" in shown
    assert "Different number or size of frames: the values are not comparable" in shown
    assert float(values["still", "mTV"]) == 0 < float(values["ours", "mTV"])
    assert float(values["still", "Sharpness"]) == pytest.approx(
        float(values["ours", "Sharpness"]), rel=0.2
    )


def test_depth_videos_are_measured_inside_a_mask(tmp_path, capsys):
    """Depth boils by 1 % in the left half alone; the mask says which half counts."""
    wall = np.tile(np.linspace(2, 4, 40, dtype=np.float32), (30, 1))
    boiling = np.stack([wall] * 4)
    boiling[1::2, :, :20] *= 1.01
    np.save(tmp_path / "depth.npy", boiling)
    for side, expected in (("left", "0.995"), ("right", "0.000")):
        mask = np.zeros((30, 40, 3), np.uint8)
        mask[:, slice(20) if side == "left" else slice(20, 40)] = 255
        write_image(tmp_path / f"{side}.png", mask)
        run_command(
            [
                "steadiness",
                "--depth",
                f"raft={tmp_path / 'depth.npy'}",
                "--mask",
                str(tmp_path / f"{side}.png"),
            ]
        )
        shown = capsys.readouterr().out
        assert f"| raft | {expected} |" in shown
        assert f"where {side}.png is white" in shown


def test_refusals_are_one_line(tmp_path):
    """Nothing named, nothing there, a mask of another size, a file of another kind."""
    video = write_video(tmp_path / "ours", [rendered(VIEWS[0], frame) for frame in FRAMES])
    write_image(tmp_path / "mask.png", np.zeros((5, 5, 3), np.uint8))

    assert "wanted NAME=PATH of a video, got none" in refusal("steadiness")
    assert "nowhere: wanted a folder of pictures" in refusal(
        "steadiness", f"ours={tmp_path / 'nowhere'}"
    )
    assert "mask: wanted (48, 64) bool, got (5, 5) bool" in refusal(
        "steadiness", f"a={video}", "--mask", tmp_path / "mask.png"
    )
    assert "wanted a file name with .md, .csv, .tex" in refusal(
        "steadiness", f"a={video}", "--out", "table.xls"
    )
    assert "wanted --depth or --colmap, got both" in refusal(
        "steadiness", f"a={video}", "--depth", "--colmap"
    )
