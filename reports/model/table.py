"""A table before it has a format: every cell is a value with its text and standing, or the reason
why there is none.
"""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

from ggvs_eval.statistics.intervals import LEVEL, Interval
from ggvs_eval.statistics.paired import Judgement

SIGNIFICANT = 4
DASH = "–"  # of a cell whose reason is in its note, and once below the table
SHORT = "†"  # behind an interval of a clip too short for it
SHORT_MEANS = (
    f"{SHORT}: the clip is short for the correlation of its errors, and the interval may cover "
    "less than it says."
)

ENDINGS = {
    "static": "static",
    "moving": "moving",
    "disoccluded": "disoccluded",
    "cc": "colour-corrected",
}

RowKind = Literal["measured", "ours", "partial", "faulty", "published", "reference"]
GREY: tuple[RowKind, ...] = ("published", "reference")


@dataclass(frozen=True)
class Column:
    """Head of a column.

    Attributes:
        unit: unit of its values; empty if there is none.
        higher_is_better: direction; None where values are not ranked.
        describe: what it is, one sentence.
    """

    name: str
    unit: str = ""
    higher_is_better: bool | None = None
    describe: str = ""

    @property
    def head(self) -> str:
        """Name and direction as the field writes them.

        Examples:
            >>> [
            ...     Column(name, higher_is_better=True).head
            ...     for name in ("PSNR", "MS_SSIM", "PSNR_cc_static")
            ... ]
            ['PSNR ↑', 'MS-SSIM ↑', 'PSNR, colour-corrected, static ↑']
        """
        name = self.name
        parts: list[str] = []
        while (
            ending := next((suffix for suffix in ENDINGS if name.endswith(f"_{suffix}")), "")
        ) and name != ending:
            name, parts = name.removesuffix(f"_{ending}"), [ENDINGS[ending], *parts]
        return " ".join(
            filter(
                None,
                (
                    ", ".join([name.replace("_", "-" if name.isupper() else " "), *parts]),
                    self.arrow,
                ),
            )
        )

    @property
    def arrow(self) -> str:
        """Direction in which values get better; empty if they are not ranked."""
        return {True: "↑", False: "↓", None: ""}[self.higher_is_better]


@dataclass(frozen=True)
class Cell:
    """One value as it is shown.

    Attributes:
        text: rounded value and nothing else, or the reason why there is none; never empty.
        value: unrounded; None if there is none.
        best: its column's judgement marks it: the best, or not worse than that.
        shade: strength of the blue behind it, 0 to 1.
        spread: rounded half width of its interval, ``± 0.21``, with `SHORT` where it is not to be
            relied on; empty if there is none.
        low: lower bound of the interval, unrounded; None if there is none.
        high: upper bound; None where `low` is.
        note: what the interval takes as given, or why there is none.
        bound: ``at most`` or ``at least``, before the value, where it is a bound.
        beside: text after the value, such as a percentile.
        unranked: why the value is neither marked as best nor kept from it by others, as it follows
            the method's name; empty where it competes.
        place: view and frame that the value is of, where it is of one.
    """

    text: str
    value: float | None = None
    best: bool = False
    shade: float = 0.0
    spread: str = ""
    low: float | None = None
    high: float | None = None
    note: str = ""
    bound: str = ""
    beside: str = ""
    unranked: str = ""
    place: tuple[str, int] | None = None

    @property
    def shown(self) -> str:
        """The value with its words, the same in every format."""
        return " ".join(filter(None, (self.bound, self.text, self.beside)))

    @property
    def is_short(self) -> bool:
        """True if the clip is too short for the interval."""
        return self.spread.endswith(SHORT)

    @property
    def hint(self) -> str:
        """One line about the interval, or why there is no value or rank.

        Empty if nothing is known of these.
        """
        if self.value is None:
            return self.note
        unranked = f"not ranked: it {self.unranked}" if self.unranked else ""
        if self.low is None or self.high is None:
            return "; ".join(
                filter(None, (f"no interval: {self.note}" if self.note else "", unranked))
            )
        interval = f"{100 * LEVEL:.0f} % interval {self.low:.6g} to {self.high:.6g}"
        return "; ".join(filter(None, (", ".join(filter(None, (interval, self.note))), unranked)))


@dataclass(frozen=True)
class Row:
    """One method, measured or published, or a reference that is no method.

    ``label`` is that of a measured method.
    """

    name: str
    cells: tuple[Cell, ...]
    kind: RowKind = "measured"
    label: str = ""

    @property
    def is_grey(self) -> bool:
        """True for a row that is shown for comparison and not ranked."""
        return self.kind in GREY

    @property
    def competes(self) -> bool:
        """True for a method that was measured on everything that the table is of, and whose renders
        have no certain fault.
        """
        return self.kind in ("measured", "ours")


@dataclass(frozen=True)
class Table:
    """Rows and columns with a title, and notes that belong below them.

    Attributes:
        key: short name for files, labels and anchors.
        caption: what it shows, as short as a paper has it.
        columns: heads, without the column of names.
        rows: measured rows first, published ones last.
        dataset: what was measured on.
        notes: method and limits of comparison, in sentences.
        judgements: name of a column -> which methods are better than which in it.
    """

    key: str
    title: str
    caption: str
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    dataset: str = ""
    notes: tuple[str, ...] = ()
    judgements: Mapping[str, Judgement] = field(default_factory=dict)

    @property
    def footnote(self) -> str:
        """Meaning of the dashes; empty if there is none."""
        reasons = dict.fromkeys(
            cell.note for row in self.rows for cell in row.cells if cell.text == DASH and cell.note
        )
        return f"{DASH}: {', or '.join(reasons)}." if reasons else ""


def join_tables(tables: Sequence[Table], names: Sequence[str]) -> tuple[Table, ...]:
    """Return one table per data set with these columns alone, in this order, from any tables.

    Args:
        tables: whose columns are metrics.
        names: of the columns.
    """
    by_dataset: dict[str, list[Table]] = {}
    for table in tables:
        by_dataset.setdefault(table.dataset, []).append(table)
    return tuple(_joined(parts, tuple(dict.fromkeys(names))) for parts in by_dataset.values())


def _joined(tables: Sequence[Table], names: Sequence[str]) -> Table:
    """Return the tables of one data set as one; a row that lacks a column has a dash there."""
    places = [
        (table, at)
        for name in names
        for table in tables
        for at, column in enumerate(table.columns)
        if column.name == name
    ]
    kinds = {row.name: (row.kind, row.label) for table in tables for row in table.rows}
    cells = {(table.key, row.name): row.cells for table in tables for row in table.rows}
    rows = []
    for name in sorted(kinds, key=lambda name: kinds[name][0] in GREY):  # stable: grey rows last
        row_cells = (
            cells[table.key, name][at] if (table.key, name) in cells else Cell(DASH)
            for table, at in places
        )
        row = Row(name, tuple(row_cells), *kinds[name])
        if not row.is_grey or any(cell.value is not None for cell in row.cells):
            rows.append(row)
    notes = tuple(dict.fromkeys(note for table in tables for note in table.notes))
    columns = tuple(table.columns[at] for table, at in places)
    judgements = {
        name: judgement
        for table in tables
        for name, judgement in table.judgements.items()
        if name in names
    }
    return Table(
        key="results",
        title="Results",
        caption=tables[0].caption,
        columns=columns,
        rows=tuple(rows),
        dataset=tables[0].dataset,
        notes=notes,
        judgements=judgements,
    )


def measured_cell(
    value: float | None, reason: str, interval: Interval | None = None, decimals: int | None = None
) -> Cell:
    """Return a cell with a rounded value and its interval if there is one, or with the reason for
    its absence.
    """
    if value is None or math.isnan(value):
        return Cell(f"not computed: {reason}")
    if interval is None:
        return Cell(format_value(value, decimals), value)
    half = interval.half_width
    spread = "" if half is None else spread_text(value, half, decimals, interval.is_short)
    return Cell(
        text=format_value(value, decimals),
        value=value,
        best=False,
        shade=0.0,
        spread=spread,
        low=interval.low,
        high=interval.high,
        note=interval.note,
    )


def format_value(value: float, decimals: int | None = None) -> str:
    """Round as the paper does: fixed decimals per metric, four significant digits (None) for what
    spans magnitudes (STED).
    """
    if math.isinf(value):
        return "∞" if value > 0 else "−∞"
    return f"{value:.{_decimals(value, decimals)}f}"


def signed(value: float, decimals: int | None = None) -> str:
    """Return a difference with its sign, rounded as `format_value` does.

    Examples:
        >>> signed(0.25, 2), signed(-0.25, 2), signed(0.0, 2)
        ('+0.25', '−0.25', '0.00')
    """
    return f"{'+' if value > 0 else ''}{format_value(value, decimals)}".replace("-", "−")


def spread_text(
    value: float, half_width: float, decimals: int | None = None, is_short: bool = False
) -> str:
    """Return an interval behind its value, ``± 0.21``, marked where the clip is too short
    for it.
    """
    return f"± {format_half_width(value, half_width, decimals)}{SHORT if is_short else ''}"


def format_half_width(value: float, half_width: float, decimals: int | None = None) -> str:
    """Return half the width of an interval to the digits of its value, or to its first digit where
    that would print 0.
    """
    if half_width <= 0.0:
        return "0"
    decimals = _decimals(value, decimals)
    if float(f"{half_width:.{decimals}f}") == 0.0:
        decimals = -math.floor(math.log10(half_width))
    return f"{half_width:.{decimals}f}"


def _decimals(value: float, decimals: int | None) -> int:
    if decimals is not None:
        return decimals
    magnitude = math.floor(math.log10(abs(value))) if value else 0
    return max(0, SIGNIFICANT - 1 - magnitude) if magnitude > -SIGNIFICANT else 2 * SIGNIFICANT


def rank(
    columns: Sequence[Column], rows: Sequence[Row], marked: Sequence[Collection[str]] = ()
) -> tuple[Row, ...]:
    """Shade the better half of each column and mark what its judgement marks.

    Grey rows are left alone.

    Args:
        marked: per column the labels to mark, see `ggvs_eval.statistics.paired.Judgement`; nothing
            marks none.
    """
    ranked = [list(row.cells) for row in rows]
    competing = [index for index, row in enumerate(rows) if row.competes]
    for at, column in enumerate(columns):
        having = {
            i: v
            for i in competing
            if (v := ranked[i][at].value) is not None and not ranked[i][at].unranked
        }
        if column.higher_is_better is None or len(having) < 2:
            continue
        low, high = min(having.values()), max(having.values())
        spread = high - low if math.isfinite(high - low) else 0.0
        for index, value in having.items():
            standing = (value - low) / spread if spread else 0.0
            standing = 1.0 - standing if spread and not column.higher_is_better else standing
            best = bool(marked) and rows[index].label in marked[at]
            ranked[index][at] = replace(
                ranked[index][at], best=best, shade=shade(standing, column.higher_is_better)
            )
    return tuple(replace(row, cells=tuple(cells)) for row, cells in zip(rows, ranked, strict=True))


def shade(standing: float, higher_is_better: bool) -> float:
    """Strength of the blue behind a value, as the paper's tables colour their better half.

    Args:
        standing: 0 for the worst, 1 for the best value of the column, linear between.
        higher_is_better: columns in which less is better fade faster.

    Returns:
        0 (no colour) up to the middle, then Schlick's gain curve up to 1, which is printed as rgb
        (0.75, 0.75, 1).
    """
    above = max(0.0, 2.0 * standing - 1.0)
    gain = 1.0 - (0.75 if higher_is_better else 0.85)
    return above / ((1.0 / gain - 2.0) * (1.0 - above) + 1.0)
