"""Which module of the package imports which, read from the sources; tests of the plan and `make
test ROOM=...` ask it.
"""

import ast
import importlib.util
import re
from functools import cache
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
FOLDERS = ("pipelines", "baselines", "contrib", "metrics", "reports")
IMPORT = re.compile(
    r"^[ \t]*(?:from (ggvs_eval[\w.]*) import (\([^)]*\)|.*)|import (ggvs_eval[\w.]*))",
    re.MULTILINE,
)
TAKEN = re.compile(r"(\w+)(?: as \w+)?\s*(?:,|\)|$)")
COMMENT = re.compile("#.*")


@cache
def modules() -> dict[str, Path]:
    """Dotted name without `ggvs_eval.` -> file, of every module of the package."""
    root = _folder_of("ggvs_eval")
    folders = {"": root} | {name: _folder_of(f"ggvs_eval.{name}") for name in FOLDERS}
    files = {}
    for name, folder in folders.items():
        for file in folder.rglob("*.py"):
            if not name and any(inner in file.parents for key, inner in folders.items() if key):
                continue
            parts = [name, *file.relative_to(folder).with_suffix("").parts]
            files[".".join(part for part in parts if part and part != "__init__")] = file
    return files


def _folder_of(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    assert spec is not None
    assert spec.origin is not None
    return Path(spec.origin).resolve().parent


@cache
def imported_modules(file: Path) -> frozenset[str]:
    """Modules of the package that a file imports, at its head or inside functions, without
    `ggvs_eval.`.

    Found by its lines, fifty times as fast as in its syntax tree; a test compares both.
    """
    names = set()
    for package, taken, module in IMPORT.findall(file.read_text(encoding="utf-8")):
        inner = {f"{package}.{name}" for name in TAKEN.findall(COMMENT.sub("", taken))}
        names |= {
            name if name.removeprefix("ggvs_eval.") in modules() else package for name in inner
        }
        names.add(module)
    return frozenset(
        name.removeprefix("ggvs_eval.") for name in names if name.startswith("ggvs_eval.")
    )


@cache
def parsed(file: Path) -> ast.Module:
    """The syntax tree of a file, which several tests walk."""
    return ast.parse(file.read_text(encoding="utf-8"))


def room_of(module: str, depth: int = 2) -> str:
    """The folder that a module stands in, `pipelines.online` or `geometry`; a module of the package
    itself is a room alone.
    """
    parts = module.split(".")
    if parts[0] not in FOLDERS:
        return parts[0]
    return ".".join(parts[:depth])


@cache
def rooms_that_use(room: str) -> frozenset[str]:
    """A room and the rooms with a module that imports one of its modules.

    Args:
        room: `geometry`, `pipelines.online` or its last part alone, `online`.

    Raises:
        KeyError: there is no such room.
    """
    rooms = {room_of(module) for module in modules() if module}
    asked = {name for name in rooms if name == room or name.rpartition(".")[2] == room}
    if not asked:
        raise KeyError(f"no room is called {room!r}; there are {', '.join(sorted(rooms))}")
    users = {
        room_of(module)
        for module, file in modules().items()
        if {room_of(name) for name in imported_modules(file)} & asked
    }
    return frozenset(asked | users)


@cache
def imports_of_test(file: Path) -> frozenset[str]:
    """Rooms whose modules a test file imports, by itself or through what it imports of
    `helpers`.
    """
    rooms = {room_of(module) for module in imported_modules(file)}
    for node in ast.walk(parsed(file)):
        if (
            isinstance(node, ast.ImportFrom)
            and node.module
            and node.module.split(".")[0] == "helpers"
        ):
            helper = TESTS.joinpath(*node.module.split(".")).with_suffix(".py")
            if helper.is_file():
                rooms |= imports_of_test(helper)
    return frozenset(rooms)
