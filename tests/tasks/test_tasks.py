"""Tasks: made once, whole or not at all, and a failure stops nothing but itself."""

import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from ggvs_eval.errors import CaptureError, RenderError
from ggvs_eval.files.atomic import is_running
from ggvs_eval.run_folder import JOB_FILE, read_json
from ggvs_eval.tasks.run_tasks import BrokenTaskError, attempt_tasks, run_tasks
from ggvs_eval.tasks.task import Task
from ggvs_eval.tasks.task_list import TaskList
from helpers.refusals import refused

ONE_OR_TWO = [1, pytest.param(2, marks=pytest.mark.slow)]


def write_number(number: int, folder: Path) -> dict:
    (folder / "number.txt").write_text(str(number))
    return {"double": 2 * number}


def fail(message: str, folder: Path) -> dict:
    (folder / "half.txt").write_text("half")
    raise CaptureError(message)


def stumble(folder: Path) -> dict:
    return {"value": {}["absent"]}


def wait_for(condition: Callable[[], Any], seconds: float = 60) -> Any:
    deadline = time.monotonic() + seconds
    while not (found := condition()) and time.monotonic() < deadline:
        time.sleep(0.02)
    return found


def number_job(root: Path, number: int) -> Task:
    return Task(
        name=f"number {number}",
        folder=root / f"n{number}",
        inputs={"number": number},
        make=partial(write_number, number),
    )


@pytest.mark.parametrize("workers", ONE_OR_TWO)
def test_a_job_runs_once(workers, tmp_path):
    """The second call finds every result and runs nothing, the record lies beside it; another
    identity replaces it.
    """
    jobs = [number_job(tmp_path, number) for number in range(3)]

    first, second = run_tasks(jobs, workers, ""), run_tasks(jobs, workers, "")

    assert (first, second) == (3, 0)
    assert read_json(tmp_path / "n2" / JOB_FILE)["double"] == 4
    assert sorted(item.name for item in tmp_path.iterdir()) == ["n0", "n1", "n2"]
    again = Task(
        name="number 2", folder=tmp_path / "n2", inputs={"number": 5}, make=partial(write_number, 5)
    )  # another identity in its place
    assert run_tasks([again], workers, "") == 1
    assert (tmp_path / "n2" / "number.txt").read_text() == "5"


@pytest.mark.parametrize("workers", ONE_OR_TWO)
def test_a_failed_job_leaves_nothing_and_stops_nobody(workers, tmp_path):
    """The others finish, the failed one leaves no folder, and one error lists what failed."""
    broken = [
        Task(
            f"broken {i}",
            tmp_path / f"b{i}",
            inputs={"broken": i},
            make=partial(fail, f"cam{i:02d} is gone"),
        )
        for i in range(2)
    ]

    with refused(RenderError, "2 of 4", "cam00 is gone", "cam01 is gone"):
        run_tasks(
            [broken[0], number_job(tmp_path, 1), broken[1], number_job(tmp_path, 2)], workers, ""
        )

    assert sorted(item.name for item in tmp_path.iterdir()) == ["n1", "n2"]


@pytest.mark.parametrize("workers", ONE_OR_TWO)
def test_a_bug_is_raised_when_the_others_are_done(workers, tmp_path):
    """What is no mistake of the user's comes with its traceback, after all other jobs."""
    jobs = [
        Task("buggy", tmp_path / "b", inputs={"bug": 1}, make=stumble),
        number_job(tmp_path, 1),
        number_job(tmp_path, 2),
    ]

    with pytest.raises(BrokenTaskError, match=r"(?s)buggy: KeyError: 'absent'.*in stumble"):
        run_tasks(jobs, workers, "")

    assert sorted(item.name for item in tmp_path.iterdir()) == ["n1", "n2"]


def test_a_ledger_keeps_why_a_job_failed_until_it_succeeds(tmp_path):
    """The reason lies beside the results; the same job forgets it when it is done, another job in
    its folder never had it.
    """
    ledger = TaskList(tmp_path, "render")
    broken = Task("n", tmp_path / "n", inputs={"number": 1}, make=partial(fail, "cam00 is gone"))
    mended = Task("n", tmp_path / "n", inputs={"number": 1}, make=partial(write_number, 1))
    other = Task("n", tmp_path / "n", inputs={"number": 2}, make=partial(write_number, 2))

    failed = attempt_tasks([broken], 1, "", ledger)
    reasons = [ledger.failure(task.made) for task in (mended, other)]
    attempt_tasks([mended], 1, "", ledger)

    assert failed.n_done == 0
    assert list(failed.failures) == [reasons[0]]
    assert "cam00 is gone" in str(reasons[0])
    assert reasons[1] is None
    assert ledger.failure(mended.made) is None


def test_what_another_process_has_made_meanwhile_stays(tmp_path):
    """Two processes do the same: the result of the first may be in use when the second is ready,
    and is not replaced.
    """
    task, made = number_job(tmp_path, 1), tmp_path / "n1" / "number.txt"
    inodes = []

    def while_the_other_is_faster(folder: Path) -> dict:
        elsewhere = replace(task, folder=tmp_path / "other")
        elsewhere.run()
        elsewhere.folder.rename(task.folder)
        inodes.append(made.stat().st_ino)
        return write_number(1, folder)

    replace(task, make=while_the_other_is_faster).run()

    assert [made.stat().st_ino] == inodes


def test_what_another_process_works_on_is_left_alone(tmp_path):
    """A second run of the same job does not take away the half of one that is under way; the folder
    of a dead one goes.
    """
    job = number_job(tmp_path, 1)
    host = socket.gethostname().replace(".", "-")
    alive, dead = (tmp_path / f".n1.{host}.{pid}.tmp" for pid in (os.getppid(), 4194304000))
    alive.mkdir()
    dead.mkdir()

    run_tasks([job], 1, "")

    assert sorted(item.name for item in tmp_path.iterdir()) == [alive.name, "n1"]


@pytest.mark.slow
def test_workers_die_with_their_parent(tmp_path):
    """After kill -9 of the main process its workers are gone within seconds, in the middle of a job
    or idle.
    """
    script = (
        "import os, sys, time; from pathlib import Path; from ggvs_eval.jobs.processes import "
        "worker_pool\n"
        "if __name__ == '__main__':\n"
        "    with worker_pool(2) as pool:\n"
        "        Path(sys.argv[1], 'pid').write_text(str(pool.submit(os.getpid).result()))\n"
        "        time.sleep(60)\n"
    )
    (tmp_path / "main.py").write_text(script)
    process = subprocess.Popen([sys.executable, str(tmp_path / "main.py"), str(tmp_path)])
    worker = int(wait_for(lambda: (tmp_path / "pid").is_file() and (tmp_path / "pid").read_text()))
    os.kill(process.pid, signal.SIGKILL)
    process.wait()

    assert wait_for(lambda: not is_running(worker))


@pytest.mark.slow
def test_a_killed_run_loses_only_the_job_in_hand(tmp_path):
    """After kill -9 what was finished stays, and the next call runs the rest and cleans up."""
    script = (
        "import sys, time; from functools import partial; from pathlib import Path\n"
        "from ggvs_eval.tasks.run_tasks import run_tasks\n"
        "from ggvs_eval.tasks.task import Task\n"
        "def work(number, folder):\n"
        "    (folder / 'number.txt').write_text(str(number)); time.sleep(60 if number == 1 else "
        "0)\n"
        "    return {}\n"
        "root = Path(sys.argv[1])\n"
        "run_tasks([Task('', root / f'n{n}', inputs={'number': n}, make=partial(work, n)) for n in "
        "range(3)], 1, '')\n"
    )
    process = subprocess.Popen([sys.executable, "-c", script, str(tmp_path)])
    assert wait_for(lambda: list(tmp_path.glob(".n1.*.tmp")))
    os.kill(process.pid, signal.SIGKILL)
    process.wait()

    done = run_tasks([number_job(tmp_path, number) for number in range(3)], 1, "")

    assert done == 2
    assert sorted(item.name for item in tmp_path.iterdir()) == ["n0", "n1", "n2"]
