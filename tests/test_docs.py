"""The pages: links of README and docs/ lead somewhere, what they name exists, and the README stays
a front door.
"""

import ast
import importlib
import json
import re
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import get_args

import pytest

from ggvs_eval import plugins
from ggvs_eval.protocol import load_protocol

ROOT = Path(__file__).parents[1]
README_BYTES = 7500
DOCS_BYTES = 140_000
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted((ROOT / "benchmarks").glob("*.md")),
    *sorted((ROOT / "docs").glob("*.md")),
]
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FILE = re.compile(
    r"(?<![\w./-])(?:ggvs_eval|baselines|metrics|pipelines|reports|tests|benchmarks|docs)/[\w./-]*\w"
)
MODULE = re.compile(r"\bggvs_eval(?:\.\w+)+")

pytestmark = pytest.mark.skipif(
    not (ROOT / "docs").is_dir(), reason="an installed wheel has no pages; a checkout has"
)


def prose(page: Path) -> str:
    """A page without its blocks of code."""
    return re.sub(
        r"^```.*?^```", "", page.read_text(encoding="utf-8"), flags=re.DOTALL | re.MULTILINE
    )


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as GitHub and MkDocs make them."""
    heads = re.findall(r"^#+ (.*)$", prose(page), flags=re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", head.lower()).strip().replace(" ", "-") for head in heads}


def dead_links(page: Path) -> Iterator[str]:
    """Links of a page within the repository that lead nowhere."""
    for target in LINK.findall(prose(page)):
        path, _, anchor = target.partition("#")
        if "://" in path:
            continue
        file = (page.parent / path).resolve() if path else page
        if not file.exists() or (anchor and anchor not in anchors(file)):
            yield target


def source_of(module: str) -> Path | None:
    """The file of a module or package of the checkout; None where there is none."""
    parts = module.split(".")[1:]
    folder = ROOT if parts and (ROOT / parts[0] / "__init__.py").is_file() else ROOT / "ggvs_eval"
    stem = folder.joinpath(*parts)
    return next(
        (file for file in (stem.with_suffix(".py"), stem / "__init__.py") if file.is_file()), None
    )


def is_defined(name: str) -> bool:
    """Whether a dotted name is a module, or a word of one."""
    module, _, word = name.rpartition(".")
    return bool(source_of(name)) or bool(
        (file := source_of(module)) and re.search(rf"\b{word}\b", file.read_text("utf-8"))
    )


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_what_a_page_names_exists(page):
    """Links to files and headings, of docs/ within docs/ alone; paths of the repository; modules,
    and words of them.
    """
    text = page.read_text(encoding="utf-8")
    assert list(dead_links(page)) == []
    if page.parent.name == "docs":
        assert [target for target in LINK.findall(prose(page)) if target.startswith("..")] == []
    assert [
        name for name in FILE.findall(text) if not (ROOT / name.replace("METHOD", "fwd")).exists()
    ] == []
    named = set(MODULE.findall(text)) - {f"ggvs_eval.{kind}" for kind in get_args(plugins.Kind)}
    assert [name for name in sorted(named) if not is_defined(name)] == []


def test_the_readme_is_a_front_door():
    """At most 7.5 kB, with two tables that scripts fill; the rest is in docs/."""
    text = (ROOT / "README.md").read_text(encoding="utf-8")

    assert len(text.encode()) <= README_BYTES
    assert sum(page.stat().st_size for page in (ROOT / "docs").glob("*.md")) <= DOCS_BYTES
    assert re.findall(r"<!-- (\w+) -->", text) == ["sparse", "real_frame"]
    assert (ROOT / "docs" / "images" / "demo.webp").stat().st_size <= 1.5e6


def test_every_page_is_in_the_site():
    """Each page of docs/ is in the navigation of the site, which makes those of the command line
    and of rooms itself.
    """
    listed = re.findall(
        r"^ +- [^:]+: (\S+\.md)$",
        (ROOT / "mkdocs.yml").read_text(encoding="utf-8"),
        flags=re.MULTILINE,
    )

    assert sorted(listed) == sorted(
        ["cli.md", "rooms.md", *(page.name for page in (ROOT / "docs").glob("*.md"))]
    )


def test_the_protocols_keys_are_those_of_the_code():
    """Every key of a protocol is listed with its default and meaning; `python
    tools/docs/describe_code.py` writes them.
    """
    page = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    sys.path.insert(0, str(ROOT / "tools" / "docs"))
    import describe_code

    assert f"<!-- keys -->\n{describe_code.keys_table()}\n<!-- /keys -->" in page
    for key in ("views.test", "synthesis.k", "measurement.lpips_net", "stream.fps"):
        assert f"| `{key}` |" in page


def test_the_example_of_a_protocol_is_one(tmp_path):
    """Both files of the protocol's page are read, and the longer one says what it sets."""
    page = (ROOT / "docs" / "protocol.md").read_text(encoding="utf-8")
    shortest, longer = re.findall(r"```toml\n(.*?)```", page, flags=re.DOTALL)
    for name, text in (("mine", shortest), ("studio", longer)):
        (tmp_path / f"{name}.toml").write_text(text, encoding="utf-8")
    assert load_protocol(tmp_path / "mine.toml").views.test == ("cam02", "cam05")
    studio = load_protocol(tmp_path / "studio.toml")
    assert (studio.dataset, studio.frames.count, studio.measurement.lpips_net) == (
        "Studio, take 3",
        120,
        "alex",
    )


def test_the_architecture_is_that_of_the_tree():
    """The files that it names exist, and every room has a line that the site's page of rooms can
    show.
    """
    page = (ROOT / "docs" / "architecture.md").read_text(encoding="utf-8")
    sys.path.insert(0, str(ROOT / "tools" / "docs"))
    import describe_code

    named = re.findall(r"`((?:ggvs_eval|pipelines|reports|tests)/[\w/]+\.py)`", page)
    assert len(named) > 8
    assert [name for name in named if not (ROOT / name).is_file()] == []
    rows = describe_code.rooms_table(ROOT).splitlines()[2:]
    assert len(rows) > 50
    assert [row for row in rows if not re.fullmatch(r"\| `[\w/]+/` \| \S.{15,} \|", row)] == []


def test_the_notebook_is_code_of_today():
    """Each cell compiles and what it imports exists; `make docs` runs it, and an error in it is one
    of the site.
    """
    cells = json.loads((ROOT / "docs" / "notebook.ipynb").read_text(encoding="utf-8"))["cells"]
    trees = [ast.parse("".join(cell["source"])) for cell in cells if cell["cell_type"] == "code"]
    imports = [
        node for tree in trees for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)
    ]
    named = [
        (node.module, alias.name)
        for node in imports
        for alias in node.names
        if node.module.startswith("ggvs_eval")
    ]
    settings = (ROOT / "mkdocs.yml").read_text(encoding="utf-8")

    assert [name for name in named if not hasattr(importlib.import_module(name[0]), name[1])] == []
    assert len(named) > 5
    assert not any(cell.get("outputs") for cell in cells)
    assert re.search(r"mkdocs-jupyter:.*execute: true\n\s+allow_errors: false", settings, re.DOTALL)
