"""A test that takes long fails by name; a slow one may take fifteen times as long, a proof as long
as it wants.
"""

from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from helpers import time_limits
from helpers.time_limits import TimeLimits


def finish(steps: Iterator[object]) -> None:
    """Go on with a hook after what it waits for."""
    with pytest.raises(StopIteration):
        steps.send(None)


def run(test_s: float, marker: str = "", **fixture_s: float) -> list[str]:
    """Let the limits time a test that takes what is said, on a machine that is half as fast again;
    return what they note.
    """
    limits, clock = TimeLimits(), SimpleNamespace(now_s=0.0)
    item = SimpleNamespace(
        nodeid="test_it", get_closest_marker=lambda name: name == marker or None, user_properties=[]
    )
    with pytest.MonkeyPatch.context() as patch:  # not while the tests of this file are timed
        patch.setattr(time_limits, "_used_s", lambda: clock.now_s)
        patch.setattr(time_limits, "_slowness", lambda: 1.5)
        setup = limits.pytest_runtest_setup(item)
        next(setup)
        for name, seconds in fixture_s.items():
            fixture = limits.pytest_fixture_setup(SimpleNamespace(scope="module", argname=name))
            next(fixture)
            clock.now_s += seconds
            finish(fixture)
        finish(setup)
        call = limits.pytest_runtest_call(item)
        next(call)
        clock.now_s += test_s
        finish(call)
    return [text for _, text in item.user_properties]


@pytest.mark.parametrize(
    ("seconds", "marker"),
    [
        ({}, ""),
        ({"room": 2.9}, ""),
        ({"whole_run": 29.0}, ""),
        ({"room": 99.0}, "slow"),
        ({}, "proof"),
    ],
)
def test_what_a_test_may_take(seconds, marker):
    """A second, fifteen of a slow one; two of a fixture, twenty of the whole run, by this machine's
    own speed.
    """
    assert not run({"": 1.4, "slow": 22.4, "proof": 99.0}[marker], marker, **seconds)


@pytest.mark.parametrize(
    ("test_s", "marker", "fixture_s", "message"),
    [
        (1.6, "", {"room": 2.0}, "test_it took 1.6 s of a core, wanted 1 at most"),
        (23.0, "slow", {}, "test_it took 23.0 s of a core, wanted 15 at most"),
        (0.1, "", {"room": 3.1}, "fixture room of test_it took 3.1 s of a core, wanted 2 at most"),
        (
            0.1,
            "",
            {"whole_run": 31.0},
            "fixture whole_run of test_it took 31.0 s of a core, wanted 20 at most",
        ),
    ],
)
def test_a_long_test_is_named(test_s, marker, fixture_s, message):
    """The test itself, or the fixture that it was the first to need: listed, and from twice the
    limit refused.
    """
    [note] = run(test_s, marker, **fixture_s)
    assert message in note
    twice = {name: 2 * seconds for name, seconds in fixture_s.items()}
    with pytest.raises(pytest.fail.Exception, match="at most; do less, or mark it slow"):
        run(2 * test_s, marker, **twice)
