"""What of a run is whole: scores and page say the same of each method."""

import shutil

from ggvs_eval.coverage import read_coverage
from ggvs_eval.pipelines.run.score import plan_scores
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.run_folder import JOB_FILE, REFUSED, RunFolder, frame_path, read_json, write_json
from helpers.run_folders import LABELS, write_run


def test_scores_and_page_agree_on_what_is_whole(tmp_path):
    """Unscored: the whole one counts for both, the killed one for neither, and one that refused a
    view is scored alone.
    """
    run = RunFolder(write_run(tmp_path / "run"))
    views, numbers = run.protocol().views.test, run.protocol().frames.numbers
    for label in ("whole", "killed", "choosy"):
        shutil.copytree(run.renders(LABELS[0], ""), run.renders(label, ""))
    frame_path(run.renders("killed", views[1]), numbers[-1]).unlink()
    for frame in numbers:
        frame_path(run.renders("choosy", views[0]), frame).unlink()
    record = run.renders("choosy", views[0]) / JOB_FILE
    write_json(record, read_json(record) | {REFUSED: "looks away"})
    coverage = read_coverage(run, numbers, run.labels())
    assert coverage.unfinished(run, views, run.labels()) == {"killed"}
    assert coverage.marks["choosy"] == "partial in room: without cam00 (looks away)"
    assert read_run(run.root).labels == (*LABELS, "whole")
    finished = [label for label in run.labels() if label != "killed"]
    assert set(plan_scores(run, finished).labels) == {*LABELS, "whole", "choosy"}
