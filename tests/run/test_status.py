"""The status of a stage: what is done, runs and waits, and how long the rest takes at the pace so
far.
"""

import os

import pytest

from ggvs_eval.pipelines.run.status import read_status
from ggvs_eval.run_folder import JOB_FILE, write_json
from ggvs_eval.tasks.task import Task
from ggvs_eval.tasks.task_list import TaskList


def test_time_left_is_that_of_the_running_and_the_waiting_tasks(tmp_path):
    """One task of four took 30 s: one runs, two wait, 90 s are left."""
    folders = [tmp_path / "renders" / f"task{number}" for number in range(4)]
    tasks = [Task(name=folder.name, folder=folder, inputs={}, kind="render") for folder in folders]
    TaskList(tmp_path, "render").write(tasks)
    write_json(folders[0] / JOB_FILE, {"sha256": tasks[0].sha256, "seconds": 30.0})
    host = os.uname().nodename.replace(".", "-")
    (tmp_path / "renders" / f".task1.{host}.{os.getpid()}.tmp").mkdir()

    (stage,) = read_status(tmp_path)

    assert (stage.n_done, stage.in_hand, stage.missing) == (1, ("task1",), ("task2", "task3"))
    assert stage.left_s == pytest.approx(90)


def test_what_is_made_together_counts_once(tmp_path):
    """Metrics of one view are one entry, which is done when each of them is."""
    folders = [
        tmp_path / "scores" / view / "ours" / metric
        for view in ("cam00", "cam01")
        for metric in ("L1", "PSNR")
    ]
    tasks = [
        Task(name=f"scores of {folder.parts[-3]}", folder=folder, inputs={}, above=2)
        for folder in folders
    ]
    TaskList(tmp_path, "score").write(tasks)
    for folder in folders[:3]:
        write_json(folder / JOB_FILE, {"sha256": tasks[0].sha256})

    (stage,) = read_status(tmp_path)

    assert (stage.n_done, stage.missing) == (1, ("scores of cam01",))
