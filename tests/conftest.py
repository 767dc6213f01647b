"""Fixtures that several test files share, and how tests find each other.

Folders mirror those of the package; what tests build on is the package `helpers`. Both work in the checkout and beside an
installed wheel.

Files or tests that take long say ``pytestmark = pytest.mark.slow``, those that throw damaged files ``pytest.mark.fuzz``; what
opens a browser is `page` by itself, and all others are `quick`, for ``make test-quick``. ``pytest.mark.proof`` does whole, in
half a minute, what others test in parts: ``make test`` leaves it to ``make validate``. Any other test that takes more than
`MOST_S` of a core, and fixtures four times as much, is named in a warning; ``pytest.mark.takes(12)`` allows a test more. With
``GGVS_LONG_TESTS=fail`` such a test fails. It is not the default: on a machine that others share, a sound test was counted three
times its time, and proofs of the code must not hang on that.
"""

import gc
import os
import shutil
import statistics
import sys
import time
import warnings
from collections.abc import Iterator
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

if "PYTEST_XDIST_WORKER_COUNT" in os.environ:
    from ggvs_eval.jobs.processes import share_cpus
    from ggvs_eval.kernels import usable_cpus

    # More threads than cores wait for one another at full speed: a network's step took ten times as long.
    share_cpus(max(usable_cpus() // int(os.environ["PYTEST_XDIST_WORKER_COUNT"]), 1))

MARKERS = {
    "quick": "none of the others; `make test-quick` runs these",
    "slow": "takes seconds of a core: whole runs, rooms, networks, other processes",
    "proof": "whole runs, films and trainings that repeat what other tests show in parts: `make validate` runs these",
    "page": "opens a page in a real browser",
    "fuzz": "reads hundreds of damaged files",
    "gpu": "wants a GPU",
}
TAKES = "takes(seconds): may take so many seconds of a core"
# Of processor time, which a busy machine prolongs less, on a machine that does the work of `_slowness` in so many seconds.
MOST_S, REFERENCE_S = 5.0, 0.035
IMPORT_S = 0.003  # of a module that a test is the first to need


def pytest_configure(config: pytest.Config) -> None:
    """Make the markers known; here and not in setup.cfg, which lies in the checkout alone."""
    for name, meaning in MARKERS.items():
        config.addinivalue_line("markers", f"{name}: {meaning}")
    config.addinivalue_line("markers", TAKES)


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[object]:
    """Let the garbage collector rest, and pass over what is collected ever after: walking through it took a third of the time."""
    gc.disable()
    try:
        return (yield)
    finally:
        gc.freeze()
        gc.enable()


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Mark what opens a browser, and as quick what bears no other marker."""
    for item in items:
        if "started" in getattr(item, "fixturenames", ()):
            item.add_marker("page")
        if not any(item.get_closest_marker(name) for name in MARKERS):
            item.add_marker("quick")


@pytest.hookimpl(specname="pytest_collection_modifyitems", trylast=True)
def pytest_slow_files_first(items: list[pytest.Item]) -> None:
    """Begin with the files that take long, in their random order: none is left for one process at the end."""
    slow = {item.path for item in items if item.get_closest_marker("slow")}
    items.sort(key=lambda item: item.path not in slow)


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_setup(item: pytest.Item) -> Iterator[None]:
    """Name fixtures that take long, which others may share."""
    began = _used_s(), len(sys.modules)
    result = yield
    _name_long(item, "its fixtures", began, 4 * _most_s(item))
    return result


@pytest.hookimpl(wrapper=True)
def pytest_runtest_call(item: pytest.Item) -> Iterator[None]:
    """Name a test that takes long."""
    began = _used_s(), len(sys.modules)
    result = yield
    _name_long(item, "it", began, _most_s(item))
    return result


def _most_s(item: pytest.Item) -> float:
    takes = item.get_closest_marker("takes")
    return float(takes.args[0]) if takes else MOST_S


def _name_long(item: pytest.Item, what: str, began: tuple[float, int], most_s: float) -> None:
    used_s = _used_s() - began[0] - IMPORT_S * (len(sys.modules) - began[1])
    if used_s > most_s and not item.get_closest_marker("proof") and used_s > most_s * _slowness():
        words = f"{item.nodeid}: {what} took {used_s:.1f} s of a core, wanted {most_s:g} at most; do less"
        if os.environ.get("GGVS_LONG_TESTS") == "fail":
            pytest.fail(words, pytrace=False)
        warnings.warn_explicit(words, pytest.PytestWarning, str(item.path), 1)


def _used_s() -> float:
    """Processor time of this process and of those that it waited for, but for light that many tests share."""
    from helpers import lit_rooms

    return sum(os.times()[:4]) - lit_rooms.lit_s


def _slowness() -> float:
    """By which factor this machine is slower now than the one that limits are meant for, at least 1."""
    import numpy as np

    def work_s() -> float:
        start = time.process_time()
        np.sort(np.random.default_rng(0).normal(size=400_000))
        sum(number * number for number in range(200_000))
        return time.process_time() - start

    return max(1.0, statistics.median(work_s() for _ in range(7)) / REFERENCE_S)


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


@pytest.fixture(scope="session")
def quick_demo(shared_folder) -> Path:
    """What `ggvs-eval demo --quick` unpacks, once for all processes; nobody changes it, `shutil.copytree` it."""
    from ggvs_eval.files.atomic import locked
    from ggvs_eval.synthetic.shipped import write_quick

    folder = shared_folder / "quick"
    with locked(folder.with_name("quick.lock")):
        return folder if folder.is_dir() else write_quick(folder)


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
    """Puts back torch's number of threads that a test changes; two on one core would slow all that follow."""
    import torch

    threads = torch.get_num_threads()
    yield
    torch.set_num_threads(threads)


@pytest.fixture(scope="session")
def started(tmp_path_factory):
    """One real browser for all tests that share a process."""
    from helpers.browser import open_browser

    with open_browser(tmp_path_factory.mktemp("browser")) as browser:
        yield browser


@pytest.fixture(scope="session")
def painted(tmp_path_factory) -> Path:
    """A page whose pictures say what they are of; nobody changes it."""
    from helpers.painted_page import write_painted_page

    return write_painted_page(tmp_path_factory.mktemp("painted"))


@pytest.fixture
def shown(started, painted):
    """The painted page, freshly opened at desktop width; a test that makes it complain fails."""
    started.visit(painted)
    yield started
    assert started.complaints() == []
