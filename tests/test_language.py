"""What users read is in plain words: help, messages, README, docs and the page."""

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from helpers.import_graph import parsed
from helpers.places import ROOT

ROOMS = ("ggvs_eval", "pipelines", "baselines", "metrics", "reports", "contrib")
# Old words for: is, reported, not significantly different, next to, fix, checked against, except,
# which, no one, job log.
UNWANTED = re.compile(
    r"\b(stands? (in|at|on)|told|cannot be told|beside|mend(s|ed|ing)?|held against|but "
    r"for|whom|whoever|nobody|ledgers?)\b",
    re.IGNORECASE,
)
QUOTED = re.compile(
    r"```.*?```|`[^`]*`|\]\([^)]*\)|<code>.*?</code>|<!--.*?-->|\{[{%#].*?[#%}]\}|<[^>]*>|“[^”]*”|\"[^\"\n]*\"",
    re.DOTALL,
)

if not (ROOT / "setup.cfg").exists():
    pytest.skip("these tests read the checkout", allow_module_level=True)


def found_in(text: str) -> list[str]:
    """Unwanted words outside quotations and code spans."""
    return [match.group() for match in UNWANTED.finditer(QUOTED.sub(" ", text))]


def modules() -> Iterator[tuple[Path, ast.Module]]:
    """The modules of all rooms, parsed."""
    for room in ROOMS:
        for file in sorted((ROOT / room).rglob("*.py")):
            yield file, parsed(file)


def literals(node: ast.AST) -> Iterator[str]:
    """The texts written below a node: of f-strings the fixed parts, of subscripts and keywords of
    code nothing.
    """
    for literal in ast.walk(node):
        if (
            isinstance(literal, ast.Constant)
            and isinstance(literal.value, str)
            and " " in literal.value
        ):
            yield literal.value


def messages(tree: ast.Module) -> Iterator[str]:
    """The texts that a module raises, warns of, or prints."""
    for node in ast.walk(tree):
        is_shown = isinstance(node, ast.Call) and ast.unparse(node.func) in (
            "print",
            "warnings.warn",
            "sys.exit",
            "Finding",
        )
        if is_shown or isinstance(node, ast.Raise):
            yield from literals(node)


def test_unwanted_words_are_recognised_outside_of_code_only():
    """Quotations and code spans may hold any word; prose may not."""
    assert found_in("The file stands in the folder beside it, for whom") == [
        "stands in",
        "beside",
        "whom",
    ]
    assert found_in("`quick/fixed`, “nobody” and {{ one.told }} in <td class='beside'>") == []


@pytest.mark.parametrize(
    ("pattern", "most"), [("README.md", 1), ("docs/**/*.md", 99), ("reports/**/*.j2", 99)]
)
def test_pages_have_none_of_the_unwanted_words(pattern, most):
    """README, docs, and templates of the report, the leaderboard and the depth page use the words
    of the field.
    """
    files = sorted(ROOT.glob(pattern))
    assert min(most, 10) <= len(files) <= most
    assert {
        file.name: words for file in files if (words := found_in(file.read_text(encoding="utf-8")))
    } == {}


@pytest.mark.slow
def test_help_has_none_of_the_unwanted_words_and_short_first_lines():
    """The verbs, their options, and the classes of options; a first line fits a terminal."""
    from ggvs_eval.built_in import VERBS

    commands = [
        *(ROOT / "pipelines" / "commands").glob("*.py"),
        *(ROOT / "contrib").glob("*/command.py"),
    ]
    texts = {name: verb.about for name, verb in VERBS.items()}
    for file, tree in modules():
        for node in ast.walk(tree):
            is_option_class = isinstance(node, ast.ClassDef) and node.name.endswith(
                ("Options", "Engine")
            )
            if is_option_class or (
                file in commands
                and isinstance(node, ast.FunctionDef)
                and not node.name.startswith("_")
            ):
                texts[f"{file.name}:{node.name}"] = ast.get_docstring(node) or ""
    assert len(texts) > len(VERBS) + 30
    assert {name: found for name, text in texts.items() if (found := found_in(text))} == {}
    assert [verb.about for verb in VERBS.values() if len(verb.about) > 72] == []


@pytest.mark.slow
def test_messages_have_none_of_the_unwanted_words():
    """Errors, warnings, findings and printed lines."""
    said = {
        f"{file.relative_to(ROOT)}": [word for text in messages(tree) for word in found_in(text)]
        for file, tree in modules()
    }
    assert len(said) > 300
    assert {file: words for file, words in said.items() if words} == {}
