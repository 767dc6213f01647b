"""When another job may begin beside those that run."""

import pytest

from ggvs_eval.jobs import engine, machine


@pytest.mark.parametrize(("running", "fits"), [(0, True), (1, True), (2, False)])
def test_a_job_fits_if_each_may_need_what_the_largest_has_taken(monkeypatch, running, fits):
    """5 GB are free, 6 are held, the largest job holds 4: there is room for two, not for three."""
    monkeypatch.setattr(machine, "resident_bytes", lambda _pids: (6, 4))
    monkeypatch.setattr(machine, "available_bytes", lambda: 5)

    assert machine.has_room(running, []) is fits


@pytest.mark.parametrize(
    ("running", "has_room", "fits"), [(0, False, True), (1, False, False), (3, True, True)]
)
def test_the_first_job_always_runs(monkeypatch, running, has_room, fits):
    """Without room for it there is none for any job; all others wait for room."""
    monkeypatch.setattr(engine, "has_room", lambda _running, _pids: has_room)

    assert engine._fits(running) is fits
