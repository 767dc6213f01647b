"""Words on the certainty of a table: the meaning of ± and bold, and what is not ranked, not called or without an interval."""

from collections import defaultdict
from collections.abc import Collection, Mapping

from ggvs_eval.reports.model.table import SHORT_MEANS
from ggvs_eval.statistics.intervals import LEVEL
from ggvs_eval.statistics.paired import Judgement


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
