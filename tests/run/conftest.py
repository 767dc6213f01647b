"""What tests of runs share."""

from collections.abc import Iterator

import pytest

from ggvs_eval.jobs import machine


@pytest.fixture(scope="module", autouse=True)
def _known_pace() -> Iterator[None]:
    """Work takes here what it takes on the reference machine: to find that out takes a second of a core in every process."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(machine, "probe_s", lambda: machine.REFERENCE_S)
        machine.pace.cache_clear()
        yield
        machine.pace.cache_clear()
