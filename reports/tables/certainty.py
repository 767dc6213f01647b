"""Judgements in words: the best method of each metric, the meaning of ± and bold, and what is not ranked or not called."""

from collections import defaultdict
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

from ggvs_eval.reports.model.table import SHORT_MEANS, Cell, Column, Table
from ggvs_eval.statistics.intervals import LEVEL
from ggvs_eval.statistics.paired import Judgement

HEADLINES = ("PSNR", "SSIM", "LPIPS", "TCC", "STED", "SDT", "SDV")  # those of the paper's tables


@dataclass(frozen=True)
class Leader:
    """Best method in one column of a table.

    Attributes:
        dataset: that the table is of.
        ties: other methods that cannot be distinguished from it.
        short: other methods against which the clip is too short to call it.
    """

    column: Column
    dataset: str
    name: str
    cell: Cell
    ties: tuple[str, ...]
    short: tuple[str, ...]
    judgement: Judgement


def leaders(tables: Sequence[Table], metrics: Sequence[str] = HEADLINES) -> tuple[Leader, ...]:
    """The best method of each wanted metric that has one; of the first table's metrics where none is wanted that was measured."""
    all_leaders = [leader for table in tables for leader in _leaders_of(table)]
    chosen = tuple(leader for leader in all_leaders if leader.column.name in metrics)
    return chosen or tuple(all_leaders[: len(tables[0].columns)] if tables else ())


def _leaders_of(table: Table) -> list[Leader]:
    """One per column that ranks methods."""
    rows = {row.label: row for row in table.rows if row.label}
    found = []
    for at, column in enumerate(table.columns):
        judgement = table.judgements.get(column.name)
        if judgement and judgement.best:
            best = rows[judgement.best]
            ties, short = (
                tuple(rows[each].name for each in judgement.having(*kinds)) for kinds in (("as good", "equal"), ("too short",))
            )
            found.append(Leader(column, table.dataset, best.name, best.cells[at], ties, short, judgement))
    return found


def certainty_captions(
    judgements: Mapping[str, Judgement], names: Mapping[str, str], set_aside: Collection[str]
) -> tuple[list[str], list[str]]:
    """Write the meaning of ± and bold for a table's caption, and for its note what is not ranked or has no interval.

    Args:
        judgements: metric -> who is better than whom.
        names: label -> name to show.
        set_aside: labels of partial and faulty methods, which other sentences are about.
    """
    level = f"{100 * LEVEL:.0f} %"
    bounded = [one for judgement in judgements.values() for one in judgement.intervals.values() if one.low is not None]
    given = "".join(f", {note}" for note in dict.fromkeys(interval.note.partition(";")[0] for interval in bounded) if note)
    brief = [f"±: {level} interval."] if bounded else []
    captions = [f"Intervals are by the correlation over time that each clip allows{given}."] if bounded else []
    captions += [SHORT_MEANS] if any(one.is_short for one in bounded) else []
    if any(judgement.marked for judgement in judgements.values()):
        brief.append(f"Bold: best, and what is not significantly worse (paired, {level}).")
    said: dict[str, list[str]] = defaultdict(list)  # sentence with a gap -> what fills it
    for metric, one in judgements.items():
        if one.rivals and not one.marked:
            said[f"Nothing is bold in {{}}: {one.undecided or 'no method can be told from the best'}."].append(metric)
    for metric, one in judgements.items():
        if refusal := next((interval.note for interval in one.intervals.values() if interval.low is None), ""):
            said[f"No interval for {{}}: {refusal}."].append(metric)
    for metric, one in judgements.items():
        for label, why in one.unranked.items():
            if label not in set_aside:
                said[f"Not ranked: {{}}, which {why}."].append(f"{names.get(label, label)} in {metric}")
    return brief, captions + [sentence.replace("{}", ", ".join(gap), 1) for sentence, gap in said.items()]
