"""The examples in docstrings: what they print is what stands below them."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import ggvs_eval


def with_examples() -> list[str]:
    """Names of all modules of the package whose docstrings show an example."""
    found = ["ggvs_eval"]
    for module in pkgutil.walk_packages(ggvs_eval.__path__, "ggvs_eval."):
        spec = module.module_finder.find_spec(module.name, None)  # type: ignore[call-arg]
        source = Path(spec.origin) if spec and spec.origin else None
        if source and source.suffix == ".py" and ">>> " in source.read_text(encoding="utf-8"):
            found.append(module.name)
    return found


MODULES = with_examples()


@pytest.mark.parametrize("name", MODULES)
def test_examples_hold(name):
    """Every example of a module prints what it says."""
    results = doctest.testmod(importlib.import_module(name), optionflags=doctest.ELLIPSIS)

    assert results.attempted > 0
    assert results.failed == 0


def test_the_foundations_have_examples():
    """What a newcomer calls first shows how it is called."""
    first = ("camera", "datasets", "files.images", "geometry.splat", "geometry.warp", "pipelines.play.synthesizer", "protocol")

    assert {f"ggvs_eval.{name}" for name in first} <= set(MODULES)
