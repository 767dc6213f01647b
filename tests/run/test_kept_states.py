"""A run that goes on from its first frames is the run in one go, to the last bit, and makes nothing twice."""

from collections import Counter
from dataclasses import replace

import pytest

from ggvs_eval.metrics import stream
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Frames
from ggvs_eval.results import Results
from ggvs_eval.run_folder import RunFolder, frame_path, read_json
from helpers.small_runs import small_protocol, write_small_capture

LABELS = ("no-blending", "ours-geometric")
METRICS = ("PSNR", "PSNR_cc", "SSIM", "L1", "TCC", "STED", "Flicker", "SDT", "SDV", "PSNR_static", "PSNR_moving")
FIRST, ALL = 2, 4


@pytest.mark.slow
def test_it_goes_on_with_the_same_bits(tmp_path, monkeypatch):
    """Frames and values of all metrics are those of one go; a method steps once an instant, and frames are measured once."""
    capture = write_small_capture(tmp_path / "room", ALL)
    protocol = small_protocol(ALL, 0, METRICS)
    done: Counter[str] = Counter()
    step, score_views = GeometryGuided.step, stream.score_views

    def counted_step(method, instant):
        done["steps"] += 1
        return step(method, instant)

    def counted_scores(frames, metrics, *arguments, **keywords):
        frames = list(frames)
        done["PSNR" if "PSNR" in metrics else "PSNR_cc"] += len(frames)
        return score_views(frames, metrics, *arguments, **keywords)

    measure(plan_run(RunRequest(tmp_path / "whole", capture, protocol, LABELS)), 1)
    monkeypatch.setattr(GeometryGuided, "step", counted_step)
    monkeypatch.setattr(stream, "score_views", counted_scores)
    (tmp_path / "states").mkdir()
    begun = RunRequest(
        tmp_path / "first", capture, replace(protocol, frames=Frames(0, FIRST)), LABELS, states=tmp_path / "states"
    )
    measure(plan_run(begun), 1)
    measure(plan_run(replace(begun, root=tmp_path / "grown", protocol=protocol)), 1)

    views = protocol.views.test
    assert done == {"steps": ALL * len(views), "PSNR": ALL * len(views), "PSNR_cc": (FIRST + ALL) * len(views)}
    whole, grown = RunFolder(tmp_path / "whole"), RunFolder(tmp_path / "grown")
    for view in views:
        for label in LABELS:
            for frame in range(ALL):
                paths = [frame_path(run.renders(label, view), frame) for run in (whole, grown)]
                assert paths[0].read_bytes() == paths[1].read_bytes()
        values = [read_json(run.scores(view) / "job.json")["methods"] for run in (whole, grown)]
        assert [each["values"] for each in values[0].values()] == [each["values"] for each in values[1].values()]
    assert Results.read(grown.root).table.equals(Results.read(whole.root).table)


@pytest.mark.slow
def test_other_first_frames_are_measured_anew(tmp_path, monkeypatch):
    """Where a rendered frame is another one by then, nothing of the state that it was measured in is used."""
    capture = write_small_capture(tmp_path / "room", ALL)
    protocol = small_protocol(ALL, 0, ("PSNR", "TCC"))
    states = tmp_path / "states"
    states.mkdir()
    request = RunRequest(tmp_path / "run", capture, replace(protocol, frames=Frames(0, FIRST)), LABELS[:1], states=states)
    first = measure(plan_run(request), 1).table
    view = protocol.views.test[0]
    other, changed = (RunFolder(tmp_path / "run").renders(LABELS[0], view) / f"000{frame}.png" for frame in (1, 0))
    changed.write_bytes(other.read_bytes())
    grown = measure(plan_run(replace(request, root=tmp_path / "grown", protocol=protocol)), 1).table

    def psnr(table):
        return table[(table["metric"] == "PSNR") & (table["view"] == view) & (table["frame"] == 0)]["value"].item()

    assert psnr(grown) != psnr(first)
