"""Appearance of a figure in a paper: methods and their order, width, title, scores."""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import cast

from ggvs_eval.errors import ResultsError
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import format_value
from ggvs_eval.results import label_of

INCHES = {"in": 1.0, "cm": 1 / 2.54, "mm": 1 / 25.4, "pt": 1 / 72.27}
NARROWEST_IN, WIDEST_IN = 1.0, 40.0
USUAL = ("PSNR", "LPIPS")


@dataclass(frozen=True)
class FigureLook:
    """Look of a figure.

    Attributes:
        width_in: inches.
        has_title: whether it says in itself what it shows, which a paper's caption does.
    """

    width_in: float = 7.0
    has_title: bool = True


FULL_LOOK = FigureLook()


def parse_width(text: str) -> float:
    """Inches of a width such as ``3.3in``, ``8.4cm``, ``84mm`` or ``240pt`` (TeX's points).

    Raises:
        ResultsError: another text, or a width at which nothing can be drawn.

    Examples:
        >>> parse_width("3.3in"), round(parse_width("84mm"), 2)
        (3.3, 3.31)
    """
    match = re.fullmatch(r"(\d+(?:\.\d*)?)\s*(in|cm|mm|pt)", text)
    inches = float(match[1]) * INCHES[match[2]] if match else 0.0
    if not NARROWEST_IN <= inches <= WIDEST_IN:
        raise ResultsError(
            f"width {text!r}: wanted {NARROWEST_IN:g}in to {WIDEST_IN:g}in, in in, cm, mm or pt, "
            f"such as 3.3in"
        )
    return inches


def parse_row(text: str) -> int | None:
    """Return the number of an image row; None of ``auto``.

    Raises:
        ResultsError: another text.
    """
    if text != "auto" and not text.isdecimal():
        raise ResultsError(
            f"row {text!r}: wanted auto, or the number of an image row from the top, 0 or more"
        )
    return None if text == "auto" else int(text)


def only_methods(run: MeasuredRun, labels: Sequence[str]) -> MeasuredRun:
    """Return the run with these methods alone, in this order; with all of them where none is named.

    Raises:
        ResultsError: a method that has no whole renders.
    """
    unknown = [label for label in labels if label not in run.pictured]
    if unknown:
        names_text = ", ".join(run.pictured)
        raise ResultsError(
            f"{run.folder.root}: no complete renders of {', '.join(map(repr, unknown))}; use one "
            f"of {names_text}"
        )
    return replace(run, labels=tuple(dict.fromkeys(labels))) if labels else run


def score_words(run: MeasuredRun, metrics: Sequence[str]) -> dict[str, str]:
    """Return the label of a method -> its scores in words, as the tables print them: ``PSNR 33.67,
    LPIPS 0.08``.

    Args:
        metrics: which; PSNR and LPIPS, where they were measured, by default.

    Raises:
        ResultsError: a metric that was not measured.
    """
    summary = run.results.summary()
    names = metrics or tuple(name for name in USUAL if name in summary)
    absent = [name for name in names if name not in summary]
    if absent:
        raise ResultsError(
            f"{run.folder.root}: no {', '.join(absent)}; it has {', '.join(summary.columns)}"
        )
    words = {}
    for keys, line in summary.iterrows():
        _, method, variant = cast(tuple[str, str, str], keys)
        scores = (
            f"{name} {format_value(float(line[name]), run.metrics[name].decimals)}"
            for name in names
        )
        words[label_of(method, variant)] = ", ".join(scores)
    return words
