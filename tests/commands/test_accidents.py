"""What happens to a command: Ctrl-C, SIGTERM, a full disk, a folder that cannot be written, a log
that somebody reads.
"""

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO

import pandas as pd
import pytest
import torch
from torch.optim.swa_utils import AveragedModel

from ggvs_eval import progress
from ggvs_eval.contrib.training.loop import TrainingState, write_state, write_weights
from ggvs_eval.errors import mendable
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.protocol import load_protocol
from helpers.captures import write_dynerf
from helpers.command_line import refusal
from helpers.small_runs import small_protocol

pytestmark = [pytest.mark.usefixtures("no_figures")]

COMMAND = [sys.executable, "-m", "ggvs_eval"]
GO_ON = "finished work is kept; run the same command to resume"
AS_NOBODY = ("setpriv", "--reuid", "65534", "--regid", "65534", "--clear-groups")
WAIT_S = 120


@pytest.fixture(scope="module")
def words(tmp_path_factory) -> list[str]:
    """Options of a small run."""
    root = tmp_path_factory.mktemp("accidents")
    capture = write_dynerf(root / "room")
    (root / "p.toml").write_text(small_protocol(2, 0, ("PSNR",)).to_toml())
    return [
        "--capture",
        str(capture),
        "--protocol",
        str(root / "p.toml"),
        "--methods",
        "no-blending",
        "distance-based",
    ]


def told(
    *arguments: object, before: Sequence[str] = (), stdout: IO[str] | int = subprocess.DEVNULL
) -> tuple[int, list[str]]:
    """Exit code and lines of standard error of a command in a process of its own."""
    command = [*before, *COMMAND, *map(str, arguments)]
    done = subprocess.run(command, stdout=stdout, stderr=subprocess.PIPE, text=True, check=False)
    return done.returncode, done.stderr.splitlines()


@pytest.fixture
def interruptible() -> Iterator[None]:
    """What is started in the background of a shell ignores Ctrl-C, and so would what it starts."""
    before = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, before)


def wait_for(condition: Callable[[], object]) -> None:
    end_s = time.monotonic() + WAIT_S
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.01)
    assert condition()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "to_all", "jobs"),
    [
        (signal.SIGINT, True, 2),
        (signal.SIGTERM, False, 1),
        pytest.param(signal.SIGINT, False, 2, marks=pytest.mark.proof),
        pytest.param(signal.SIGTERM, False, 2, marks=pytest.mark.proof),
    ],
)
def test_a_command_that_is_stopped_says_how_to_go_on(
    number, to_all, jobs, words, interruptible, tmp_path
):
    """Ctrl-C, which a terminal sends to all processes, and SIGTERM: one line, 130, no worker left;
    the same command goes on.
    """
    run = tmp_path / "run"
    command = [*COMMAND, "run", str(run), *words, "--jobs", str(jobs)]
    process = subprocess.Popen(
        command,
        stderr=subprocess.PIPE,
        stdout=subprocess.DEVNULL,
        text=True,
        start_new_session=True,
    )
    wait_for(lambda: (run / "jobs" / "render.json").is_file())
    (os.killpg if to_all else os.kill)(process.pid, number)
    _, errors = process.communicate(timeout=WAIT_S)

    assert process.returncode == 130
    progress_line = re.compile(r"plan: |disk: |.*: \d+ of \d+ in")
    assert [line for line in errors.splitlines() if not progress_line.match(line)] == [
        f"ggvs-eval: stopped; {GO_ON}"
    ]
    wait_for(lambda: not group_members(process.pid))
    run_command(["run", str(run), *words, "--jobs", "1"])
    assert (run / "report" / "index.html").is_file()
    assert list(run.rglob("*.tmp")) == []


def group_members(group: int) -> list[int]:
    """Processes of a group that run."""
    listed = subprocess.run(
        ["ps", "-eo", "pid=,pgid=,stat="], capture_output=True, text=True, check=True
    ).stdout
    rows = (line.split() for line in listed.splitlines())
    return [
        int(pid) for pid, pgid, state in rows if int(pgid) == group and not state.startswith("Z")
    ]


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_command_that_is_stopped_while_it_starts(number, interruptible, tmp_path):
    """In the middle of imports, some of which would swallow an exception."""
    process = subprocess.Popen(
        [*COMMAND, "status", str(tmp_path)], stderr=subprocess.PIPE, text=True
    )
    status = Path(f"/proc/{process.pid}/status")
    wait_for(
        lambda: (
            int(re.search(r"SigCgt:\t(\w+)", status.read_text())[1], 16) >> (signal.SIGTERM - 1) & 1
        )
    )
    process.send_signal(number)
    _, errors = process.communicate(timeout=WAIT_S)

    assert (process.returncode, errors) == (130, f"ggvs-eval: stopped; {GO_ON}\n")


@contextmanager
def mounted(folder: Path, *options: str) -> Iterator[Path]:
    folder.mkdir()
    if subprocess.run(
        ["mount", *options, str(folder)], capture_output=True, check=False
    ).returncode:
        pytest.skip("file systems can only be mounted by root")
    yield folder
    subprocess.run(["umount", str(folder)], check=True)


@pytest.fixture
def small_disk(tmp_path) -> Iterator[Path]:
    """A file system of 100 kB."""
    with mounted(tmp_path / "disk", "-t", "tmpfs", "-o", "size=100k", "tmpfs") as folder:
        yield folder


@pytest.fixture
def read_only(tmp_path) -> Iterator[Path]:
    """A folder of a file system that can only be read."""
    with mounted(tmp_path / "readonly", "--bind", str(tmp_path / "readonly")) as folder:
        subprocess.run(["mount", "-o", "remount,ro,bind", str(folder)], check=True)
        yield folder


@pytest.mark.slow
@pytest.mark.parametrize("jobs", ["1", pytest.param("2", marks=pytest.mark.proof)])
def test_a_full_disk_is_one_line(jobs, words, small_disk, tmp_path):
    """In a job of a run, with and without processes; room is made, and the same command goes on."""
    run = tmp_path / "run"
    run_command(["prepare", str(run), *words[:4], "--jobs", "1"])
    (run / "renders").symlink_to(small_disk)
    (small_disk / "other").write_bytes(bytes(90_000))

    code, lines = told("render", run, "--methods", "no-blending", "--jobs", jobs)

    assert code == 1
    assert re.fullmatch(
        rf"ggvs-eval: .*no-blending.*: No space left on device; make room; {GO_ON}", lines[-1]
    )
    assert not any("Traceback" in line for line in lines)
    (small_disk / "other").unlink()
    run_command(["render", str(run), "--methods", "no-blending", "--jobs", "1"])


@pytest.mark.proof
def test_a_disk_that_fills_while_a_demo_is_filmed(small_disk):
    """Several kinds of files are written; all name what could not be."""
    (small_disk / "other").write_bytes(bytes(90_000))
    room = [
        "--n-frames",
        "2",
        "--width",
        "64",
        "--height",
        "48",
        "--cameras-per-row",
        "2",
        "--supersampling",
        "1",
    ]

    line = refusal("film", small_disk / "demo", *room, "--path-poses", "0", "--jobs", "1")

    assert re.fullmatch(
        rf"ggvs-eval: {small_disk}.*No space left on device; make room; {GO_ON}", line
    )
    assert sorted(item.name for item in small_disk.iterdir()) == ["other"]


@pytest.mark.slow
def test_weights_and_states_name_a_full_disk(small_disk):
    """The libraries that write them would say that something failed."""
    network = torch.nn.Linear(200, 200)
    state = TrainingState(
        1, 0, network, AveragedModel(network), torch.optim.Adam(network.parameters())
    )

    for write in (
        lambda: write_weights(small_disk / "a.safetensors", network, {}),
        lambda: write_state(small_disk, state),
    ):
        (small_disk / "other").write_bytes(bytes(70_000))
        with pytest.raises(OSError, match="No space left on device") as refused:
            write()
        assert mendable(refused.value).startswith(f"{small_disk}/")
        assert [item.name for item in small_disk.iterdir()] == ["other"]


@pytest.mark.slow
def test_output_onto_a_full_disk_is_one_line(words, tmp_path):
    """`ggvs-eval ... > FILE`: /dev/full is always full."""
    run_command(
        ["run", str(tmp_path / "run"), *words[:4], "--methods", "no-blending", "--jobs", "1"]
    )

    with Path("/dev/full").open("w") as full:
        code, lines = told("status", tmp_path / "run", stdout=full)

    assert (code, lines) == (1, [f"ggvs-eval: No space left on device; make room; {GO_ON}"])


@pytest.mark.slow
def test_a_read_only_folder_is_one_line(words, read_only):
    """Whatever a command wants to write there."""
    end = f"Read-only file system; choose a folder that can be written; {GO_ON}"

    assert refusal("run", read_only / "run", *words).endswith(end)
    assert refusal("demo", read_only / "demo").endswith(end)
    assert refusal("check", words[1], "--out", read_only / "check.json").endswith(
        f"{read_only}/check.json: {end}"
    )


@pytest.mark.slow
def test_a_folder_of_somebody_else_is_one_line(words, tmp_path):
    """As a user who may neither write nor read it."""
    if (
        os.getuid() != 0
        or subprocess.run(
            [*AS_NOBODY, sys.executable, "-c", "import ggvs_eval"], check=False
        ).returncode
    ):
        pytest.skip(
            "only root can become somebody who may not, and only where the package lies in no "
            "private folder"
        )
    run_command(
        ["run", str(tmp_path / "run"), *words[:4], "--methods", "no-blending", "--jobs", "1"]
    )
    for folder in (tmp_path, *list(tmp_path.parents)[:2]):
        folder.chmod(0o755)
    (tmp_path / "run" / "jobs").chmod(0o700)

    for command in ("score", "status"):
        code, lines = told(command, tmp_path / "run", before=AS_NOBODY)
        assert code == 1
        assert re.fullmatch(
            rf"ggvs-eval: {tmp_path}/run/\S+: Permission denied; ask for access or choose another "
            rf"place; {GO_ON}",
            lines[-1],
        )
        assert not any("Traceback" in line for line in lines)


@pytest.mark.parametrize(
    ("place", "reason"), [("file", "File exists"), ("file/below", "Not a directory")]
)
def test_a_file_in_the_place_of_a_folder_is_one_line(place, reason, words, tmp_path):
    """A path that cannot be a run folder."""
    (tmp_path / "file").touch()

    assert (
        refusal("run", tmp_path / place, *words)
        == f"ggvs-eval: {tmp_path / place}: {reason}; choose another path; {GO_ON}"
    )


@pytest.mark.slow
@pytest.mark.proof
def test_a_scheduler_that_dies_is_one_line(words, tmp_path):
    """The client of dask says much about it; we say what to do, and nothing else is shown."""
    pytest.importorskip("distributed")
    run, address = tmp_path / "run", f"tcp://127.0.0.1:{20_000 + os.getpid() % 20_000}"
    here = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    python = [sys.executable, "-m"]
    scheduler = subprocess.Popen(
        [*python, "distributed.cli.dask_scheduler", "--host", address, "--no-dashboard"], **here
    )
    worker = subprocess.Popen(
        [
            *python,
            "distributed.cli.dask_worker",
            address,
            "--no-nanny",
            "--no-dashboard",
            "--nthreads",
            "1",
        ],
        **here,
    )
    command = [*COMMAND, "run", str(run), *words, "--engine", "dask", "--scheduler", address]
    process = subprocess.Popen(
        command, stderr=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True
    )
    try:
        wait_for(lambda: list(run.glob("depth/*/*.npz")) or process.poll() is not None)
        scheduler.kill()
        _, errors = process.communicate(timeout=WAIT_S)
    finally:
        for child in (scheduler, worker, process):
            child.kill()
            child.wait()

    assert process.returncode == 1
    assert errors.splitlines()[-1] == f"ggvs-eval: {address}: the scheduler has gone; {GO_ON}"
    assert "Traceback" not in errors


@pytest.mark.slow
def test_two_sweeps_into_one_folder_share_its_table(words, tmp_path):
    """Lines of both, in the order in which they came; one that is measured again takes its place,
    digits of the others stay.
    """
    for name, k, label in (("one", 2, "distance-based"), ("two", 3, "no-blending")):
        rows = f"[[row]]\ntitle = '{label}'\nmethod = '{label}'\n"
        (tmp_path / f"{name}.toml").write_text(
            f"name = '{name}'\ndescribe = 'x'\nk = [{k}]\n{rows}"
        )
    tables = []
    for name in ("one", "two", "one"):
        run_command(
            [
                "sweep",
                str(tmp_path / f"{name}.toml"),
                str(tmp_path / "out"),
                *words[:4],
                "--jobs",
                "1",
            ]
        )
        tables.append((tmp_path / "out" / "sweep.csv").read_text())

    read = pd.read_csv(tmp_path / "out" / "sweep.csv")
    assert tables[1].startswith(tables[0])
    assert [line.split(",")[:3] for line in tables[2].splitlines()] == [
        line.split(",")[:3] for line in tables[1].splitlines()
    ]
    assert list(read["method"]) == ["distance-based", "no-blending"]
    assert read.notna().all(axis=None)
    assert load_protocol("demo").name in set(read["variant"]) or "k3" in set(read["variant"])


def test_a_log_gets_a_line_per_stage_and_per_minute(capfd, monkeypatch):
    """What, how much of how much, and the time left; also while the first item takes its time."""
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.2)

    for _ in progress.track(range(2), "rendering"):
        time.sleep(0.5)
    for _ in progress.track(iter("ab"), "reading"):
        pass

    *middle, last, other = capfd.readouterr().err.splitlines()
    assert middle[0] == "rendering: 0 of 2 in 0 s"
    assert any(re.fullmatch(r"rendering: 1 of 2 in \d s, about \d s left", line) for line in middle)
    assert re.fullmatch(r"rendering: 2 of 2 in \d s", last)
    assert other == "reading: 2 in 0 s"


def test_work_that_fails_ends_its_lines(capfd, monkeypatch):
    """After an error nothing more is told of it."""
    monkeypatch.setattr(progress, "LINE_EVERY_S", 0.05)

    def spoilt() -> Iterator[int]:
        yield 1
        raise ValueError("spoilt")

    with pytest.raises(ValueError, match="spoilt"):
        list(progress.track(spoilt(), "rendering", 2))
    capfd.readouterr()
    time.sleep(0.3)

    assert capfd.readouterr().err == ""
