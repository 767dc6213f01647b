"""Figures written so that equal pictures are equal bytes."""

from pathlib import Path
from typing import TYPE_CHECKING

from ggvs_eval.errors import ResultsError

if TYPE_CHECKING:
    from matplotlib.figure import Figure

# Metadata keys that would carry a date or a version.
VOLATILE = {".png": ("Software",), ".pdf": ("CreationDate", "Producer", "Creator"), ".svg": ("Date", "Creator")}
DOTS_PER_INCH = 200


def save_figure(figure: "Figure", out: Path) -> Path:
    """Write a figure; the suffix of the file chooses the format.

    Raises:
        ResultsError: another suffix than ``.png``, ``.pdf`` or ``.svg``.
    """
    if out.suffix not in VOLATILE:
        raise ResultsError(f"{out}: a figure's name must end in {', '.join(VOLATILE)}, got {out.suffix or 'no suffix'}")
    import matplotlib

    out.parent.mkdir(parents=True, exist_ok=True)
    with matplotlib.rc_context({"svg.hashsalt": "ggvs-eval", "savefig.dpi": DOTS_PER_INCH}):
        figure.savefig(out, format=out.suffix[1:], metadata=dict.fromkeys(VOLATILE[out.suffix]))
    return out
