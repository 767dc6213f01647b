"""Preparing and measuring a run on every engine: frames, depth, masks, path and ceilings are the
same bytes.
"""

import dataclasses
import os
import signal
import time
from functools import partial
from pathlib import Path

import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.jobs.engine import Engine, run_all
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run
from ggvs_eval.protocol import Protocol
from helpers.small_runs import LABELS, small_protocol, write_small_capture

ENGINES = [Engine(2), Engine(2, "dask")]
CLOCKED = {"job.json", "results.json", "references.json"}  # hold times or hosts beside the results


@pytest.fixture(scope="module")
def demo_capture(tmp_path_factory):
    return write_small_capture(tmp_path_factory.mktemp("capture") / "demo", 3)


@pytest.fixture(scope="module")
def protocol() -> Protocol:
    """Everything that a run can have: masks, a path, ceilings."""
    protocol = small_protocol(3, 3, ("PSNR", "L1", "TCC", "PSNR_disoccluded"))
    return dataclasses.replace(
        protocol, measurement=dataclasses.replace(protocol.measurement, ceilings=True)
    )


@pytest.fixture(scope="module")
def serial(demo_capture, protocol, tmp_path_factory) -> Path:
    """The run in one process."""
    root = tmp_path_factory.mktemp("serial") / "run"
    measure(plan_run(RunRequest(root, demo_capture, protocol, LABELS[:1])), 1)
    return root


def contents(root: Path) -> dict[str, bytes]:
    """Files of a run but those that note times."""
    files = (file for file in root.rglob("*") if file.is_file() and file.name not in CLOCKED)
    return {
        file.relative_to(root).as_posix(): file.read_bytes()
        for file in files
        if "jobs" not in file.parts
    }


@pytest.mark.proof
@pytest.mark.parametrize("engine", ENGINES, ids=["processes", "dask"])
def test_a_whole_run_is_the_same_on_every_engine(engine, serial, demo_capture, protocol, tmp_path):
    """Truth, depth, masks, renders, path and table are byte for byte those of one process; so are
    ceilings and path scores.
    """
    if engine.engine == "dask":
        pytest.importorskip("distributed")

    measure(plan_run(RunRequest(tmp_path / "run", demo_capture, protocol, LABELS[:1])), engine)

    expected, found = contents(serial), contents(tmp_path / "run")
    assert {"truth", "depth", "disoccluded", "path_depth", "renders", "path"} <= {
        name.split("/")[0] for name in expected
    }
    assert set(found) == set(expected)
    assert [name for name in expected if found[name] != expected[name]] == []
    assert (tmp_path / "run" / "references.json").read_bytes() == (
        serial / "references.json"
    ).read_bytes()


def note_who(diary: Path, number: int) -> None:
    """Say which process does the work; the third item kills its first one, as the kernel does when
    memory is out.
    """
    if number == 3 and not (diary / "death").exists():
        (diary / "death").touch()
        time.sleep(0.3)  # others are in hand then
        os.kill(os.getpid(), signal.SIGKILL)
    (diary / f"{number}").write_text(str(os.getpid()))


@pytest.mark.slow
@pytest.mark.parametrize(
    "engine",
    [Engine(2), pytest.param(Engine(2, "dask"), marks=pytest.mark.proof)],
    ids=["processes", "dask"],
)
def test_the_work_is_done_elsewhere_and_survives_a_kill(engine, tmp_path):
    """Every item is done by a worker and none by this process, though one of the workers is
    killed.
    """
    if engine.engine == "dask":
        pytest.importorskip("distributed")

    run_all(partial(note_who, tmp_path), range(6), engine, "noting")

    workers = [(tmp_path / f"{number}").read_text() for number in range(6)]
    assert str(os.getpid()) not in workers
    assert (tmp_path / "death").exists()


def refuse(number: int) -> None:
    """Fail as work does that a user can mend."""
    raise RenderError(f"item {number} cannot be done")


@pytest.mark.parametrize("workers", [1, pytest.param(2, marks=pytest.mark.slow)])
def test_what_the_work_raises_comes_through(workers):
    """The error of the first item that fails is raised as it is; no items are no work."""
    with pytest.raises(RenderError, match=r"item [0-2] cannot be done"):
        run_all(refuse, range(3), workers, "refusing")
    run_all(refuse, [], workers, "refusing")
