"""Diagnostics: what a method decided on the way to its frames, as pictures beside them; render jobs write them."""

from collections.abc import Iterator, Sequence
from pathlib import Path

from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.run_folder import DIAGNOSTICS, missing_frames

MEANINGS = {
    "depth": ("depth", "the fused depth, near yellow, far dark blue, chequered where none was found"),
    "weights": ("weights", "one colour per source view, mixed by its share in the pixel, dark where the background fills in"),
    "coverage": ("coverage", "how far the splatted views cover the pixel, none dark blue, fully yellow"),
    "motion": ("motion", "where the past is forgotten because something moves, yellow; kept, dark blue"),
}


def diagnostics_label(run: MeasuredRun) -> str | None:
    """The method whose inside is shown: ours, rather itself than a variant of it, or whatever tells; None where none does."""
    first = run.protocol.views.test[0]
    return next((label for label in run.ours_first if (run.folder.renders(label, first) / DIAGNOSTICS).is_dir()), None)


def diagnostics_folders(frames: Path, label: str, indices: range) -> Iterator[tuple[str, Path]]:
    """Key and folder of each kind of picture that is there for every frame.

    Args:
        frames: folder of the method's frames.
        label: of the method.
        indices: of the frames.
    """
    for name in MEANINGS:
        folder = frames / DIAGNOSTICS / name
        if folder.is_dir() and not missing_frames(folder, indices):
            yield f"{label}/{name}", folder


def diagnostics_name(run: MeasuredRun, key: str) -> str:
    """What to call a picture: of a method, of the truth, or of the inside of a method."""
    label, _, name = key.partition("/")
    return f"{run.name(label)}: {MEANINGS[name][0]}" if name else run.name(label)


def diagnostics_legend(keys: Sequence[str]) -> list[tuple[str, str]]:
    """What to say of those of the pictures that show the inside of a method: name and meaning."""
    return [MEANINGS[key.partition("/")[2]] for key in keys if "/" in key]
