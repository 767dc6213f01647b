"""A test that takes long fails by name, unless it is a proof or says how long it takes."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

TESTS = """
import time
import pytest


def work(seconds):
    start = time.process_time()
    while time.process_time() < start + seconds:
        pass


@pytest.fixture(scope="module")
def slow_fixture():
    work(2.4)


def test_long(): work(0.7)
def test_short(): pass
def test_near(): work(0.28)
def test_allowed(): work(0.7)
@pytest.mark.proof
def test_proof(): work(0.7)
def test_fixture(slow_fixture): pass
"""


@pytest.mark.slow
@pytest.mark.parametrize(("wish", "counts"), [("", ("6 passed",)), ("fail", ("2 failed", "3 passed", "1 error"))])
def test_a_long_test_is_named(wish, counts, tmp_path):
    """A test and a fixture over the limit are named with their seconds in a warning, and fail where one asks; others pass."""
    here = Path(__file__).parent
    limited = (
        (here / "conftest.py")
        .read_text(encoding="utf-8")
        .replace("MOST_S, REFERENCE_S = 5.0, 0.035", "MOST_S, REFERENCE_S = 0.2, 9.0")
    )
    (tmp_path / "conftest.py").write_text(limited, encoding="utf-8")
    shutil.copytree(here / "helpers", tmp_path / "helpers")
    (tmp_path / "test_them.py").write_text(TESTS)
    command = [
        sys.executable,
        "-m",
        "pytest",
        "-p",
        "no:cacheprovider",
        "-p",
        "no:randomly",
        "-p",
        "no:xdist",
        "-c",
        "/dev/null",
        tmp_path,
    ]
    asked = {**os.environ, "GGVS_LONG_TESTS": wish}
    printed = subprocess.run(command, capture_output=True, text=True, check=False, cwd=tmp_path, env=asked).stdout

    assert all(each in printed for each in counts), printed
    assert ("PytestWarning: " in printed) == (not wish)
    assert "test_near: it took 0.3 s of a core" in printed
    assert "test_long: it took 0.7 s of a core, wanted 0.2 at most" in printed
    assert "test_fixture: its fixtures took 2.4 s of a core, wanted 0.8 at most" in printed
