"""Write what docs/architecture.md says of the tree: rooms, floors and figures: ``python docs/describe_tree.py``.

Rooms are described by the first line of their docstring, floors are those of tests/test_layers.py.
"""

import argparse
import ast
import re
import runpy
import statistics
from pathlib import Path

ROOT = Path(__file__).parents[1]
FOLDERS = ("ggvs_eval", "baselines", "metrics", "pipelines", "reports")
SHORT_LINES = 60
# Classes that hold pixels of a source view on its way from the decoder to the blender, by the names they have had.
VIEW_CLASSES = (
    *("SourceView", "FilteredDepth", "PixelGaussians", "DepthView", "CapturedView"),
    *("Lattice", "Splat", "Registered", "RawViews", "BlendMaps"),
)
ON_THE_WAY = ("ggvs_eval.method", "ggvs_eval.geometry.", "ggvs_eval.baselines.", "ggvs_eval.pipelines.online.")
# Private words that the field's words replaced, as they stood in code and messages.
OLD_WORDS = re.compile(
    r"\b(Wish|wishes_of|Retake|retake|Reel|unfilmed|judge\w*|_judge|told_label|Absence|strangers|RoomLot|ColourHarmony|harmonised"
    r"|claim_run|pour_strictly|do_all)\b"
)


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
    """Count the figures of the tree, by row in the table.

    Args:
        root: a checkout.
    """
    texts = {
        module_name(root, file): file.read_text(encoding="utf-8") for folder in FOLDERS for file in (root / folder).rglob("*.py")
    }
    modules = {name: text for name, text in texts.items() if not name.endswith("__init__")}
    lines = {name: text.count("\n") for name, text in modules.items()}
    importers = importers_of(modules)
    single = [
        name
        for name, users in importers.items()
        if lines[name] < SHORT_LINES and len(users) == 1 and room_of(name) == room_of(*users)
    ]
    aliases = [name for name, text in modules.items() for _ in array_aliases(text) if not name.endswith(".arrays")]
    loose = [name for name in modules if room_of(name) == "ggvs_eval.pipelines"]
    documents = [root / "README.md", *(root / "docs").glob("*.md")]
    views = [
        name
        for module, text in modules.items()
        for name in re.findall(r"(?m)^class (\w+)", text)
        if name in VIEW_CLASSES and f"{module}.".startswith(ON_THE_WAY)
    ]
    words = sum(len(OLD_WORDS.findall(text)) for text in [*texts.values(), *(page.read_text("utf-8") for page in documents)])
    return {
        "modules": str(len(modules)),
        "lines of the package": f"{sum(text.count(chr(10)) for text in texts.values()):,}",
        "median lines of a module": f"{statistics.median(lines.values()):g}",
        f"modules under {SHORT_LINES} lines with one importer, beside them": str(len(single)),
        "aliases of array types outside `ggvs_eval/arrays.py`": str(len(aliases)),
        "loose files in `pipelines/`": str(len(loose)),
        "old private words left": str(words),
        "bytes of the README": f"{(root / 'README.md').stat().st_size:,}",
        "classes that hold pixels of a source view, decoder to blender": str(len(views)),
    } | walk_figures(root)


def walk_figures(root: Path) -> dict[str, str]:
    """Count how capture and protocol are handed on, by row: stays in modules and, of these, returns; see value_walk.py."""
    follow = runpy.run_path(str(ROOT / "docs" / "value_walk.py"))
    code, figures = follow["Code"](root), {}
    for value in follow["FOLLOWED"]:
        path = follow["walk"](code, value)
        for how, steps in (("each function once", follow["once"](path)), ("call by call", path)):
            figures[f"walk of `{value}` from `evaluate`, {how}: stays (returns)"] = "{} ({})".format(*follow["stays"](steps))
    return figures


def module_name(root: Path, file: Path) -> str:
    """Dotted name as it is imported."""
    name = ".".join(file.relative_to(root).with_suffix("").parts)
    return name if name.startswith("ggvs_eval.") else f"ggvs_eval.{name}"


def room_of(name: str) -> str:
    """The folder that a module stands in."""
    return name.rpartition(".")[0]


def importers_of(modules: dict[str, str]) -> dict[str, set[str]]:
    """Module -> modules that import it, at their head or inside functions."""
    importers: dict[str, set[str]] = {name: set() for name in modules}
    for name, text in modules.items():
        for node in ast.walk(ast.parse(text)):
            if isinstance(node, ast.ImportFrom) and node.module:
                for module in {node.module, *(f"{node.module}.{alias.name}" for alias in node.names)} & importers.keys():
                    importers[module].add(name)
    return importers


def array_aliases(text: str) -> list[str]:
    """Names that a module gives to kinds of arrays."""
    aliases = []
    for node in ast.parse(text).body:
        is_subscript = isinstance(node, ast.Assign) and isinstance(node.value, ast.Subscript)
        if is_subscript and ast.unparse(node.value.value) in ("NDArray", "npt.NDArray"):
            aliases += [ast.unparse(target) for target in node.targets]
    return aliases


def described(text: str, root: Path, figures: dict[str, str]) -> str:
    """The page with its rooms, its floors and the last column of its figures written anew.

    Args:
        text: of the page.
        root: the checkout that it describes.
        figures: see `tree_figures`.
    """
    blocks = {"rooms": rooms_table(root), "floors": floors_list(root)}
    for name, block in blocks.items():
        pattern = re.compile(rf"(<!-- {name} -->\n).*?(<!-- /{name} -->)", re.DOTALL)
        text = pattern.sub(lambda match, block=block: f"{match[1]}{block}\n{match[2]}", text)
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


def floors_list(root: Path) -> str:
    """The floors of tests/test_layers.py from the ground up, as a numbered list."""
    floors = runpy.run_path(str(root / "tests" / "test_layers.py"))["FLOORS"]
    return "\n".join(f"{number}. {', '.join(f'`{room}`' for room in rooms)}" for number, rooms in enumerate(floors, start=1))


if __name__ == "__main__":
    main()
