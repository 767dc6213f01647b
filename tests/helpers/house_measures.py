"""How much code a reader has to carry: tokens, modules that a task reaches, names that parts use,
pronouns as names.

Size is counted in tokens of code, without comments, docstrings and line breaks: lines can be made
wider, tokens cannot. ``python tests/helpers/house_measures.py`` prints the figures of the checkout.
"""

import ast
import sys
import tokenize
from collections import Counter
from collections.abc import Iterable
from functools import cache
from pathlib import Path

if __name__ == "__main__":
    sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from helpers.import_graph import TESTS, modules, parsed

NOT_CODE = {
    *(tokenize.COMMENT, tokenize.NL, tokenize.NEWLINE, tokenize.ENCODING, tokenize.ENDMARKER),
    *(tokenize.INDENT, tokenize.DEDENT),
}
# Words that stand for a value without naming it. `at` and `left` are coordinates and sides too, and
# are not counted.
WORDS = (
    "each one ones other others own kept found shown seen known chosen given taken made asked "
    "wanted told right_one whole same such these those that this it them theirs ours mine here "
    "there now then of with_ rest left_over used read_ done held drawn written measured looked "
    "missing_ones both all_of first_of anything something nothing what who which"
)
PRONOUNS = frozenset(WORDS.split())


def code_tokens(file: Path) -> int:
    """Count the tokens of a file; a text that begins a statement is a docstring and counts for
    nothing.
    """
    n_tokens, begins_statement = 0, True
    with file.open("rb") as stream:
        for token in tokenize.tokenize(stream.readline):
            if token.type == tokenize.NEWLINE:
                begins_statement = True
            elif token.type not in NOT_CODE:
                n_tokens += not (token.type == tokenize.STRING and begins_statement)
                begins_statement = False
    return n_tokens


def is_contrib(module: str) -> bool:
    """Tell whether a module is of a part that the package can do without."""
    return module.split(".")[0] == "contrib"


def tokens_of_rooms() -> Counter[str]:
    """Tokens of the core, of contrib and of the tests."""
    tokens = Counter(tests=sum(map(code_tokens, TESTS.rglob("*.py"))))
    for module, file in modules().items():
        tokens["contrib" if is_contrib(module) else "core"] += code_tokens(file)
    return tokens


@cache
def imported_names(file: Path) -> frozenset[tuple[str, str]]:
    """Module and name of everything that a file imports of the package, also inside functions, but
    for type checkers.
    """
    names: set[tuple[str, str]] = set()

    def visit(node: ast.AST) -> None:
        for child in ast.iter_child_nodes(node):
            if isinstance(child, ast.If) and "TYPE_CHECKING" in ast.unparse(child.test):
                continue
            if (
                isinstance(child, ast.ImportFrom)
                and child.module
                and child.module.split(".")[0] == "ggvs_eval"
            ):
                names.update(_origin(child.module, alias.name) for alias in child.names)
            elif isinstance(child, ast.Import):
                names.update((_short(alias.name), "*") for alias in child.names)
            else:
                visit(child)

    visit(parsed(file))
    return frozenset((module, name) for module, name in names if module in modules())


def _short(module: str) -> str:
    """A module's name without the package's; the package itself is empty."""
    return module.removeprefix("ggvs_eval").removeprefix(".")


def _origin(module: str, name: str) -> tuple[str, str]:
    """Where a name is imported from: a module as a whole, or a name in one."""
    module = _short(module)
    inner = ".".join(filter(None, (module, name)))
    return (inner, "*") if inner in modules() else (module, name)


def reached_modules(task: str) -> set[str]:
    """All modules that a module imports, directly or not, itself among them."""
    reached, waiting = set(), [task]
    while waiting:
        module = waiting.pop()
        if module not in reached:
            reached.add(module)
            waiting += [imported for imported, _ in imported_names(modules()[module])]
    return reached


def count_lines(names: Iterable[str]) -> int:
    """Lines of some modules."""
    return sum(len(modules()[name].read_text(encoding="utf-8").splitlines()) for name in names)


def core_names_in_contrib() -> set[tuple[str, str]]:
    """Names of the core that parts of contrib import."""
    of_contrib = [imported_names(file) for module, file in modules().items() if is_contrib(module)]
    return {
        (module, name) for names in of_contrib for module, name in names if not is_contrib(module)
    }


def pronouns_as_names(names: Iterable[str]) -> Counter[str]:
    """How often modules bind each pronoun as a name: by assignments, loops, comprehensions and
    parameters.
    """
    counts: Counter[str] = Counter()
    for name in names:
        for node in ast.walk(parsed(modules()[name])):
            if isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                counts[node.id] += node.id in PRONOUNS
            elif isinstance(node, ast.arg):
                counts[node.arg] += node.arg in PRONOUNS
    return +counts


if __name__ == "__main__":
    for room, n_tokens in tokens_of_rooms().items():
        print(f"{room}: {n_tokens:,} tokens")
    for task in ("score", "evaluate"):
        reached = reached_modules(f"pipelines.run.{task}")
        print(f"{task} reaches {len(reached)} modules, {count_lines(reached):,} lines")
    print(f"contrib imports {len(core_names_in_contrib())} names of the core")
    print(
        f"{pronouns_as_names(modules()).total():,} pronouns as names: "
        f"{pronouns_as_names(modules()).most_common(8)}"
    )
