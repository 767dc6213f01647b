"""Sweeps that are killed, that fail in part, or that several machines share end like one that
nobody disturbed.
"""

import dataclasses
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import ResultsError
from ggvs_eval.files.atomic import is_running
from ggvs_eval.jobs.engine import Engine
from ggvs_eval.jobs.shard import Shard
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.commands.runs import status
from ggvs_eval.pipelines.run.status import read_status
from ggvs_eval.pipelines.sweep.run_sweep import plan_cells, run_sweep
from ggvs_eval.protocol import Frames, Views, load_protocol
from ggvs_eval.sweep import load_sweep

VIEWS = ("cam00", "cam01")
LABELS = ("distance-based", "no-blending")
JOBS = 2 * len(VIEWS) * len(LABELS)  # at K = 2 and 3
KILLS = 2
NO_PROCESS = 4194304000  # more than Linux has
SWEEP_SCRIPT = """
import sys
from ggvs_eval.pipelines.commands.main import run_command
if __name__ == "__main__":
    run_command(sys.argv[1:])
"""


@pytest.fixture(scope="module")
def words(written_dynerf, tmp_path_factory) -> list[str]:
    """The command line of a small sweep, all but its folder."""
    root = tmp_path_factory.mktemp("sweep")
    base = load_protocol("demo")
    measurement = dataclasses.replace(base.measurement, metrics=("PSNR", "SSIM"), ceilings=False)
    protocol = dataclasses.replace(
        base,
        views=Views(VIEWS, "test"),
        frames=Frames(0, 2),
        measurement=measurement,
        path=dataclasses.replace(base.path, poses=0),
    )
    (root / "protocol.toml").write_text(protocol.to_toml())
    rows = "".join(f"[[row]]\ntitle = '{label}'\nmethod = '{label}'\n" for label in LABELS)
    (root / "sweep.toml").write_text(f"name = 'small'\ndescribe = 'x'\nk = [2, 3]\n{rows}")
    return [
        str(root / "sweep.toml"),
        "--capture",
        str(written_dynerf),
        "--protocol",
        str(root / "protocol.toml"),
    ]


def run_in_python(out: Path, words: list[str], engine: Engine | int = 1, shard: str = "1/1"):
    name, _, capture, _, protocol = words
    start = open_capture(Path(capture)), load_protocol(protocol)
    return run_sweep(
        plan_cells(out, {"": start}, load_sweep(name), shard=Shard.parse(shard)), engine
    )


@pytest.fixture(scope="module")
def undisturbed(words, tmp_path_factory) -> Path:
    out = tmp_path_factory.mktemp("undisturbed") / "sweep"
    assert run_in_python(out, words).failures == ()
    return out


def kill_when(begun: Callable[[], object], pid: int) -> None:
    while not begun():
        time.sleep(0.005)
    os.kill(pid, signal.SIGKILL)


def outcome(sweep: Path) -> dict[str, object]:
    """Every rendered byte and every value, with no clock in them; nothing half."""
    frames = {
        file.relative_to(sweep).as_posix(): file.read_bytes()
        for file in sweep.glob("*/renders/*/*/*.png")
    }
    assert len(frames) == 2 * JOBS
    assert [file for file in sweep.rglob("*.tmp")] == []
    values = {
        f"{k}/results": pd.read_parquet(sweep / k / "results.parquet").to_csv()
        for k in ("k2", "k3")
    }
    table = pd.read_csv(sweep / "sweep.csv", index_col=[0, 1]).drop(columns="s/frame").to_csv()
    return frames | values | {"table": table}


@pytest.mark.slow
def test_a_sweep_killed_at_random_ends_like_an_undisturbed_one(words, undisturbed, tmp_path):
    """After kill -9 of the main process and its workers, at random, the same call ends with the
    same bytes and values.
    """
    (tmp_path / "main.py").write_text(SWEEP_SCRIPT)
    chance, out, killed = random.Random(4), tmp_path / "sweep", 0
    command = [
        sys.executable,
        str(tmp_path / "main.py"),
        "sweep",
        words[0],
        str(out),
        *words[1:],
        "--jobs",
        "2",
    ]
    for wanted_done in sorted(chance.sample(range(JOBS), KILLS)):
        process = subprocess.Popen(command, start_new_session=True, stdout=subprocess.DEVNULL)
        while (
            len(list(out.glob("k*/renders/*/*/job.json"))) < wanted_done and process.poll() is None
        ):
            time.sleep(0.01)
        time.sleep(chance.random() / 10)
        killed += process.poll() is None
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()

    result = run_in_python(out, words)

    assert killed == KILLS
    assert result.failures == ()
    assert outcome(out) == outcome(undisturbed)


@pytest.mark.slow
def test_shards_on_their_own_disks_are_the_whole_when_merged(words, undisturbed, tmp_path):
    """Two machines that share nothing render different views; copied together the last call renders
    nothing.
    """
    renders = []
    for number in (1, 2):
        result = run_in_python(tmp_path / f"machine{number}", words, shard=f"{number}/2")
        assert result.table.empty
        renders.append(
            {
                file.relative_to(tmp_path / f"machine{number}")
                for file in (tmp_path / f"machine{number}").glob("*/renders/*/*")
            }
        )
    merged = shutil.copytree(tmp_path / "machine1", tmp_path / "merged", symlinks=True)
    links = shutil.ignore_patterns("truth", "depth")
    shutil.copytree(tmp_path / "machine2", merged, ignore=links, dirs_exist_ok=True)
    before = {file: file.stat().st_mtime_ns for file in merged.glob("*/renders/*/*/*")}

    run_in_python(merged, words)

    assert renders[0].isdisjoint(renders[1])
    assert len(renders[0] | renders[1]) == JOBS
    assert {file: file.stat().st_mtime_ns for file in merged.glob("*/renders/*/*/*")} == before
    assert outcome(merged) == outcome(undisturbed)


def test_what_fails_is_listed_and_the_rest_is_done(words, undisturbed, tmp_path, capsys):
    """With one damaged depth map the jobs that need it fail, `status` names them, the others have
    their lines; mended, all do.
    """
    out = Path(shutil.copytree(undisturbed, tmp_path / "sweep", symlinks=True))
    shutil.rmtree(out / "k2" / "renders" / "no-blending")
    shutil.rmtree(out / "k2" / "renders" / "distance-based" / "cam01")
    plan = {file: file.read_bytes() for file in out.glob("depth/*/*.npz")}
    used = json.loads(next(out.glob("k2/renders/*/cam00/job.json")).read_text())["identity"][
        "sources"
    ]
    broken = out / "depth" / used[0][2][:24] / "000001.npz"
    broken.write_bytes(b"damaged")

    with pytest.raises(SystemExit) as ended:
        run_command(["sweep", words[0], str(out), *words[1:], "--jobs", "1"])

    said = capsys.readouterr()
    assert "failed, listed above" in str(ended.value.code)
    assert "failed: k2: no-blending in cam00" in said.err
    assert "damaged" not in said.out
    stage = read_status(out)[0]
    assert (stage.n_done + len(stage.failed), len(stage.missing)) == (JOBS, 0)
    assert all(broken.name in failure.message for failure in stage.failed)
    status(out)
    assert "failed   k2: no-blending in cam00" in capsys.readouterr().out
    assert "k3" in said.out

    broken.write_bytes(plan[broken])
    assert run_in_python(out, words).failures == ()
    assert outcome(out) == outcome(undisturbed)
    assert read_status(out)[0].failed == ()


def test_status_counts_what_is_there(undisturbed, tmp_path, capsys):
    """All jobs are done and weigh what their files weigh; of a run in the sweep only its own;
    elsewhere nothing is told.
    """
    render, score = read_status(undisturbed)
    of_k2 = read_status(undisturbed / "k2")[0]
    files = [file for file in undisturbed.glob("*/renders/*/*/*") if file.is_file()]

    status(undisturbed)

    assert (render.n_done, render.in_hand, render.failed, render.missing) == (JOBS, (), (), ())
    assert render.n_bytes == sum(file.stat().st_size for file in files)
    assert (score.n_done, of_k2.n_done) == (2 * len(VIEWS), JOBS // 2)
    assert f"render: {JOBS} done, 0 running, 0 failed, 0 missing" in capsys.readouterr().out
    with pytest.raises(ResultsError, match="wanted a run or a sweep with renders"):
        read_status(tmp_path)


def test_status_sees_a_job_that_is_under_way(undisturbed, tmp_path):
    """What a live process fills is running, what a dead one left is missing."""
    out = Path(shutil.copytree(undisturbed, tmp_path / "sweep", symlinks=True))
    host = os.uname().nodename.replace(".", "-")
    for view, pid in (("cam00", os.getpid()), ("cam01", NO_PROCESS)):
        folder = out / "k2" / "renders" / "no-blending" / view
        folder.rename(folder.with_name(f".{view}.{host}.{pid}.tmp"))

    render = read_status(out)[0]

    assert render.in_hand == ("k2: no-blending in cam00",)
    assert render.missing == ("k2: no-blending in cam01",)


def test_a_plan_lists_commands_that_make_the_whole(words, tmp_path, capsys):
    """Its commands prepare, take each view once, and make the table after all of them; options that
    were given are in each.
    """
    run_command(
        [
            "sweep",
            words[0],
            str(tmp_path / "s"),
            *words[1:],
            "--jobs",
            "3",
            "--sensor",
            "no",
            "--plan",
            str(tmp_path / "p.json"),
        ]
    )

    first, *views, last = json.loads((tmp_path / "p.json").read_text())["jobs"]
    assert not (tmp_path / "s").exists()
    assert first["command"][-2:] == ["--shard", f"0/{len(views)}"]
    assert [job["command"][-1] for job in views] == [
        f"{number}/{len(views)}" for number in range(1, len(views) + 1)
    ]
    assert all(job["after"] == ["prepare"] for job in views)
    assert last["after"] == [job["id"] for job in views]
    assert "k3/cam01" in last["after"]
    assert {"--jobs", "3", "--sensor", "no"} < set(last["command"])
    assert "--shard" not in last["command"]


@pytest.mark.parametrize("text", ["3/2", "1", "a/b", "-1/2", "1/0"])
def test_a_shard_that_is_none_is_refused(text, words, tmp_path):
    """One line that says how a shard is written."""
    with pytest.raises(SystemExit) as ended:
        run_command(["sweep", words[0], str(tmp_path / "s"), *words[1:], f"--shard={text}"])
    assert "wanted i/n" in str(ended.value.code)


@pytest.mark.proof
def test_dask_workers_render_the_same_bits(words, undisturbed, tmp_path):
    """A sweep over three dask workers, one of which is killed while it renders, ends like the
    serial one.
    """
    distributed = pytest.importorskip("distributed")
    out = tmp_path / "sweep"
    with distributed.LocalCluster(
        n_workers=3, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        victim = cluster.workers[0].process.pid
        killer = threading.Thread(
            target=kill_when, args=(lambda: list(out.glob("k*/renders/*/*")), victim)
        )
        killer.start()
        result = run_in_python(out, words, Engine(1, "dask", cluster.scheduler_address))
        killer.join()

    assert not is_running(victim)
    assert result.failures == ()
    assert outcome(out) == outcome(undisturbed)
