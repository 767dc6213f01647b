"""Fixtures that several test files share, where each test belongs, and how long it may take.

Folders mirror those of the package; what tests build on is the package `helpers`. Both work in the
checkout and beside an installed wheel.

A test has one home. Without a marker it is of ``make test``; ``pytest.mark.slow`` puts it into
``make test-all`` and ``pytest.mark.proof`` into ``make validate``. A test of ``make test`` that
takes more than a second of a core is listed at the end, and so is one that is the first to use a
shared fixture of more than two, and a slow test beyond fifteen; one that takes twice as long fails
(`helpers.time_limits`).
"""

import gc
import os
import shutil
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    from ggvs_eval.jobs.processes import share_cpus
    from ggvs_eval.kernels import usable_cpus

    # More threads than cores wait for one another at full speed: a network's step took ten times as
    # long.
    share_cpus(max(usable_cpus() // int(os.environ["PYTEST_XDIST_WORKER_COUNT"]), 1))

MARKERS = {
    "slow": "takes over half a second of a core: `make test-all` runs these",
    "proof": "whole runs, films and trainings that repeat what other tests show in parts: `make "
    "validate` runs these",
    "page": "opens a page in a real browser",
    "fuzz": "reads hundreds of damaged files",
    "gpu": "wants a GPU",
    "wheel": "looks at the installed package: `make wheel-test` runs these",
}


def pytest_addoption(parser: pytest.Parser) -> None:
    """Let ``--room online`` choose the tests of a room and of the rooms that import it."""
    parser.addoption(
        "--room",
        default="",
        help="run the tests of this room of the package and of the rooms that import it",
    )


def pytest_configure(config: pytest.Config) -> None:
    """Make the markers known; here and not in setup.cfg, which lies in the checkout alone."""
    from helpers.time_limits import TimeLimits

    for name, meaning in MARKERS.items():
        config.addinivalue_line("markers", f"{name}: {meaning}")
    config.pluginmanager.register(TimeLimits(), "time_limits")


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """Leave out files that use neither the room that is asked for nor one that imports it."""
    room = config.getoption("--room")
    if not room or not collection_path.match("test_*.py"):
        return None
    from helpers.import_graph import imports_of_test, rooms_that_use

    return None if imports_of_test(collection_path) & rooms_that_use(room) else True


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Let the garbage collector rest, and pass over what is collected ever after: walking through
    it took a third of the time.
    """
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what opens a browser."""
    for item in items:
        if "started" in getattr(item, "fixturenames", ()):
            item.add_marker("page")


@pytest.hookimpl(specname="pytest_collection_modifyitems", trylast=True)
def pytest_long_files_first(items: list[pytest.Item]) -> None:
    """Begin with the files that take long, in their random order: none is left for one process at
    the end.
    """
    long = {
        item.path
        for item in items
        if item.get_closest_marker("slow") or "whole_run" in getattr(item, "fixturenames", ())
    }
    items.sort(key=lambda item: item.path not in long)


@pytest.fixture(scope="session")
def shared_folder(tmp_path_factory) -> Path:
    """A folder that all processes of this session share."""
    base = tmp_path_factory.getbasetemp()
    folder = (base.parent if "PYTEST_XDIST_WORKER" in os.environ else base) / "shared"
    folder.mkdir(exist_ok=True)
    return folder


@pytest.fixture(scope="session", autouse=True)
def _rooms_lit_once(shared_folder) -> Iterator[None]:
    """Procedural rooms are lit once in a session, not once in every process that films them."""
    from ggvs_eval.contrib.worlds.film import film
    from helpers.lit_rooms import stored_rooms

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(film, "_lit_room", stored_rooms(shared_folder))
        yield


@pytest.fixture(scope="session", autouse=True)
def _known_pace() -> Iterator[None]:
    """Work takes here what it takes on the reference machine: to find that out takes a second of a
    core in every process.
    """
    from ggvs_eval.jobs import machine

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "probe_s", lambda: machine.REFERENCE_S)
        machine.pace.cache_clear()
        yield
        machine.pace.cache_clear()


@pytest.fixture(scope="session")
def quick_demo(shared_folder) -> Path:
    """What `ggvs-eval demo --quick` unpacks, once for all processes; nobody changes it,
    `shutil.copytree` it.
    """
    from ggvs_eval.files.atomic import locked
    from ggvs_eval.synthetic.shipped import write_quick

    folder = shared_folder / "quick"
    with locked(folder.with_name("quick.lock")):
        return folder if folder.is_dir() else write_quick(folder)


@pytest.fixture(scope="session")
def whole_run(shared_folder) -> Path:
    """A finished run with its page, once for all processes; nobody changes it, `copy_of` it."""
    from ggvs_eval.files.atomic import locked
    from helpers.whole_run import make_whole_run

    folder = shared_folder / "whole"
    with locked(folder.with_name("whole.lock")):
        return folder / "run" if folder.is_dir() else make_whole_run(folder)


@pytest.fixture(scope="module")
def no_figures() -> Iterator[None]:
    """A module's reports are written without what takes longer than all else of them."""
    from helpers.small_runs import leave_out_figures

    with pytest.MonkeyPatch.context() as patch:
        leave_out_figures(patch)
        yield


@pytest.fixture(scope="session")
def written_dynerf(tmp_path_factory) -> Path:
    """A tiny capture in DyNeRF's layout; nobody changes it."""
    from helpers.captures import write_dynerf

    return write_dynerf(tmp_path_factory.mktemp("captures") / "room")


@pytest.fixture
def dynerf(written_dynerf, tmp_path) -> Path:
    """An intact capture to read or to damage."""
    return Path(shutil.copytree(written_dynerf, tmp_path / "room"))


@pytest.fixture
def kernel_settings() -> Iterator[None]:
    """Puts back the number of threads and the instruction set that a test changes."""
    from ggvs_eval import kernels

    threads, level = kernels.get_threads(), kernels.get_simd_level()
    yield
    kernels.set_threads(threads)
    kernels.set_simd_level(level)


@pytest.fixture
def torch_threads() -> Iterator[None]:
    """Puts back torch's number of threads that a test changes; two on one core would slow all that
    follow.
    """
    import torch

    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def started():
    """One real browser for all tests that share a process."""
    from helpers.browser import open_browser

    with open_browser() as browser:
        yield browser


@pytest.fixture(scope="session")
def painted(shared_folder) -> Path:
    """A page whose pictures say what they are of, once for all processes; nobody changes it."""
    from ggvs_eval.files.atomic import locked
    from helpers.painted_page import write_painted_page

    page = shared_folder / "painted" / "index.html"
    with locked(page.parent.with_name("painted.lock")):
        return page if page.is_file() else write_painted_page(page.parent)


@pytest.fixture
def shown(started, painted):
    """The painted page, freshly opened at desktop width; a test that makes it complain fails."""
    started.visit(painted)
    yield started
    assert started.complaints() == []
