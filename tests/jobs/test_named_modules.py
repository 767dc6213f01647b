"""What the identity of code rests on: methods name the rooms that they are made in, and packages
only define names.
"""

import ast
from collections.abc import Iterator
from typing import Any

import pytest

from ggvs_eval.errors import WeightsError
from ggvs_eval.pipelines.methods.fitted import FittedMethod
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.tasks.identity import COMMON, rooms_of
from helpers.import_graph import modules, parsed

HARMLESS = (ast.Import, ast.ImportFrom, ast.FunctionDef, ast.ClassDef, ast.AnnAssign, ast.Assign)


def parts_of(value: Any, depth: int = 4) -> Iterator[Any]:
    """The objects of this package that an object is made of, itself included."""
    if type(value).__module__.startswith("ggvs_eval.") and depth:
        yield value
        for part in getattr(value, "__dict__", {}).values():
            yield from parts_of(part, depth - 1)


@pytest.mark.parametrize("label", METHODS)
def test_a_method_names_its_modules(label):
    """All that a method is made of is in the rooms that its spec names."""
    spec = find_method(label)
    try:
        method = spec.make_fitter() if isinstance(spec, FittedMethod) else spec.make()
    except WeightsError:
        pytest.skip("its weights do not ship")

    rooms = {room for module in (*spec.modules, *COMMON) for room in rooms_of(module)}
    assert {rooms_of(type(part).__module__)[-1] for part in parts_of(method)} <= rooms


def test_packages_do_nothing_when_they_are_imported():
    """A package on the way to a module need not count, for its ``__init__.py`` defines names and no
    more.
    """
    acting = []
    for name, file in modules().items():
        if file.name == "__init__.py":
            statements = [
                node for node in parsed(file).body[1:] if "TYPE_CHECKING" not in ast.unparse(node)
            ]
            acting += [
                f"{name}: {ast.unparse(node)}"
                for node in statements
                if not isinstance(node, HARMLESS)
            ]

    assert acting == []
