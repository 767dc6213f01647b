"""Two processes that score one run folder: each waits for the other's view, and neither loses what
the other has measured.
"""

import shutil
import subprocess
import sys
import time

import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.metrics import stream
from ggvs_eval.pipelines.run.import_renders import import_renders
from ggvs_eval.pipelines.run.score import plan_scores, score
from ggvs_eval.run_folder import JOB_FILE, RunFolder
from helpers.refusals import refused
from helpers.render_folders import VIEWS, make_run, write_folders

SCORE = """
import sys
from pathlib import Path
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.run_folder import RunFolder
score(RunFolder(Path(sys.argv[1])))
"""
FIRST, LAST = VIEWS


@pytest.fixture
def run(tmp_path) -> RunFolder:
    made = make_run(tmp_path / "run", ("PSNR", "L1"))
    import_renders(made, "one", write_folders(tmp_path / "one"))
    return made


def methods(run: RunFolder, view: str) -> set[str]:
    """Labels that have values in a view."""
    return {
        folder.name
        for folder in run.scores(view).glob("*/")
        if (folder / "PSNR" / JOB_FILE).is_file()
    }


@pytest.mark.slow
def test_no_update_is_lost(run, tmp_path, monkeypatch):
    """The second process adds a method while the first measures its last view: both methods have
    values in both views.
    """
    original, begun = stream.score_views, []

    def slow(*arguments, **keywords):
        begun.append(1)
        if len(begun) == 2:  # the last view
            import_renders(run, "other", write_folders(tmp_path / "other"))
            begun.append(subprocess.Popen([sys.executable, "-c", SCORE, str(run.root)]))
            until = time.monotonic() + 60
            while "other" not in methods(run, FIRST) and time.monotonic() < until:
                time.sleep(0.1)
            time.sleep(2)  # time enough for the last view of so small a run
        return original(*arguments, **keywords)

    monkeypatch.setattr(stream, "score_views", slow)
    results = score(run)
    assert begun[2].wait(60) == 0

    assert set(results.table["method"]) == {"one"}
    assert [methods(run, view) for view in (FIRST, LAST)] == [{"one", "other"}] * 2
    table = score(run).table  # whichever of the two wrote its own last
    assert table.groupby("method")["view"].nunique().to_dict() == {"one": 2, "other": 2}
    for labels in (["one"], ["one", "other"]):
        assert all(task.is_done() for task in plan_scores(run, labels).tasks)


def test_a_view_without_values_is_no_partial_method(run):
    """A method that has frames in a view and no values there is an error, not a row over fewer
    views.
    """
    scores = plan_scores(run, ["one"])
    score(run)
    shutil.rmtree(run.scores(LAST) / "one" / "PSNR")
    with refused(RenderError, LAST, "wanted values of one", "score again"):
        scores.collect()
