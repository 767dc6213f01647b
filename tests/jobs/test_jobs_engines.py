"""Engines: wherever jobs run, whoever kills their processes, the same results come out."""

import errno
import os
import signal
import subprocess
import sys
import time
from functools import partial
from multiprocessing import synchronize
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.jobs import machine
from ggvs_eval.jobs.engine import Engine, start_remedy
from ggvs_eval.jobs.processes import kept_workers
from ggvs_eval.tasks.run_tasks import attempt_tasks, run_tasks
from ggvs_eval.tasks.task import Task

ENGINES = [Engine(2), Engine(2, "dask")]
DASK_AS_PROOF = [Engine(2), pytest.param(Engine(2, "dask"), marks=pytest.mark.proof)]


def write_square(number: int, folder: Path) -> dict:
    (folder / "square.txt").write_text(str(number**2))
    return {"number": number}


def be_killed(times: int, diary: Path, folder: Path) -> dict:
    """Die by kill -9, as the kernel does when memory is out, so many times; then do the work."""
    deaths = len(list(diary.glob("death*")))
    if deaths < times:
        (diary / f"death{deaths}").touch()
        time.sleep(0.3)  # others are in hand then
        os.kill(os.getpid(), signal.SIGKILL)
    return write_square(3, folder)


def square_job(root: Path, number: int) -> Task:
    return Task(
        name=f"square {number}",
        folder=root / f"s{number}",
        inputs={"number": number},
        make=partial(write_square, number),
    )


def killed_job(root: Path, times: int) -> Task:
    diary = root.parent / "diary"
    diary.mkdir()
    return Task(
        "killed", root / "killed", inputs={"killed": times}, make=partial(be_killed, times, diary)
    )


def contents(root: Path) -> dict[str, bytes]:
    return {
        file.relative_to(root).as_posix(): file.read_bytes()
        for file in root.rglob("*")
        if file.is_file()
    }


@pytest.fixture
def dask_or_skip(request):
    if "engine" in request.fixturenames and request.getfixturevalue("engine").engine == "dask":
        pytest.importorskip("ggvs_eval.contrib.cluster")
        pytest.importorskip("distributed")


@pytest.fixture
def hasty_dask(dask_or_skip):
    """As on a busy machine a worker that has died is not back before dask takes it for lost."""
    dask = pytest.importorskip("dask")
    with dask.config.set({"distributed.deploy.lost-worker-timeout": "500ms"}):
        yield


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES, ids=["processes", "dask"])
def test_every_engine_gives_the_same_files(engine, dask_or_skip, tmp_path):
    """Byte for byte what one process writes, and nothing twice."""
    for name, where in (("serial", 1), ("parallel", engine)):
        assert (
            run_tasks([square_job(tmp_path / name, number) for number in range(5)], where, "") == 5
        )

    assert contents(tmp_path / "parallel") == contents(tmp_path / "serial")
    assert (
        run_tasks([square_job(tmp_path / "parallel", number) for number in range(5)], engine, "")
        == 0
    )


@pytest.mark.slow
@pytest.mark.parametrize("engine", ENGINES, ids=["processes", "dask"])
def test_a_killed_worker_costs_no_result(engine, dask_or_skip, tmp_path):
    """A job whose process is killed is done again, the others are done once, and nothing half is
    left.
    """
    root = tmp_path / "root"

    attempt = attempt_tasks(
        [killed_job(root, 1), *(square_job(root, number) for number in range(6))], engine, ""
    )

    assert (attempt.n_done, attempt.failures) == (7, ())
    assert (root / "killed" / "square.txt").read_text() == "9"
    assert sorted(item.name for item in root.iterdir()) == [
        "killed",
        *(f"s{number}" for number in range(6)),
    ]


@pytest.mark.slow
@pytest.mark.parametrize("engine", DASK_AS_PROOF, ids=["processes", "dask"])
def test_a_job_that_kills_every_worker_is_given_up(engine, hasty_dask, tmp_path):
    """It is named with a reason; those beside it, whose processes it took along, are done, and lost
    workers are replaced.
    """
    root = tmp_path / "root"

    attempt = attempt_tasks(
        [killed_job(root, 99), *(square_job(root, number) for number in range(3))], engine, ""
    )

    assert attempt.n_done == 3
    assert [failure.name for failure in attempt.failures] == ["killed"]
    assert "memory" in attempt.failures[0].message
    # What the last process to be killed leaves unfinished, the next command sweeps.
    assert sorted(item.name for item in root.iterdir() if not item.name.startswith(".")) == [
        "s0",
        "s1",
        "s2",
    ]


def note_process(number: int, folder: Path) -> dict:
    (folder / "process.txt").write_text(str(os.getpid()))
    time.sleep(0.2)  # so that no process does it all
    return {"number": number}


def processes_of(root: Path, names: range) -> set[str]:
    """Run a job per name; the processes that did them."""
    jobs = [
        Task(str(name), root / str(name), inputs={"name": name}, make=partial(note_process, name))
        for name in names
    ]
    run_tasks(jobs, 2, "")
    return {(made.folder / "process.txt").read_text() for made in jobs}


@pytest.mark.slow
def test_stages_can_share_their_processes(tmp_path):
    """Inside the block two stages have the same processes, before and after it others, and none
    outlives it.
    """
    before = processes_of(tmp_path, range(4))
    with kept_workers():
        first = processes_of(tmp_path, range(4, 8))
        with kept_workers():
            second = processes_of(tmp_path, range(8, 12))
    after = processes_of(tmp_path, range(12, 16))

    assert first == second
    assert len(first) == 2
    assert not (before & first)
    assert not (first & after)
    assert not any(Path(f"/proc/{pid}").exists() for pid in first)


@pytest.mark.slow
def test_kept_processes_that_die_are_replaced(tmp_path):
    """A killed worker costs no result of its stage, and the next stage has workers too."""
    with kept_workers():
        attempt = attempt_tasks(
            [killed_job(tmp_path / "root", 1), square_job(tmp_path / "root", 1)], 2, ""
        )
        assert (attempt.n_done, attempt.failures) == (2, ())
        assert len(processes_of(tmp_path, range(4))) == 2


@pytest.mark.parametrize(("running", "fits"), [(2, True), (3, False)])
def test_a_job_waits_for_memory(running, fits, monkeypatch):
    """Jobs that need 300 MB, of which those that run hold 600 MB by now, and 300 MB are free: 3
    fit, a fourth does not.
    """
    monkeypatch.setattr(machine, "available_bytes", lambda: 300e6)
    monkeypatch.setattr(machine, "resident_bytes", lambda pids: (600e6, 300e6))

    assert machine.has_room(running, []) == fits


def test_the_memory_of_a_container_is_its_own(tmp_path):
    """Of 1000 MB 850 are taken, 150 by files that can go; without a container the machine counts; a
    dead process holds none.
    """
    files = {"memory.max": 1000e6, "memory.current": 850e6}
    for name, value in files.items():
        (tmp_path / name).write_text(f"{value:.0f}\n")
    (tmp_path / "memory.stat").write_text("anon 1\ninactive_file 150000000\n")
    (tmp_path / "meminfo").write_text("MemTotal: 9000000 kB\nMemAvailable: 8000000 kB\n")

    available = machine.available_bytes(tmp_path / "meminfo", tmp_path)

    assert available == 300e6
    assert machine.available_bytes(tmp_path / "meminfo", tmp_path / "no-groups") == 8000000 * 1024
    assert machine.available_bytes(tmp_path / "none", tmp_path / "none") == float("inf")
    now, most = machine.resident_bytes([os.getpid()])

    assert 1e6 < now <= most
    assert machine.resident_bytes([2**22 + 1]) == (0, 0)


def test_options_that_contradict_each_other_are_refused(tmp_path, monkeypatch):
    """One line says what to change, or what to install; nothing has begun."""
    monkeypatch.setitem(sys.modules, "distributed", None)
    wishes = {
        Engine(0): "at least 1",
        Engine(2, scheduler="tcp://host:8786"): "wanted --engine dask with it",
        Engine(1, "dask"): r"pip install ggvs-eval\[cluster\]",
    }
    for engine, message in wishes.items():
        with pytest.raises(RenderError, match=message):
            run_tasks([square_job(tmp_path, 1)], engine, "")
    assert list(tmp_path.iterdir()) == []


UNGUARDED = """
import math
from ggvs_eval.jobs.engine import Engine
from ggvs_eval.jobs.engine import run_all

run_all(math.sqrt, [1.0, 2.0, 3.0], Engine(2, {engine!r}), "roots")
"""


@pytest.mark.slow
@pytest.mark.parametrize("engine", DASK_AS_PROOF, ids=["processes", "dask"])
def test_workers_that_cannot_start_are_not_out_of_memory(engine, dask_or_skip, tmp_path):
    """A script that starts processes at its top level learns why they died, and what to write
    instead.
    """
    script = tmp_path / "script.py"
    script.write_text(UNGUARDED.format(engine=engine.engine))
    ended = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300)
    # Python may warn of semaphores after it
    last = [line for line in ended.stderr.splitlines() if "cannot start" in line][-1]
    assert ended.returncode == 1
    assert "memory" not in last
    assert '`if __name__ == "__main__":`' in last
    if engine.engine == "processes":
        assert "finished its bootstrapping phase" in last


def give_up(number: int, folder: Path) -> dict:
    """End as a library does that calls exit()."""
    if number == 0:
        print("licence not found", file=sys.stderr, flush=True)
        os._exit(3)
    return write_square(number, folder)


@pytest.mark.slow
def test_a_process_that_ends_by_itself_says_its_last_line(tmp_path):
    """Its status and what it printed last, not that it may need more memory; the other jobs are
    done.
    """
    jobs = [
        Task(f"{n}", tmp_path / f"s{n}", inputs={"number": n}, make=partial(give_up, n))
        for n in range(3)
    ]
    attempt = attempt_tasks(jobs, 2, "")
    (failure,) = attempt.failures
    assert attempt.n_done == 2
    assert "status 3" in failure.message
    assert "licence not found" in failure.message
    assert "memory" not in failure.message


@pytest.mark.slow
def test_peak_memory_is_of_the_block_alone():
    """What a block holds for a moment counts, what was held before it does not, and a system that
    tells nothing gives nothing.
    """
    before = np.ones(40_000_000)  # 320 MB
    del before
    with machine.PeakMemory() as idle:
        pass
    with machine.PeakMemory() as busy:
        held = np.ones(40_000_000)
        time.sleep(3 * machine.SAMPLED_EVERY_S)
        del held

    assert idle.bytes is not None
    assert busy.bytes is not None
    assert busy.bytes - idle.bytes > 250e6
    with machine.PeakMemory(Path("/nowhere")) as unknown:
        pass
    assert unknown.bytes is None


def test_the_command_line_names_no_script(monkeypatch):
    """Where workers cannot start, `ggvs-eval` says what its caller can change; a script learns of
    its guard.
    """
    main = sys.modules["__main__"]
    for file, remedy in (
        ("/usr/bin/ggvs-eval", "fewer --jobs"),
        ("mine.py", "__name__"),
        (None, "__name__"),
    ):
        monkeypatch.setattr(main, "__file__", file, raising=False)
        assert remedy in start_remedy()


@pytest.mark.parametrize("reason", [errno.EACCES, errno.EMFILE])
def test_without_semaphores_one_process_does_all(reason, monkeypatch, tmp_path, capsys):
    """Jobs are done in this process and a line says so; too many open files, which fewer processes
    mend, are an error.
    """

    def refuse(*_: object, **__: object) -> None:
        raise OSError(reason, os.strerror(reason))

    monkeypatch.setattr(synchronize.SemLock, "__init__", refuse)
    jobs = [square_job(tmp_path, number) for number in range(3)]
    if reason == errno.EMFILE:
        with pytest.raises(OSError, match="Too many open files"):
            attempt_tasks(jobs, 2, "")
        return

    attempt = attempt_tasks([*jobs, Task("n", tmp_path / "n", inputs={}, make=fail_here)], 2, "")

    assert attempt.n_done == 3
    assert all(made.is_done() for made in jobs)
    assert "not here" in str(attempt.failures[0])
    assert "running in one process" in capsys.readouterr().err


def fail_here(_: Path) -> dict:
    raise RenderError("cam00 is not here")
