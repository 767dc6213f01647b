"""Names that docstrings and pages give in backticks exist: a module, or what it defines."""

import ast
import importlib
import re
from collections.abc import Iterator
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import pytest

from helpers.import_graph import modules, parsed
from helpers.places import ROOT

MODULES = modules()
ROOMS = "|".join(sorted({name.partition(".")[0] for name in MODULES if name}))
NAME = re.compile(rf"`(?:ggvs_eval\.)?((?:{ROOMS})(?:\.\w+)+)(?:\([^`]*\))?`")
FILE_ENDS = ("py", "toml", "md", "json", "csv", "png", "npz", "txt", "html", "safetensors", "csl")


def docstrings(file: Path) -> Iterator[str]:
    """Docstrings of a module, of its classes and of its functions."""
    for node in ast.walk(parsed(file)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef):
            yield ast.get_docstring(node) or ""


def names_in(text: str) -> set[str]:
    """Dotted names in backticks that begin with a room or module of the package, files left out."""
    return {name for name in NAME.findall(text) if name.rpartition(".")[2] not in FILE_ENDS}


@cache
def defined(module: str) -> set[str]:
    """Names that a module defines or takes from another, its modules if it is a package; methods
    and fields too.
    """
    found = {name.rpartition(".")[2] for name in MODULES if name.rpartition(".")[0] == module}
    for node in ast.walk(parsed(MODULES[module])):
        if isinstance(node, ast.Assign | ast.AnnAssign):
            targets = node.targets if isinstance(node, ast.Assign) else [node.target]
            found |= {
                each.id
                for target in targets
                for each in ast.walk(target)
                if isinstance(each, ast.Name)
            }
        elif isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        elif isinstance(node, ast.ImportFrom | ast.Import):
            found |= {alias.asname or alias.name for alias in node.names}
    return found


def exists(name: str) -> bool:
    """Whether a dotted name is a module of the package, or is defined in one."""
    parts = name.split(".")
    for end in range(len(parts), 0, -1):
        module = ".".join(parts[:end])
        if module in MODULES:
            return all(part in defined(module) for part in parts[end:])
    return False


def missing(texts: dict[str, str]) -> list[str]:
    """Where -> text, as lines of where and a name that does not exist."""
    return sorted(
        f"{where}: {name}"
        for where, text in texts.items()
        for name in names_in(text)
        if not exists(name)
    )


@pytest.mark.slow
def test_docstrings_name_what_exists():
    """Every dotted name of a docstring is found in the tree."""
    assert missing({str(file): "\n".join(docstrings(file)) for file in MODULES.values()}) == []


@pytest.mark.skipif(
    not (ROOT / "README.md").is_file(), reason="an installed wheel has no pages; a checkout has"
)
def test_pages_name_what_exists():
    """Every dotted name of a page is found in the tree; CHANGELOG tells of names that were."""
    pages = [*ROOT.glob("docs/**/*.md"), ROOT / "README.md", ROOT / "CONTRIBUTING.md"]

    assert missing({page.name: page.read_text(encoding="utf-8") for page in pages}) == []


@pytest.mark.parametrize(
    "name", ["metrics.image.psnr.psnr", "camera.Camera.rays", "datasets.open_capture"]
)
def test_what_does_not_exist_is_named(name):
    """A function, a class's method, a name that a package hands on; not a module that has moved, or
    a method that is gone.
    """
    assert missing({"here": f"see `ggvs_eval.{name}` and `{name}(1, 2)`"}) == []
    assert missing({"here": f"see `{name}s`", "there": "`metrics.flicker.Flicker`"}) == [
        f"here: {name}s",
        "there: metrics.flicker.Flicker",
    ]


@pytest.mark.slow
@pytest.mark.skipif(
    not (ROOT / "benchmarks").is_dir(),
    reason="an installed wheel has no benchmarks; a checkout has",
)
def test_benchmarks_and_tools_import_what_exists():
    """Names that they take of the package and of the tests' helpers; most of these programs run
    once in a year.
    """
    wrong = []
    for file in (*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("tools/**/*.py")):
        for node in ast.walk(parsed(file)):
            origin = node.module if isinstance(node, ast.ImportFrom) and node.module else ""
            # which needs Warp
            if origin.split(".")[0] in ("ggvs_eval", "helpers") and "contrib.warp" not in origin:
                module = importlib.import_module(origin)
                names = [alias.name for alias in node.names if not hasattr(module, alias.name)]
                wrong += [
                    f"{file.name}: {origin}.{name}"
                    for name in names
                    if not find_spec(f"{origin}.{name}")
                ]

    assert wrong == []
