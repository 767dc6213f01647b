"""The front door: `from ggvs_eval import ...` gives each public name, and `import ggvs_eval` loads
none of them.
"""

import ast
import subprocess
import sys
from pathlib import Path

import pytest

import ggvs_eval


@pytest.mark.parametrize("name", ggvs_eval.__all__)
def test_each_public_name_is_what_its_module_defines(name):
    """Each name of `__all__` is the object of that name, with a docstring."""
    value = getattr(ggvs_eval, name)

    assert value.__name__ == name
    assert value.__doc__
    assert name in dir(ggvs_eval)


@pytest.mark.slow
def test_importing_the_package_alone_loads_no_room():
    """`import ggvs_eval` loads not even numpy; the first name that is asked for loads its
    module.
    """
    code = (
        "import sys, ggvs_eval;print([name for name in sys.modules if "
        "name.startswith('ggvs_eval.') or name == 'numpy']);ggvs_eval.Camera; "
        "print('ggvs_eval.camera' in sys.modules)"
    )
    told = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    ).stdout.split("\n")

    assert told[:2] == ["[]", "True"]


def test_an_unknown_name_lists_the_public_ones():
    """A mistyped attribute is an AttributeError that says what there is."""
    with pytest.raises(
        AttributeError, match=r"no attribute 'open_captur'; public are Camera, .*, open_capture"
    ):
        _ = ggvs_eval.open_captur


def test_type_checkers_know_the_same_names():
    """The stub beside the package names what `__all__` names, from the modules that define it."""
    stub = ast.parse(Path(ggvs_eval.__file__).with_suffix(".pyi").read_text(encoding="utf-8"))
    told = {
        alias.asname: node.module
        for node in stub.body
        if isinstance(node, ast.ImportFrom)
        for alias in node.names
    }

    assert sorted(told) == ggvs_eval.__all__
    assert {name: getattr(ggvs_eval, name).__module__ for name in told} == told
