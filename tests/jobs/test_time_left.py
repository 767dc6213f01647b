"""The status of a stage: what is done, runs and waits, and how long the rest takes at the pace so far."""

import os
from types import SimpleNamespace

import pytest

from ggvs_eval.jobs import ledger as ledger_module
from ggvs_eval.jobs.ledger import Entry, Ledger, read_status
from ggvs_eval.run_folder import JOB_FILE, write_json


def test_time_left_is_that_of_the_running_and_the_waiting_jobs(tmp_path, monkeypatch):
    """One job of four in 30 s: one runs, two wait, 90 s are left."""
    clock = SimpleNamespace(now_s=1000.0)
    monkeypatch.setattr(ledger_module, "time", SimpleNamespace(time=lambda: clock.now_s))
    entries = [Entry(f"job {number}", tmp_path / "renders" / f"job{number}", f"{number}") for number in range(4)]
    Ledger(tmp_path, "render").write(entries)
    write_json(entries[0].folder / JOB_FILE, {"sha256": "0"})
    os.utime(entries[0].folder / JOB_FILE, (1010, 1010))
    host = os.uname().nodename.replace(".", "-")
    (tmp_path / "renders" / f".job1.{host}.{os.getpid()}.tmp").mkdir()
    clock.now_s = 1030.0

    (stage,) = read_status(tmp_path)

    assert (stage.done, stage.in_hand, stage.missing) == (1, ("job 1",), ("job 2", "job 3"))
    assert stage.left_s == pytest.approx(90)
