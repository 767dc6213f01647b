"""Identity of code: the version of the package and the text of the rooms that a result names, or of
a plug-in's file.

A room is a package without the packages below it. What is made names the rooms that decide it; it
is stale when a file of one of them, or of the rooms above them, has changed. Nobody has to follow
imports to know what a change costs. Of an extension module the sources count that it was built
from, which setup.py hashes into it: equal code has equal hashes on every machine, whatever the
compiler.
"""

import hashlib
import importlib.util
import pkgutil
import re
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from importlib.metadata import version
from pathlib import Path

from ggvs_eval.files.digest import digest_values
from ggvs_eval.plugins import plugin_digest

PACKAGE = "ggvs_eval"
# Rooms that a checkout keeps beside the package.
TOP_ROOMS = ("baselines", "contrib", "metrics", "pipelines", "reports")
BUILT_FROM = re.compile(rb"ggvs-eval sources ([0-9a-f]{64})")  # ggvs_eval/kernels/sources.hpp
COUNTED = (".py", *EXTENSION_SUFFIXES)
# names, and words for people
WITHOUT_EFFECT = ("__init__", "api", "built_in", "errors", "plugins", "progress")
# What every picture, depth map and number is computed with, as far as it is there.
COMMON = tuple(f"{PACKAGE}.{room}" for room in ("files", "gaussians", "geometry", "kernels"))


def code_of(*names: str) -> str:
    """Return the hash of the code that makes something, with that of the common rooms.

    Args:
        names: packages, which are rooms, or modules, which mean the rooms that they are in;
            a module of a plug-in counts with its whole file or package.
    """
    modules = {name for name in names if name.partition(".")[0] == PACKAGE}
    modules.update(room for room in COMMON if importlib.util.find_spec(room))
    rooms = sorted({room for name in modules for room in rooms_of(name)})
    plugins = sorted(plugin_digest(name) for name in {*names} - modules)
    return digest_values(version("ggvs-eval"), *map(_room_digest, rooms), *plugins)


@cache
def package_digest() -> str:
    """Return the hash of the whole package, which machines that share tasks must have in common."""
    rooms = [
        PACKAGE,
        *(room for name in TOP_ROOMS if importlib.util.find_spec(room := f"{PACKAGE}.{name}")),
    ]
    for room in rooms:
        inner = pkgutil.iter_modules([str(_folder(room))], f"{room}.")
        rooms += [module.name for module in inner if module.ispkg and module.name not in rooms]
    return digest_values(*map(_room_digest, sorted(rooms)))


@cache
def rooms_of(name: str) -> list[str]:
    """Return the room of a module, or that a package is, and those above it."""
    spec = importlib.util.find_spec(name)
    if spec is None:
        raise ModuleNotFoundError(f"{name}: wanted the code of a result, found none", name=name)
    parts = name.split(".")
    depth = len(parts) if spec.submodule_search_locations else len(parts) - 1
    return [".".join(parts[:length]) for length in range(1, depth + 1)]


@cache
def _room_digest(room: str) -> str:
    files = sorted(_folder(room).iterdir())
    counted = [file for file in files if _counts(file) and file.stem not in WITHOUT_EFFECT]
    return digest_values(room, *(f"{_name(file)} {_file_digest(file)}" for file in counted))


def _counts(file: Path) -> bool:
    return file.name.endswith(COUNTED) and file.is_file()


def _name(file: Path) -> str:
    """Return a file's name without what differs between machines."""
    return file.name.partition(".")[0]


def _folder(package: str) -> Path:
    spec = importlib.util.find_spec(package)
    assert spec is not None and spec.submodule_search_locations is not None  # noqa: PT018
    return Path(next(iter(spec.submodule_search_locations)))


def _file_digest(file: Path) -> str:
    """Hash a source regardless of its line ends, or what an extension module was built from."""
    content = file.read_bytes()
    if file.suffix == ".py":
        return hashlib.sha256(content.replace(b"\r\n", b"\n")).hexdigest()
    built_from = BUILT_FROM.search(content)
    return built_from[1].decode() if built_from else hashlib.sha256(content).hexdigest()
