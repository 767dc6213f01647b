"""The examples in docstrings: what they print is what stands below them."""

import doctest
import importlib

import pytest

from helpers.import_graph import modules


def with_examples() -> list[str]:
    """Names of all modules of the package whose docstrings show an example."""
    files = sorted(modules().items())
    return [
        f"ggvs_eval.{name}".rstrip(".")
        for name, file in files
        if ">>> " in file.read_text(encoding="utf-8")
    ]


MODULES = with_examples()


@pytest.mark.parametrize("name", MODULES)
def test_examples_hold(name):
    """Every example of a module prints what it says."""
    results = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)

    assert results.attempted > 0
    assert results.failed == 0


def test_the_foundations_have_examples():
    """What a newcomer calls first shows how it is called."""
    first = (
        "camera",
        "datasets",
        "files.images",
        "geometry.splat",
        "geometry.warp",
        "pipelines.play.synthesizer",
        "protocol",
    )

    assert {f"ggvs_eval.{name}" for name in first} <= set(MODULES)
