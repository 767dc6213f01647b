"""Refusals: an error is judged by what it names, not by its sentence."""

from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def refused(
    error: type[BaseException] | tuple[type[BaseException], ...], *named: str
) -> Iterator[pytest.ExceptionInfo]:
    """Expect an error of one line that names the file, what was wanted, what came, or what
    to do.
    """
    with pytest.raises(error) as caught:
        yield caught
    message = str(caught.value)
    assert [part for part in named if part not in message] == [], message
    assert "\n" not in message
