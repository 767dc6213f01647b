"""A table as plain text."""

import io
from collections.abc import Collection, Iterable, Sequence


def text_table(columns: Sequence[str], rows: Iterable[Sequence[str]], width: int, stretched: Collection[str] = ()) -> str:
    """Lay out rows under their headings.

    Args:
        columns: headings.
        rows: cells, one for each heading.
        width: of the text, characters.
        stretched: headings of the columns that share what space is left; the others are never wrapped.
    """
    from rich import box
    from rich.console import Console
    from rich.table import Table

    table = Table(box=box.SIMPLE_HEAD, pad_edge=False)
    for column in columns:
        table.add_column(column, ratio=1 if column in stretched else None, no_wrap=column not in stretched, overflow="fold")
    for row in rows:
        table.add_row(*row)
    text = io.StringIO()
    Console(file=text, width=width, color_system=None, highlight=False, markup=False).print(table)
    return "\n".join(line.rstrip() for line in text.getvalue().splitlines()).strip("\n")
