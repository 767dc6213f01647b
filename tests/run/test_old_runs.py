"""A run folder of another version of the code opens, and says so once, by whichever command."""

import pytest

from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.run.outlook import describe_outdated
from ggvs_eval.reports.tables_of_runs import scores_text
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json, write_json
from helpers.small_runs import LABELS, small_protocol, write_small_capture

pytestmark = [pytest.mark.usefixtures("no_figures")]

OTHER_CODE = "0" * 64


@pytest.fixture
def words(tmp_path) -> list[str]:
    """Arguments of `ggvs-eval run` for the smallest run, which lies in `tmp_path / "run"` when it
    was called.
    """
    (tmp_path / "small.toml").write_text(small_protocol(2, 0, ("PSNR", "SSIM")).to_toml())
    capture = write_small_capture(tmp_path / "capture", 2).path
    methods = ("--methods", *LABELS, "--matcher", "sgbm", "--jobs", "1")
    return [
        str(tmp_path / "run"),
        "--capture",
        str(capture),
        "--protocol",
        str(tmp_path / "small.toml"),
        *methods,
    ]


def make_old(run: RunFolder) -> None:
    """Write into a run what one of another version of the code has: other hashes of code."""
    for file in (*run.root.glob("renders/*/*/job.json"), *run.root.glob("scores/*/*/*/job.json")):
        record = read_json(file)
        write_json(
            file,
            record | {"sha256": OTHER_CODE, "identity": record["identity"] | {"code": OTHER_CODE}},
        )
    for file in run.depth.glob("*/job.json"):
        record = read_json(file)
        record["identity"]["options"]["code"] = OTHER_CODE
        write_json(file, record)
        file.parent.rename(file.parent.with_name(f"old-{file.parent.name}"))


@pytest.mark.slow
def test_an_old_run_says_that_its_results_are_outdated_once(words, tmp_path, capsys):
    """`status`, `report` and `run` name what other code has made; `run` makes it again, with equal
    numbers; then none does.
    """
    run = RunFolder(tmp_path / "run")
    run_command(["run", *words])
    results = Results.read(run.root)
    made, printed = results.summary(), capsys.readouterr()
    assert printed.out == f"{scores_text(run.root)}\n{run.report / 'index.html'}\n"
    assert "another version" not in printed.err
    assert describe_outdated([run]) == ""
    make_old(run)
    parts = "4 renders (no-blending, distance-based), the depth of renders, 2 scored views"
    outdated = f"{parts} are of another version of the code"

    for command in ("status", "report"):
        run_command([command, str(run.root)])
        assert "".join(capsys.readouterr()).count(outdated) == 1
    run_command(["run", *words])
    assert capsys.readouterr().err.count(f"{outdated}; they are recomputed") == 1

    assert Results.read(run.root).summary().equals(made)
    assert all(
        read_json(file)["sha256"] != OTHER_CODE for file in run.root.glob("renders/*/*/job.json")
    )
    for command in ("status", "report"):
        run_command([command, str(run.root)])
    run_command(["run", *words])
    assert "another version" not in "".join(capsys.readouterr())


@pytest.mark.slow
def test_what_this_version_lacks_is_not_outdated(words, tmp_path):
    """Nothing here would make again the renders of a method that is gone, nor anything that is no
    run.
    """
    run = RunFolder(tmp_path / "run")
    run_command(["run", *words])
    file = run.renders(LABELS[0], "cam00") / JOB_FILE
    write_json(file, read_json(file) | {"identity": {"method": "gone", "code": OTHER_CODE}})
    run.renders(LABELS[0], "cam00").parent.rename(run.root / "renders" / "gone")
    assert describe_outdated([run, RunFolder(tmp_path)]) == ""
