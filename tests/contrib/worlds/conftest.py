"""Rooms of these tests that nobody looks at closely."""

from collections.abc import Iterator

import pytest

from helpers.lit_rooms import light_by_few_rays


@pytest.fixture(scope="module")
def lit_quickly(tmp_path_factory) -> Iterator[None]:
    """An eighth of the rays finds the light."""
    with pytest.MonkeyPatch.context() as patch:
        light_by_few_rays(patch, tmp_path_factory.mktemp("light"))
        yield
