"""Published tables as text: CSV, LaTeX and Markdown, read into cells of a method, a scene, a metric
and a printed number.
"""

import csv
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from decimal import Decimal
from pathlib import Path
from statistics import fmean

from ggvs_eval.errors import MetricError, ResultsError
from ggvs_eval.metrics.registry import METRICS

Grid = list[list[str]]
LARGEST = 1_000_000  # bytes; tables of papers have a few thousand
NUMBER = re.compile(r"[-+]?(?:\d+(?:[.,]\d+)?|\.\d+)(?![\w.])")
SCENES, METHODS = (
    ("scene", "dataset", "data set", "sequence", "capture"),
    ("method", "methods", "model", "approach"),
)
METRIC, VALUE = ("metric", "column"), ("shown", "value", "score")
MEANS = ("mean", "avg", "average", "all", "overall")
ALIASES = {
    "sssim": "SSIM",
    "dssim": "DSSIM1",
    "msssim": "MS_SSIM",
    "strred": "STED",
    "ivpsnr": "IV_PSNR",
}
# x 10^2, [1e-2], (x100), 100 x: what multiplied the numbers, or what they are to be multiplied by;
# 100 x 100 is a size.
SCALE = re.compile(
    r"(?:(?:×|x|\*|·|times)\s*1(?:0\s*\^?|e)|\b1(?:0\s*\^|e))[\s{(]*[-−+]?\s*0*(?P<power>[1-9])\b"
    r"|(?:(?<!\d)(?<!\d "
    r")(?:×|x|\*)\s*1|\b1(?=0+\s*(?:×|x|\*)(?!\s*\d)))(?P<zeros>0+)(?:\s*[×x*]|\b)",
    re.IGNORECASE,
)
NETWORK = re.compile(r"lpips.*?(?<![a-z])(alex|vgg)(?:net)?(?![a-z])", re.IGNORECASE)
# What a head says beside its metric; SqueezeNet's LPIPS is none of this tool.
BESIDE = re.compile(
    r"\((?!squeeze).*?\)|\[(?!squeeze).*?\]|[↑↓%]|×.*|(?<=lpips)[\W_]*(?:alex|vgg)(?:net|-?\d+)?(?![a-z])",
    re.IGNORECASE,
)
ARGUMENT = r"(?:\[[^\]]*\])?\{[^{}]*\}"
TABULAR = re.compile(r"\\begin\{(tabular[x*y]?|tblr|array)\}(.*?)\\end\{\1\}", re.DOTALL)
RULES = re.compile(
    r"\\(?:top|mid|bottom|h)(?:rule|line)\b(?:\[[^\]]*\])?|\\(?:cmidrule|cline|specialrule|addlinespace)(?:\([^)]*\))?"
    rf"(?:{ARGUMENT})*|\\(?:row|cell|column)color(?:\[[^\]]*\])?\{{[^{{}}]*\}}"
)
SIGNS = {
    r"\uparrow": "↑",
    r"\downarrow": "↓",
    r"\pm": "±",
    r"\times": "×",
    r"\%": "%",
    r"\&": "&",
    r"\_": "_",
    r"\,": "",
    "~": " ",
}


@dataclass(frozen=True)
class QuotedCell:
    """One printed number.

    Attributes:
        method: name of its row.
        scene: scene as the table calls it; empty for a mean over all.
        metric: key of the metric.
        text: number as printed, on the metric's own scale (a column in per cent is divided by 100).
        row: index of its row among those with numbers.
        column: index of its column in the file.
        title: text above it, or in its row as its metric.
    """

    method: str
    scene: str
    metric: str
    text: str
    row: int
    column: int
    title: str = ""

    @property
    def network(self) -> str:
        """Network that its head names: ``alex`` or ``vgg``; empty if none."""
        return "".join(NETWORK.findall(self.title)[:1]).lower()

    @property
    def heads(self) -> tuple[int, str, str]:
        """What it is compared under: a column of a long table, or one below several scenes, holds
        numbers of many kinds.
        """
        return self.column, self.metric, self.scene


@dataclass(frozen=True)
class QuotedTable:
    """The numbers of a published table.

    Attributes:
        cells: by rows.
        left_out: column head -> why its numbers are not checked.
    """

    cells: tuple[QuotedCell, ...]
    left_out: dict[str, str]


def read_quoted(file: Path, metric: str = "") -> QuotedTable:
    """Read a table: a method per row, and a metric or a scene per column.

    Or columns method, scene, metric and value.

    Args:
        file: ``.csv``, ``.tsv``, ``.tex`` or ``.md``, of several tables in one file all; or
            ``.json`` as 3DGS's metrics.py writes it, ``results.json`` or ``per_view.json``.
        metric: metric of all columns, if these are scenes.

    Raises:
        ResultsError: no such file, no table, or no number that belongs to a metric.
        MetricError: an unknown metric.
    """
    if metric and not metric_key(metric):
        raise MetricError(
            f"wanted a metric of this tool, got {metric!r}; known are {', '.join(METRICS)}"
        )
    readers = {
        ".csv": _csv_grids,
        ".tsv": _csv_grids,
        ".tex": _tex_grids,
        ".md": _markdown_grids,
        ".json": _json_grids,
    }
    if file.suffix.lower() not in readers:
        raise ResultsError(
            f"{file}: wanted a table as {', '.join(readers)}, got {file.suffix or 'no suffix'}; "
            f"convert it"
        )
    try:
        if file.stat().st_size > LARGEST:
            raise ResultsError(
                f"{file}: wanted a table below {LARGEST:,} bytes, got more; keep only the table"
            )
        text = file.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeError) as error:
        raise ResultsError(f"{file}: wanted a table as text in UTF-8, got: {error}") from None
    cells: list[QuotedCell] = []
    left_out: dict[str, str] = {}
    for grid in readers[file.suffix.lower()](text):
        rows = 1 + max((cell.row for cell in cells), default=-1)
        for cell in _cells(grid, metric_key(metric), left_out):
            scene = "" if cell.scene.lower().rstrip(".") in MEANS else cell.scene
            cells.append(replace(cell, scene=scene, row=cell.row + rows))
    if not cells:
        ignored = f" (columns {', '.join(left_out)})" if left_out else ""
        raise ResultsError(
            f"{file}: wanted numbers under heads such as PSNR or LPIPS, got none{ignored}; "
            "if columns are scenes, name the metric with --metric"
        )
    return QuotedTable(tuple(cells), left_out)


def metric_key(head: str) -> str:
    """Return the metric that a column's head names; empty if it names none.

    Examples:
        >>> (
        ...     metric_key("PSNR (dB) ↑"),
        ...     metric_key("ms-ssim"),
        ...     metric_key("LPIPS-Alex x100"),
        ...     metric_key("FPS"),
        ... )
        ('PSNR', 'MS_SSIM', 'LPIPS', '')
    """
    name = BESIDE.sub(" ", SCALE.sub(" ", head))
    plain = {re.sub(r"\W|_", "", key).lower(): key for key in METRICS} | ALIASES
    return plain.get(re.sub(r"\W|_", "", name).lower(), "")


def _csv_grids(text: str) -> Iterator[Grid]:
    delimiter = max(",;\t", key=text.partition("\n")[0].count)
    yield [
        [cell.strip() for cell in row]
        for row in csv.reader(text.splitlines(), delimiter=delimiter)
        if any(row)
    ]


def _json_grids(text: str) -> Iterator[Grid]:
    """Read method -> metric -> number, or numbers of pictures, whose mean is taken.

    Whatever the methods are in is a scene.
    """
    import json

    rows: dict[tuple[str, str], dict[str, float]] = {}

    def visit(names: tuple[str, ...], node: object) -> None:
        if not isinstance(node, dict):
            return
        for name, value in node.items():
            numbers = [*value.values()] if isinstance(value, dict) else [value]
            if (
                metric_key(name)
                and numbers
                and all(isinstance(number, int | float) for number in numbers)
            ):
                scene, method = ("", "", *names)[-2:]
                rows.setdefault((scene, method), {})[name] = fmean(numbers)
            else:
                visit((*names, name), value)

    try:
        visit((), json.loads(text))
    except ValueError as error:
        raise ResultsError(f"the table is not JSON ({error}); write it again") from None
    metrics = list(dict.fromkeys(metric for row in rows.values() for metric in row))
    cells = [
        [scene, method, *(repr(row[metric]) if metric in row else "" for metric in metrics)]
        for (scene, method), row in rows.items()
    ]
    yield [["scene", "method", *metrics], *cells]


def _markdown_grids(text: str) -> Iterator[Grid]:
    for block in re.split(r"\n\s*\n", text):
        rows = [
            line.strip().strip("|").split("|")
            for line in block.splitlines()
            if line.lstrip().startswith("|")
        ]
        plain = [[re.sub(r"[*`]|<[^>]*>", "", cell).strip() for cell in row] for row in rows]
        if grid := [row for row in plain if not all(re.fullmatch(r":?-+:?", cell) for cell in row)]:
            yield grid


def _tex_grids(text: str) -> Iterator[Grid]:
    plain = re.sub(r"(?<!\\)%.*", "", text)
    for match in TABULAR.finditer(plain):
        body = RULES.sub(
            " ", re.sub(r"^\s*(?:\[[^\]]*\])?(?:\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\})+", "", match[2])
        )
        rows = [
            re.split(r"(?<!\\)&", row)
            for row in re.split(r"\\\\(?:\[[^\]]*\])?|\\tabularnewline", body)
        ]
        if grid := [
            row
            for row in ([cell for part in row for cell in _tex_cells(part)] for row in rows)
            if any(row)
        ]:
            yield grid


def _tex_cells(text: str) -> list[str]:
    """Return the plain text of a cell, repeated over the columns that it spans."""
    spanned = re.search(r"\\multicolumn\s*\{(\d+)\}\s*\{[^{}]*(?:\{[^{}]*\}[^{}]*)*\}", text)
    if spanned:
        text = text.replace(spanned[0], "", 1)
    text = re.sub(r"\\multirow(?:\[[^\]]*\])?\{[^{}]*\}(?:\[[^\]]*\])?\{[^{}]*\}", "", text)
    text = re.sub(
        r"\\(?:cite\w*|ref|footnote\w*|label|color|textcolor|hspace|vspace)\*?(?:\[[^\]]*\])*\{[^{}]*\}",
        "",
        text,
    )
    for sign, meaning in SIGNS.items():
        text = re.sub(
            re.escape(sign) + (r"(?![A-Za-z])" if sign[-1].isalpha() else ""), meaning, text
        )
    text = re.sub(r"\\[A-Za-z]+\*?|[{}$]", " ", text)
    return [" ".join(text.split())] * (int(spanned[1]) if spanned else 1)


def _cells(grid: Grid, metric: str, left_out: dict[str, str]) -> Iterator[QuotedCell]:
    """Find heads, names and numbers of one table.

    Columns without a metric are noted in `left_out`.
    """
    width = max(map(len, grid))
    grid = [row + [""] * (width - len(row)) for row in grid]
    first = next((at for at, row in enumerate(grid) if any(map(_is_number, row))), len(grid))
    heads, body = grid[:first], grid[first:]
    lowest = [cell.lower() for cell in heads[-1]] if heads else [""] * width
    if _column(lowest, METRIC) >= 0 and _column(lowest, VALUE) >= 0:
        yield from _long_cells(body, lowest, left_out)
        return
    words = [at for at in range(width) if not any(_is_number(row[at]) for row in body)]
    scene_at = next((at for at in words if any(row[at].lower() in SCENES for row in heads)), -1)
    method_at = next((at for at in words if at != scene_at), -1)
    names = ["", ""]
    index = 0
    for row in body:
        names = [
            row[at] or name if at >= 0 else ""
            for at, name in zip((method_at, scene_at), names, strict=True)
        ]
        if not any(map(_is_number, row)):
            continue
        for at in range(width):
            if not _is_number(row[at]):
                continue
            stack = [head[at] for head in heads]
            named = next(filter(None, map(metric_key, reversed(stack))), "") or metric
            title = " ".join(filter(None, dict.fromkeys(stack)))
            if not named:
                left_out[title or f"column {at + 1}"] = "names no metric of this tool"
                continue
            scene = next((head for head in stack if head and not metric_key(head)), names[1])
            yield QuotedCell(
                method=names[0],
                scene=scene,
                metric=named,
                text=_on_own_scale(row[at], title),
                row=index,
                column=at,
                title=title,
            )
        index += 1


def _long_cells(body: Grid, heads: Sequence[str], left_out: dict[str, str]) -> Iterator[QuotedCell]:
    places = [_column(heads, words) for words in (METHODS, SCENES, METRIC, VALUE)]
    for index, row in enumerate(body):
        method, scene, title, value = (row[at] if at >= 0 else "" for at in places)
        key = metric_key(title)
        if not key:
            left_out[title] = "names no metric of this tool"
        elif _is_number(value):
            yield QuotedCell(
                method=method,
                scene=scene,
                metric=key,
                text=_on_own_scale(value, title),
                row=index,
                column=places[-1],
                title=title,
            )


def _column(heads: Sequence[str], names: Sequence[str]) -> int:
    return next((heads.index(name) for name in names if name in heads), -1)


def _is_number(text: str) -> bool:
    """True for a cell that is a number, perhaps with a mark, a spread or a unit behind it.

    Not for a name with digits.
    """
    return (
        re.match(r"\s*(?![-+]?[\d.,]+\s*(?:[×x*]\s*)?[A-Za-z]{3,})" + NUMBER.pattern, text)
        is not None
    )


def _on_own_scale(cell: str, head: str) -> str:
    """Return a printed number divided by the power of ten that its head or its cell names, with all
    its digits.

    Examples:
        >>> (
        ...     _on_own_scale("93.6", "SSIM (%)"),
        ...     _on_own_scale("8.45", "LPIPS [1e-2]"),
        ...     _on_own_scale("8", "L1"),
        ... )
        ('0.936', '0.0845', '8')
        >>> (
        ...     _on_own_scale("93.6", "SSIM (x100)"),
        ...     _on_own_scale("93.6", "100 x SSIM"),
        ...     _on_own_scale("93.6%", "SSIM"),
        ... )
        ('0.936', '0.936', '0.936')
    """
    text, words = NUMBER.findall(cell)[0].replace(",", "."), f"{head} {cell}"
    match = SCALE.search(words)
    power = int(match["power"] or len(match["zeros"])) if match else 2 * ("%" in words)
    return f"{Decimal(text).scaleb(-power):f}" if power else text
