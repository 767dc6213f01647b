"""Plug-ins: metrics, methods and layouts of other packages and single files, known by name like the
built-in ones.

A package names its objects as entry points of the groups ``ggvs_eval.metrics``,
``ggvs_eval.methods`` and ``ggvs_eval.datasets``; a file has tables of the same names, ``METRICS =
{"P99": ...}``. An object is what the registry of its kind holds. It is imported when it is asked
for by its name, or when everything of its kind is tried.

What goes wrong in it costs what it was to give, and is called by its name: its code is called in
`foreign`, with copies of arrays, and its metrics are measured in processes of their own
(`metrics/foreign.py`).
"""

import hashlib
import importlib
import importlib.util
import os
import pkgutil
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import chdir, contextmanager
from dataclasses import dataclass
from functools import cache, partial
from importlib.metadata import entry_points
from importlib.util import find_spec
from pathlib import Path
from types import ModuleType
from typing import Any, Generic, Literal, TypeVar, cast, get_args

from ggvs_eval.built_in import DEVICE_PARTS as SHIPPED_DEVICE_PARTS
from ggvs_eval.built_in import Derived
from ggvs_eval.errors import AbsentPartError, GgvsError, PluginError, ViewRefusedError

Kind = Literal["metrics", "methods", "datasets", "sections"]
FILES = "GGVS_EVAL_PLUGINS"  # environment variable of plug-in files, which worker processes inherit
Entry = TypeVar("Entry")


@dataclass(frozen=True)
class Plugin:
    """One object of a plug-in, not yet imported.

    Attributes:
        name: that it is asked for by.
        origin: package and version, or file, for messages and records.
        load: imports it.
    """

    name: str
    origin: str
    load: Callable[[], Any]


class Registry(Mapping[str, Entry], Generic[Entry]):
    """Objects of one kind by name: those that ship and those of plug-ins, each imported when it is
    asked for by its name.

    What ships in a package that is not installed is left out; asked for, it is an error that names
    the package.

    Args:
        kind: of the objects; one of `Kind` has plug-ins too.
        shipped: ``module:attribute`` of each that ships, or from what it is derived; see
            `ggvs_eval.built_in`. An object is for itself.
        check: makes an object of what a plug-in offers; raises `TypeError` where that is of another
            kind.
        absent: makes a substitute of the name and the reason for one that is not installed;
            without, that is an error.
        needs: the module of another project that what ships here imports.
    """

    def __init__(
        self,
        kind: str,
        shipped: Mapping[str, Any],
        check: Callable[[str, Any], Entry] | None = None,
        absent: Callable[[str, str], Entry] | None = None,
        needs: str = "",
    ) -> None:
        self.shipped = dict(shipped)
        self._kind = kind
        self._check = check
        self._absent = absent
        self._needs = needs
        self._loaded: dict[str, Entry] = {}
        self._made: dict[Derived, Any] = {}

    @property
    def plugins(self) -> dict[str, Plugin]:
        """Return entries under unused names; a name that is taken is reported once."""
        return _offered(self._kind, frozenset(self.shipped)) if self._kind in get_args(Kind) else {}

    def __getitem__(self, name: str) -> Entry:
        """Return the object of a name.

        Raises:
            KeyError: no such name.
            AbsentPartError: it ships with a package that is not installed.
            PluginError: its plug-in cannot be imported, or offers something else.
        """
        if name in self.shipped:
            reason = self.why_absent(name)
            if not reason:
                try:
                    return cast(Entry, self._built_in(self.shipped[name]))
                except ModuleNotFoundError as error:  # of a part that it builds on
                    if not str(error.name).startswith("ggvs_eval."):
                        raise
                    reason = (
                        f"{name} wants {error.name}, which is not installed; reinstall "
                        f"ggvs-eval or omit it"
                    )
            if self._absent is None:
                raise AbsentPartError(reason)
            return self._absent(name, reason)
        if name not in self._loaded:
            self._loaded[name] = self._load(self.plugins[name])
        return self._loaded[name]

    def __contains__(self, name: object) -> bool:
        return self.is_present(name) if name in self.shipped else name in self.plugins

    def __iter__(self) -> Iterator[str]:
        yield from self.present()
        yield from self.plugins

    def __len__(self) -> int:
        return len(self.present()) + len(self.plugins)

    def present(self) -> list[str]:
        """Return the names of what ships, in order, without what is not installed.

        Nothing is loaded.
        """
        return [name for name in self.shipped if self.is_present(name)]

    def known(self) -> list[str]:
        """Return the names of all, in order, those that are not installed among them."""
        return [*self.shipped, *self.plugins]

    def is_present(self, name: object) -> bool:
        """True if a name ships and its package is there."""
        return name in self.shipped and not self.why_absent(str(name))

    def installed(self) -> dict[str, Entry]:
        """Return what ships and is there, loaded, in order; of what is not there a line says so."""
        entries = {}
        for name in self.shipped:
            try:
                entries[name] = self[name]
            except AbsentPartError as error:
                say_once(str(error))
        return entries

    def built_in(self) -> dict[str, Entry]:
        """Return the built-in object of a name, loaded."""
        return {name: self[name] for name in self.present()}

    def why_absent(self, name: str) -> str:
        """Return the reason why a name that ships is not there, in a line.

        Empty if it is there, or does not ship.
        """
        if name not in self.shipped:
            return ""
        if self._needs and not is_installed(self._needs):
            return (
                f"{name} wants the module {self._needs}, which is not installed; install it or "
                f"remove {name}"
            )
        part = next(filter(None, map(missing_part, self._modules(self.shipped[name]))), None)
        return (
            f"{name} is part of {part}, which is not installed; reinstall ggvs-eval or omit it"
            if part
            else ""
        )

    def root(self, name: str) -> str | None:
        """Return the module that an entry that ships is loaded from, for the identity of its code.

        None of an object.
        """
        entry = self.shipped[name]
        if isinstance(entry, Derived):
            return (
                self.root(entry.base)
                if entry.base in self.shipped
                else entry.base.partition(":")[0]
            )
        return entry.partition(":")[0] if isinstance(entry, str) else None

    def _modules(self, entry: Any) -> Iterator[str]:
        """Yield the modules that an entry is loaded from and made by."""
        if isinstance(entry, Derived):
            yield from self._modules(self.shipped.get(entry.base, entry.base))
            yield entry.make.partition(":")[0]
        elif isinstance(entry, str):
            yield entry.partition(":")[0]

    def _built_in(self, entry: Any) -> Any:
        if isinstance(entry, Derived):
            if entry not in self._made:
                base = self._built_in(self.shipped.get(entry.base, entry.base))
                self._made[entry] = pkgutil.resolve_name(entry.make)(base, *entry.arguments)
            return self._made[entry]
        return pkgutil.resolve_name(entry) if isinstance(entry, str) else entry

    def working(self) -> Iterator[tuple[str, Entry]]:
        """Yield every name with its object, without plug-ins that do not work, of which a line says
        so.
        """
        for name in self:
            try:
                yield name, self[name]
            except PluginError as error:
                say_once(str(error))

    def origins(self, names: Iterable[str]) -> dict[str, str]:
        """Return package and version, or file, of names from plug-ins, for the record of
        results.
        """
        return {
            name: self.plugins[name].origin
            for name in names
            if name not in self.shipped and name in self.plugins
        }

    def _load(self, plugin: Plugin) -> Entry:
        with foreign(f"{plugin.origin}: {self._kind} {plugin.name!r} cannot be used"):
            return self._check(plugin.name, plugin.load()) if self._check else plugin.load()


@contextmanager
def foreign(subject: str, kind: type[GgvsError] = PluginError) -> Iterator[None]:
    """Turn whatever a plug-in's code raises in the block but Ctrl-C into an error of this package.

    It may not change the folder.

    Args:
        subject: the plug-in, and what of it, for the message.
        kind: of the error; those of this package pass as they are, unless they are to cost a view
            alone.
    """
    passes = kind if kind is ViewRefusedError else GgvsError
    try:
        with chdir("."):  # and back
            yield
    except BaseException as error:
        if isinstance(error, KeyboardInterrupt | passes):
            raise
        raise kind(f"plug-in {subject} ({_reason(error)}); fix or uninstall it") from error


def use_file(path: Path) -> None:
    """Take the objects of a file's tables for this process and those that it starts.

    Raises:
        PluginError: no such file, one that cannot be imported, or one without a table.
    """
    file = path.resolve()
    if os.pathsep in str(file):
        raise PluginError(
            f"{file}: wanted a path without {os.pathsep!r}, the separator of such paths; move or "
            f"rename it"
        )
    module = _module_of(file)
    if not any(isinstance(getattr(module, kind.upper(), None), Mapping) for kind in get_args(Kind)):
        raise PluginError(
            f"{path}: wanted a table METRICS, METHODS, DATASETS or SECTIONS of names and objects, "
            f"got none; see docs/extending.md"
        )
    named = [name for name in os.environ.get(FILES, "").split(os.pathsep) if name]
    os.environ[FILES] = os.pathsep.join(dict.fromkeys([*named, str(file)]))
    _offered.cache_clear()


@cache
def missing_part(module: str) -> str | None:
    """Return the outermost package of a dotted name that is not installed, or the module itself.

    None if it is there.
    """
    above = module.rpartition(".")[0]
    if above and (part := missing_part(above)):
        return part
    return None if is_installed(module) else module


def is_installed(module: str) -> bool:
    """True if a module can be imported.

    A mere folder of its name, which Python takes for a namespace, is none.
    """
    spec = find_spec(module)
    return spec is not None and spec.origin is not None


def imported(reference: str) -> Any:
    """Return the object of ``module:name``, with modules of the working folder."""
    if (folder := os.getcwd()) not in sys.path:
        sys.path.append(folder)
    with foreign(f"{reference}: wanted a module and what it defines, as my_method:Mine"):
        return pkgutil.resolve_name(reference)


def plugin_digest(module: str) -> str:
    """Return the SHA-256 of a foreign module's code: of all sources of its package, or of
    its file.
    """
    top = module.partition(".")[0]
    spec = importlib.util.find_spec(top)
    if spec is None or not spec.origin:
        raise PluginError(
            f"plug-in module {module}: wanted its source for the identity of jobs, found none; "
            f"install it from source"
        )
    origin = Path(spec.origin)
    files = sorted(origin.parent.rglob("*.py")) if spec.submodule_search_locations else [origin]
    digest = hashlib.sha256()
    for file in files:
        digest.update(f"{file.relative_to(origin.parent)}\0".encode() + file.read_bytes())
    return digest.hexdigest()


@cache
def _offered(kind: str, names_in_use: frozenset[str]) -> dict[str, Plugin]:
    offered: dict[str, Plugin] = {}
    for plugin in (*_of_packages(kind), *_of_files(kind)):
        if plugin.name in names_in_use or plugin.name in offered:
            say_once(
                f"plug-in {plugin.origin}: {kind} {plugin.name!r} is in use, so the plug-in's is "
                f"ignored; rename it"
            )
        else:
            offered[plugin.name] = plugin
    return offered


def _of_packages(kind: str) -> Iterator[Plugin]:
    for entry in sorted(entry_points(group=f"ggvs_eval.{kind}"), key=lambda entry: entry.name):
        version = f"{entry.dist.name} {entry.dist.version}" if entry.dist else entry.value
        yield Plugin(entry.name, version, entry.load)


def _of_files(kind: str) -> Iterator[Plugin]:
    for file in filter(None, os.environ.get(FILES, "").split(os.pathsep)):
        table = getattr(_module_of(Path(file)), kind.upper(), {})
        for name in table:
            yield Plugin(name, file, partial(table.__getitem__, name))


def _module_of(file: Path) -> ModuleType:
    """Import a file under its own name, by which worker processes find what is sent to them."""
    if not file.is_file():
        raise PluginError(
            f"{file}: wanted a Python file with plug-ins, got no such file; check the path"
        )
    if file.suffix != ".py" or not file.stem.isidentifier():
        raise PluginError(
            f"{file}: wanted a Python file whose name can be imported, such as my_metrics.py; "
            f"rename it"
        )
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))
    with foreign(f"{file}: cannot be imported"):
        module = importlib.import_module(file.stem)
    if Path(str(module.__file__)).resolve() != file:
        raise PluginError(f"{file}: its name is that of the module {module.__file__}; rename it")
    return module


def _reason(error: BaseException) -> str:
    try:
        return " ".join(f"{type(error).__name__}: {error}".split())
    except BaseException:
        return f"{type(error).__name__}, without a text"


@cache
def say_once(line: str) -> None:
    """Print a line to the terminal, once for the process."""
    print(f"ggvs-eval: {line}", file=sys.stderr, flush=True)


# What contrib's warp gives on a GPU, where NVIDIA Warp and contrib are there.
DEVICE_PARTS: Registry[Any] = Registry("device parts", SHIPPED_DEVICE_PARTS, needs="warp")
