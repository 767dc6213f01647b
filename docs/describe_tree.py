"""Write the rooms of docs/architecture.md, by the first lines of their docstrings: ``python docs/describe_tree.py``."""

import ast
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("ggvs_eval", "baselines", "contrib", "metrics", "pipelines", "reports")


def main() -> None:
    """Write the table of rooms anew."""
    page = ROOT / "docs" / "architecture.md"
    head, _, rest = page.read_text(encoding="utf-8").partition("<!-- rooms -->\n")
    tail = rest.partition("<!-- /rooms -->")[2]
    page.write_text(f"{head}<!-- rooms -->\n{rooms_table(ROOT)}\n<!-- /rooms -->{tail}", encoding="utf-8")


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
