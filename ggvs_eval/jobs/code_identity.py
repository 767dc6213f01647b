"""Identity of code: a hash of everything that a module imports of this package, so that changed code means changed jobs.

Comments, docstrings, empty lines and the modules of errors and progress do not count: a message that became clearer costs no one
a night of rendering.

The closure is found by reading source files, at their heads and inside functions; nothing is imported. A package counts where
something is taken from it, not where it is only on the way to a module: no ``__init__.py`` does more than define names. Of an
extension module, the sources that it was built from count, which setup.py hashes into it: equal code has equal hashes on every
machine, regardless of the compiler.
"""

import ast
import hashlib
import importlib.util
import io
import os
import re
import tokenize
from collections.abc import Collection, Iterator
from dataclasses import dataclass
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path

import ggvs_eval
from ggvs_eval.files.digest import digest_values
from ggvs_eval.plugins import plugin_digest

PACKAGE = ggvs_eval.__name__
ROOMS_APART = (
    "baselines",
    "contrib",
    "metrics",
    "pipelines",
    "reports",
)  # next to it in a checkout, see setup.cfg
BUILT_FROM = re.compile(rb"ggvs-eval sources ([0-9a-f]{64})")  # ggvs_eval/kernels/sources.hpp

# Where and when work is done moves no result, nor does what is said meanwhile; nor do threads and instruction set, so that asking
# the processor for these does not tie one kernel to all others.
# Tables of what ships name everything, and a new entry moves no result of another one: what they load is passed as a root.
NEVER_COUNTED = tuple(f"{PACKAGE}.{each}" for each in ("jobs.", "errors", "progress", "built_in", "plugins"))
UNFOLLOWED = frozenset({f"{PACKAGE}.kernels"})
LAYOUT = frozenset({tokenize.NL, tokenize.INDENT, tokenize.DEDENT, tokenize.ENDMARKER})


@dataclass(frozen=True)
class CodeTree:
    """The modules of the package, wherever its folders are; assumed not to change while the process runs.

    Attributes:
        apart: names of rooms that are elsewhere, with their folders.
    """

    folder: Path
    apart: tuple[tuple[str, Path], ...] = ()

    def modules(self) -> Iterator[str]:
        """Dotted names of all modules."""
        for name, top in ((PACKAGE, self.folder), *((f"{PACKAGE}.{room}", folder) for room, folder in self.apart)):
            for folder, _, files in os.walk(top, followlinks=True):  # a checkout's view of the package is made of links
                above = [name, *Path(folder).relative_to(top).parts]
                stems = {file.partition(".")[0] for file in files if file.endswith((".py", *EXTENSION_SUFFIXES))}
                yield from (".".join([*above, stem]).removesuffix(".__init__") for stem in stems)

    def file(self, module: str) -> Path | None:
        """Return the source or extension module of a dotted name; None if there is none of that name."""
        _, *parts = module.split(".")
        apart = dict(self.apart).get(parts[0]) if parts else None
        path = apart.joinpath(*parts[1:]) if apart else self.folder.joinpath(*parts)
        beside = (path.with_name(f"{path.name}{suffix}") for suffix in (".py", *EXTENSION_SUFFIXES))
        return next((file for file in (path / "__init__.py", *beside) if file.is_file()), None)

    def closure(self, *roots: str, unfollowed: Collection[str] = ()) -> tuple[str, ...]:
        """Return the names of some modules and of all that they import of the package, sorted.

        Args:
            roots: dotted names, e.g. ``ggvs_eval.metrics.image``.
            unfollowed: modules that count themselves, but not by what they import: those that choose among many.

        Raises:
            ModuleNotFoundError: no such module.
        """
        stops = UNFOLLOWED.union(unfollowed)
        modules: set[str] = set()
        waiting = set(roots)
        while waiting:
            modules |= waiting
            waiting = {name for module in waiting - stops for name in _code_of(self, module).imports} - modules
        return tuple(sorted(modules))

    def digest(self, modules: Collection[str]) -> str:
        """SHA-256 of the names and the code of some modules, in any order."""
        lines = [f"{module} {_code_of(self, module).sha256}" for module in sorted(modules)]
        return hashlib.sha256("\n".join(lines).encode()).hexdigest()


def code_identity(*roots: str, unfollowed: Collection[str] = ()) -> str:
    """Return the hash of the installed code that some modules run; arguments as of `CodeTree.closure`.

    A module of a plug-in counts with all sources of its package; what it takes of this one is not followed.
    """
    tree = installed_code()
    ours = [root for root in roots if root.partition(".")[0] == PACKAGE]
    own = tree.digest(tree.closure(*ours, unfollowed=unfollowed))
    foreign = sorted({plugin_digest(root) for root in roots if root not in ours})
    return digest_values(own, *foreign) if foreign else own


@cache
def package_digest() -> str:
    """Return the hash of the whole package, which machines that share jobs must have in common."""
    tree = installed_code()
    return tree.digest(list(tree.modules()))


@cache
def installed_code() -> CodeTree:
    """Return the package as it is installed here."""
    folder = Path(str(ggvs_eval.__file__)).parent
    specs = {room: importlib.util.find_spec(f"{PACKAGE}.{room}") for room in ROOMS_APART if not (folder / room).is_dir()}
    return CodeTree(folder, tuple((room, Path(str(spec.origin)).parent) for room, spec in specs.items() if spec))


@dataclass(frozen=True)
class _Code:
    """One module: a hash of its code, and the modules of the package that it imports."""

    sha256: str
    imports: frozenset[str]


@cache
def _code_of(tree: CodeTree, module: str) -> _Code:
    """Read a module: of a source what runs, regardless of its line ends; of an extension module what it was built from."""
    file = tree.file(module)
    if file is None:
        raise ModuleNotFoundError(f"{module}: wanted its code for the identity of a job, found none in {tree.folder}")
    content = file.read_bytes()
    if file.suffix != ".py":
        built_from = BUILT_FROM.search(content)
        return _Code(built_from[1].decode() if built_from else hashlib.sha256(content).hexdigest(), frozenset())
    package = module if file.name == "__init__.py" else module.rpartition(".")[0]
    imports = {name for name in _imports(tree, package, ast.parse(content, str(file))) if not name.startswith(NEVER_COUNTED)}
    return _Code(hashlib.sha256(what_runs(content.decode("utf-8-sig")).encode()).hexdigest(), frozenset(imports))


def what_runs(source: str) -> str:
    """Return a source without what moves no result: comments, docstrings (any statement that is a string alone) and empty lines.

    Rows are taken out, not tokens written anew: versions of Python cut f-strings in different ways.
    """
    rows = io.StringIO(source, newline=None).read().split("\n")
    dropped, statement = set[int](), list[tokenize.TokenInfo]()
    for token in tokenize.generate_tokens(io.StringIO("\n".join(rows)).readline):
        row = token.start[0] - 1
        if token.type == tokenize.COMMENT:
            rows[row] = rows[row][: token.start[1]].rstrip()
        elif token.type == tokenize.NL and not rows[row].strip():
            dropped.add(row)
        elif token.type == tokenize.NEWLINE:
            if {part.type for part in statement} == {tokenize.STRING}:
                dropped.update(range(statement[0].start[0] - 1, token.end[0]))
            statement = []
        elif token.type not in LAYOUT:
            statement.append(token)
    return "\n".join(row for number, row in enumerate(rows) if number not in dropped)


def _imports(tree: CodeTree, package: str, source: ast.AST) -> Iterator[str]:
    """Yield the modules of the package that a source of `package` imports anywhere except for the type checker."""
    for node in ast.iter_child_nodes(source):
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test):
            node = ast.Module(node.orelse, [])
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name.startswith(f"{PACKAGE}."))
        elif isinstance(node, ast.ImportFrom):
            above = package.rsplit(".", node.level - 1)[0] if node.level else ""
            origin = ".".join(part for part in (above, node.module) if part)
            if origin.partition(".")[0] == PACKAGE:
                inner = (f"{origin}.{alias.name}" for alias in node.names)
                yield from (name if tree.file(name) else origin for name in inner)
        else:
            yield from _imports(tree, package, node)
