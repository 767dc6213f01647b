"""The faults of `make worth` can still be planted: each names one line of the package as it is."""

import ast

import pytest

from benchmarks.worth_of_tests import read_faults
from helpers.places import ROOT

FAULTS = read_faults()


@pytest.mark.parametrize("fault", FAULTS, ids=lambda fault: fault.name)
def test_a_fault_can_be_planted(fault, tmp_path):
    """Its line is there once, the replacement is Python and another line, and its tests exist."""
    copy = tmp_path / fault.file
    copy.parent.mkdir(parents=True)
    copy.write_bytes((ROOT / fault.file).read_bytes())
    fault.plant(tmp_path)

    assert ast.dump(ast.parse(copy.read_text("utf-8"))) != ast.dump(
        ast.parse((ROOT / fault.file).read_text("utf-8"))
    )
    assert (ROOT / fault.nearest).exists()


def test_faults_are_of_all_rooms():
    """At least thirty, of twenty rooms and more, no name twice."""
    assert len({fault.name for fault in FAULTS}) == len(FAULTS) >= 30
    assert len({fault.file.rpartition("/")[0] for fault in FAULTS}) >= 20
