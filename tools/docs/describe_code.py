"""Parts of the documentation that the code determines.

``python tools/docs/describe_code.py`` writes the keys of docs/protocol.md, from the classes of a
protocol. Rooms are a page of the site, made from docstrings while it is built (`site_pages`).
"""

import ast
import dataclasses
import re
from pathlib import Path
from typing import Any, Literal, get_args, get_origin, get_type_hints

from ggvs_eval import metric_choices, protocol
from ggvs_eval.files.toml_tables import key_of

ROOT = Path(__file__).parents[2]
FOLDERS = ("ggvs_eval", "baselines", "contrib", "metrics", "pipelines", "reports")
SECTIONS = {  # of a protocol's file, in the order in which a reader needs them
    "": protocol.Protocol,
    "views": protocol.Views,
    "frames": protocol.Frames,
    "synthesis": protocol.Synthesis,
    "measurement": protocol.Measurement,
    "path": protocol.CameraPath,
    "stream": protocol.Stream,
}
INHERITED = {"measurement": metric_choices.MetricChoices}
# Keys that hold a section of their own, or tables that the viewer writes and nobody types.
LEFT_OUT = {"": set(SECTIONS) | {"stream"}, "path": {"cameras", "frame"}}
# where the default is no value
NOT_SET = {"name": "the file's name", "dataset": "`name`", "depth_ms": "that of the run"}


def main() -> None:
    """Write the table of keys again."""
    write_part(ROOT / "docs" / "protocol.md", "keys", keys_table())


def write_part(page: Path, name: str, text: str) -> None:
    """Replace what stands between the marks of a name."""
    head, _, rest = page.read_text(encoding="utf-8").partition(f"<!-- {name} -->\n")
    tail = rest.partition(f"<!-- /{name} -->")[2]
    page.write_text(f"{head}<!-- {name} -->\n{text}\n<!-- /{name} -->{tail}", encoding="utf-8")


def rooms_table(root: Path) -> str:
    """Each package and what it is for, as Markdown."""
    rows = ["| room | what it holds |", "| --- | --- |"]
    for folder in FOLDERS:
        for file in sorted((root / folder).rglob("__init__.py")):
            about = (
                ast.get_docstring(ast.parse(file.read_text(encoding="utf-8"))) or ""
            ).partition("\n")[0]
            rows.append(f"| `{file.parent.relative_to(root).as_posix()}/` | {about} |")
    return "\n".join(rows)


def keys_table() -> str:
    """Each key of a protocol with its default and meaning, as Markdown, by the docstrings of its
    classes.
    """
    rows = ["| key | default | meaning |", "| --- | --- | --- |"]
    for section, table in SECTIONS.items():
        meanings = _meanings(table) | _meanings(INHERITED.get(section, table))
        for each in dataclasses.fields(table):
            if each.name not in LEFT_OUT.get(section, set()):
                key = f"{section}.{key_of(each.name)}" if section else each.name
                rows.append(
                    f"| `{key}` | {_default(each)} | "
                    f"{meanings[each.name]}{_choices(table, each.name)} |"
                )
    return "\n".join(rows)


def _meanings(table: type) -> dict[str, str]:
    """What the docstring of a class says of its attributes, without references to code."""
    section = re.search(
        r"^ *Attributes:\n(.*)", table.__doc__ or "", flags=re.MULTILINE | re.DOTALL
    )
    meanings = {}
    for entry in re.split(r"\n(?= {8}\w+: )", "\n" + section[1] if section else ""):
        name, _, text = " ".join(entry.split()).partition(": ")
        text = (
            re.sub(r",? see `ggvs_eval[\w.]+`(?:\.\w+)?", "", text).replace("``", "`").rstrip(".")
        )
        meanings[name] = re.sub(r"`ggvs_eval\.pipelines\.run\.folds\.choose_folds`", "`run`", text)
    return meanings


def _choices(table: type, name: str) -> str:
    hint = get_type_hints(table)[name]
    words = get_args(hint) if get_origin(hint) is Literal else ()
    return f"; one of {', '.join(f'`{word}`' for word in words)}" if len(words) > 1 else ""


def _default(each: "dataclasses.Field[Any]") -> str:
    if each.name in NOT_SET:
        return NOT_SET[each.name]
    if each.default is dataclasses.MISSING:
        return "**required**"
    if each.default == ():
        return "`[]`"
    return f"`{protocol._toml_value(each.default)}`"  # as `Protocol.to_toml` writes it


if __name__ == "__main__":
    main()
