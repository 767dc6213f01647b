"""What a prepared run makes of its depth: the page, a fused instant, a COLMAP workspace."""

import json
from pathlib import Path

import numpy as np
import pytest
import trimesh

from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.export.dense_workspace import read_array
from ggvs_eval.pipelines.run.depth_outputs import (
    export_prepared,
    fuse_prepared,
    write_prepared_page,
)
from ggvs_eval.pipelines.run.prepare import prepare
from ggvs_eval.pipelines.run.run_plan import RunPlan
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol, Synthesis, Views
from helpers.refusals import refused
from helpers.stereo_scenes import PLANE, write_capture


@pytest.fixture(scope="module")
def prepared(tmp_path_factory) -> RunPlan:
    """Two frames of the plane, cam01 left out and made from two others, and a short camera path."""
    folder = tmp_path_factory.mktemp("prepared")
    views, measurement = Views(("cam01",), "me"), Measurement(("PSNR",))
    protocol = Protocol(
        "plane", "plane", views, Frames(1, 2), Synthesis(2), measurement, CameraPath(2)
    )
    return prepare(folder / "run", write_capture(folder / "capture"), protocol, 1)


@pytest.mark.slow
def test_page_shows_every_source_at_the_instants_that_it_has(prepared):
    """First, middle and last frame of the cameras that views are made of; those of the path alone
    at its instant.
    """
    page = write_prepared_page(prepared)
    assert page == prepared.run.root / "depth_page" / "index.html"
    told = json.loads((page.parent / "index.json").read_text())
    shown = {
        camera["name"]: [each["frame"] for each in camera["pictures"]["instants"]]
        for camera in told["cameras"]
    }
    sources = {job.camera_name for job in prepared.plans["cam01"].jobs}
    path = {job.camera_name for plan in prepared.path for job in plan.jobs}
    assert set(shown) == sources | path
    assert all(
        shown[name] == ([1, 2] if name in sources else [prepared.path_frame]) for name in shown
    )
    assert all(
        row["measured"] > 0.7
        for camera in told["cameras"]
        for _, rows in camera["jobs"]
        for row in rows
    )
    assert all(pair["row_px"] < 0.3 for pair in told["pairs"])


@pytest.mark.slow
def test_instant_is_fused(prepared):
    """The fused cloud of the second prepared frame is the plane where it was then, within a
    hundredth of its depth.
    """
    fused = fuse_prepared(prepared, 2)
    assert fused.points == prepared.run.root / "fused" / "0002" / "points.ply"
    for path in (fused.points, fused.mesh):
        points = np.asarray(trimesh.load(path).vertices)
        off = np.abs(points @ [-PLANE[0], -PLANE[1], 1.0] - (PLANE[2] - 0.4))
        assert len(points) > 1000
        assert np.median(off) < 0.06


def test_instant_is_exported(prepared, tmp_path):
    """The workspace holds each camera once, with the depth of its job with most partners; the first
    frame by default.
    """
    folder = export_prepared(prepared, tmp_path / "workspace")
    plan = prepared.plans["cam01"]
    jobs = [
        *plan.jobs,
        *(job for each in prepared.path if prepared.path_frame == 1 for job in each.jobs),
    ]
    names = sorted({job.camera_name for job in jobs})
    assert sorted(file.stem for file in Path(folder / "images").iterdir()) == names
    for job in plan.jobs:
        if len(job.partner_names) == max(
            len(each.partner_names) for each in jobs if each.camera_name == job.camera_name
        ):
            stored = DepthStore(prepared.run.depth).read(plan.depth_keys[job.camera_name], 1)
            found = read_array(
                folder / "stereo" / "depth_maps" / f"{job.camera_name}.png.geometric.bin"
            )
            kept = found > 0
            assert kept.mean() > 0.3
            assert (found[kept] == stored.depth[kept]).all()


@pytest.mark.parametrize("frame", [0, 3])
def test_frames_that_were_not_prepared(prepared, frame, tmp_path):
    """A frame outside the protocol is refused with those that there are."""
    assert prepared.path_frame == 1
    for make in (
        lambda: fuse_prepared(prepared, frame),
        lambda: export_prepared(prepared, tmp_path / "workspace", frame),
    ):
        with refused(DepthError, f"frame {frame}", "1..2"):
            make()
