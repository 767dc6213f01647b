"""Files of a finished run that are lost or cut short: what we made is made again, and no table is
written from the rest.
"""

import shutil

import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.pipelines.run.evaluate import measure, render, reopen
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.pipelines.run.score import score
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.refusals import refused
from helpers.small_runs import LABELS, small_protocol, write_small_capture

POSES = 5
FILES = {
    "a picture": lambda run: frame_path(run.renders(LABELS[0], "cam01"), 1),
    "a picture of the path": lambda run: frame_path(run.path(LABELS[0]), 2),
}


@pytest.fixture(scope="module")
def capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 2)


@pytest.fixture(scope="module")
def finished(capture, tmp_path_factory):
    root = tmp_path_factory.mktemp("finished") / "run"
    measure(
        plan_run(
            RunRequest(
                root,
                capture,
                small_protocol(2, POSES, ("PSNR", "EPI_coherence", "path_sharpness")),
                LABELS,
            )
        ),
        1,
    )
    return root


@pytest.fixture
def run(finished, tmp_path) -> RunFolder:
    shutil.copytree(finished, tmp_path / "run")
    return RunFolder(tmp_path / "run")


def lose(file) -> None:
    file.unlink()


def cut(file) -> None:
    file.write_bytes(file.read_bytes()[: file.stat().st_size // 2])


@pytest.mark.parametrize("harm", [lose, cut])
@pytest.mark.parametrize("which", FILES)
def test_what_is_lost_is_rendered_again(run, which, harm):
    """A picture of a view or the path that is gone or cut is made again with its bytes; until then
    `score` names what is gone.
    """
    file, table = FILES[which](run), (run.root / "results.parquet").read_bytes()
    whole = file.read_bytes()
    harm(file)
    if harm == lose:
        with refused(RenderError, f"{LABELS[0]} ", " lacks ", "ggvs-eval render"):
            score(run)

    assert render(reopen(run.root, 1, LABELS)) == 1
    assert file.read_bytes() == whole
    score(run)
    assert (run.root / "results.parquet").read_bytes() == table


def test_a_method_without_a_path_is_no_loss(run):
    """A method that has no folder of path pictures is scored in its views."""
    shutil.rmtree(run.path(LABELS[0]))
    assert score(run).table["method"].nunique() == len(LABELS)


def test_a_lost_path_of_another_method_leaves_that_one_out(run, capture, capsys):
    """A call for one method names the other, whose path lacks a picture, and goes on without it."""
    frame_path(run.path(LABELS[0]), 2).unlink()
    results = measure(plan_run(RunRequest(run.root, capture, run.protocol(), LABELS[1:])), 1)
    assert set(results.table["method"]) == {LABELS[1]}
    assert f"{LABELS[0]} omitted" in capsys.readouterr().err
