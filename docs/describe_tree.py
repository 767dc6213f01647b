"""Write what docs/architecture.md says of the tree, its rooms and its lines: ``python docs/describe_tree.py [ROOT]``.

Rooms are described by the first line of their docstring. Of another checkout the lines are printed and nothing is written.
"""

import argparse
import ast
import re
import statistics
from collections import Counter
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("ggvs_eval", "baselines", "contrib", "metrics", "pipelines", "reports")


def main() -> None:
    """Print the figures of a tree; what is said of this one is written."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("root", nargs="?", type=Path, help="another checkout, whose figures are printed and not written")
    root = parser.parse_args().root
    figures = tree_figures(root or ROOT)
    for name, value in figures.items():
        print(f"{name}: {value}")
    if root is None:
        page = ROOT / "docs" / "architecture.md"
        page.write_text(described(page.read_text(encoding="utf-8"), ROOT, figures), encoding="utf-8")


def tree_figures(root: Path) -> dict[str, str]:
    """Count the lines of the package by what they hold, by row in the table.

    Args:
        root: a checkout.
    """
    texts = [file.read_text(encoding="utf-8") for folder in FOLDERS for file in sorted((root / folder).rglob("*.py"))]
    kinds = sum((line_kinds(text) for text in texts), Counter())
    pages = [page for page in (root / "docs").glob("*.md")]
    return {
        "modules": f"{len(texts):,}",
        "lines of the package": f"{sum(kinds.values()):,}",
        **{f"- {kind}": f"{kinds[kind]:,}" for kind in ("code", "docstrings", "comments", "blank")},
        "median lines of a module": f"{statistics.median(text.count(chr(10)) for text in texts):g}",
        "kB of docs/": f"{sum(page.stat().st_size for page in pages) / 1e3:.0f}",
    }


def line_kinds(text: str) -> Counter[str]:
    """How many lines of a module are code, docstrings, comments and blank."""
    lines = text.splitlines()
    documented = set()
    for node in ast.walk(ast.parse(text)):
        if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef) and ast.get_docstring(node):
            first = node.body[0]
            documented |= set(range(first.lineno, (first.end_lineno or first.lineno) + 1))
    kinds: Counter[str] = Counter()
    for number, line in enumerate(lines, start=1):
        stripped = line.strip()
        kind = (
            "docstrings" if number in documented else "comments" if stripped.startswith("#") else "code" if stripped else "blank"
        )
        kinds[kind] += 1
    return kinds


def described(text: str, root: Path, figures: dict[str, str]) -> str:
    """The page with its rooms and the last column of its figures written anew.

    Args:
        text: of the page.
        root: the checkout that it describes.
        figures: see `tree_figures`.
    """
    text = re.sub(
        r"(<!-- rooms -->\n).*?(<!-- /rooms -->)",
        lambda match: f"{match[1]}{rooms_table(root)}\n{match[2]}",
        text,
        flags=re.DOTALL,
    )
    for name, value in figures.items():
        row = re.compile(rf"(?m)^(\| {re.escape(name)} \| [^|]* \| )[^|]*\|$")
        if not row.search(text):
            raise SystemExit(f"docs/architecture.md has no row for {name!r}")
        text = row.sub(lambda match, value=value: f"{match[1]}{value} |", text)
    return text


def rooms_table(root: Path) -> str:
    """Each package and what it is for, as Markdown."""
    rows = ["| room | what it holds |", "| --- | --- |"]
    for folder in FOLDERS:
        for file in sorted((root / folder).rglob("__init__.py")):
            about = (ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or "").partition("\n")[0]
            rows.append(f"| `{file.parent.relative_to(root).as_posix()}/` | {about} |")
    return "\n".join(rows)


if __name__ == "__main__":
    main()
