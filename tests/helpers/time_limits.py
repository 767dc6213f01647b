"""A plugin of pytest: a test that takes too long is listed, one that takes twice that fails; ``-p
no:time_limits`` lets it be.

Seconds are processor time of this process and of those that it waited for, on the machine that
`REFERENCE_S` was measured on; a slower or busier machine is given as much more as the work of
`_slowness` takes on it at that moment. The same test takes up to 1.6 times as long beside others,
by caches and clocks that no such factor knows: so a limit that is just missed refuses nothing.
"""

import os
import statistics
import sys
import time
from collections.abc import Iterator

import pytest

# of a test with the fixtures that are its own, by marker; proofs may take any time
MOST_S = {"slow": 15.0, "wheel": 30.0}
MOST_OTHER_S = 1.0
MOST_SHARED_S = {"whole_run": 20.0}  # of a fixture that tests share, by name
MOST_OTHER_SHARED_S = 2.0
REFERENCE_S = 0.035
IMPORT_S = 0.003  # of a module that a test is the first to need
REFUSED_FROM = 2.0  # times the limit
LONG = "took too long"  # property of a report


class TimeLimits:
    """Counts the seconds of a test, and apart from them those of the shared fixtures that it
    happens to be the first to need.
    """

    def __init__(self) -> None:
        self._began_s = 0.0
        # that were set up for the running test: seconds of their own
        self._fixtures: dict[str, float] = {}

    @pytest.hookimpl(wrapper=True)
    def pytest_fixture_setup(self, fixturedef: pytest.FixtureDef[object]) -> Iterator[object]:
        """Count a shared fixture, without the others that it needs."""
        if fixturedef.scope == "function":
            return (yield)
        began_s, inner_s = _used_s(), sum(self._fixtures.values())
        try:
            return (yield)
        finally:
            of_others_s = sum(self._fixtures.values()) - inner_s
            self._fixtures[fixturedef.argname] = _used_s() - began_s - of_others_s

    @pytest.hookimpl(wrapper=True, tryfirst=True)
    def pytest_runtest_setup(self, item: pytest.Item) -> Iterator[None]:
        """Begin to count."""
        self._began_s = _used_s()
        self._fixtures.clear()
        return (yield)

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self, item: pytest.Item) -> Iterator[None]:
        """Judge a test by its time, and a fixture by the name of its first test."""
        result = yield
        if not item.get_closest_marker("proof"):
            own_s = _used_s() - self._began_s - sum(self._fixtures.values())
            marked_s = [
                seconds for marker, seconds in MOST_S.items() if item.get_closest_marker(marker)
            ]
            _judge(item, item.nodeid, own_s, max(marked_s, default=MOST_OTHER_S))
            for name, seconds in () if marked_s else self._fixtures.items():
                most_s = MOST_SHARED_S.get(name, MOST_OTHER_SHARED_S)
                _judge(item, f"fixture {name} of {item.nodeid}", seconds, most_s)
        return result

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        """List what took longer than wanted."""
        for report in terminalreporter.getreports("passed"):
            for name, text in report.user_properties:
                if name == LONG and report.when == "call":
                    terminalreporter.write_line(str(text))


def _judge(item: pytest.Item, name: str, used_s: float, most_s: float) -> None:
    """Note a time above the limit for the end of the report, which other processes write; fail far
    above it.
    """
    if used_s <= most_s or used_s <= most_s * (slowness := _slowness()):
        return
    message = (
        f"{name} took {used_s:.1f} s of a core, wanted {most_s:g} at most; do less, or mark it slow"
    )
    if used_s > REFUSED_FROM * most_s * slowness:
        pytest.fail(message, pytrace=False)
    item.user_properties.append((LONG, message))


def _used_s() -> float:
    """Processor time so far, but for imports and for light of procedural rooms, which many tests
    share.
    """
    from helpers import lit_rooms

    return sum(os.times()[:4]) - lit_rooms.lit_s - IMPORT_S * len(sys.modules)


def _slowness() -> float:
    """By which factor this machine is slower now than the one that limits are meant for, at least
    1.
    """
    import numpy as np

    def work_s() -> float:
        start_s = time.process_time()
        np.sort(np.random.default_rng(0).normal(size=400_000))
        sum(number * number for number in range(200_000))
        return time.process_time() - start_s

    return max(1.0, statistics.median(work_s() for _ in range(7)) / REFERENCE_S)
