"""Renders as NerfBaselines writes its predictions: ``info.json``, ``color/<name>.png``, ``gt-color/<name>.png``.

The names are the data set's relative image paths with the suffix .png; views and frames are read from them where they tell
(``cam00/0001.png``, ``images/cam00/0001.png``, ``cam00_0001.png``), else found as in a flat list.
"""

import re
from pathlib import Path

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import IMAGE_SUFFIXES
from ggvs_eval.renders.flat_set import found_in_order
from ggvs_eval.renders.numbering import last_number, number_items
from ggvs_eval.renders.picture import PictureView
from ggvs_eval.renders.truth_match import check_truth
from ggvs_eval.renders.wanted import Found, RenderedView, Wanted


def refuse(path: Path, wanted: Wanted) -> str | None:
    """Why this is not an output of NerfBaselines; None if it is."""
    del wanted
    if not (path / "info.json").is_file():
        return "no info.json"
    return None if _pictures(path / "color") else "no pictures in color/"


def files(path: Path, wanted: Wanted) -> list[Path]:
    """The pictures of both sides."""
    del wanted
    return [*_pictures(path / "color"), *_pictures(path / "gt-color")]


def find(path: Path, wanted: Wanted, is_temporary: bool) -> Found:
    """The predictions by view and frame, after their copy of the truth was compared with the captured frames.

    Raises:
        RenderError: names that tell no view while there is no truth to find the order by, or a truth that is not the capture's.
    """
    root = path / "color"
    pictures = _pictures(root)
    names = {file: file.relative_to(root).with_suffix("").as_posix() for file in pictures}
    copies = {file: path / "gt-color" / file.relative_to(root) for file in pictures}
    has_copies = all(copy.is_file() for copy in copies.values())
    if any(view_of(name, wanted.views) for name in names.values()):
        return _found_by_name(path, names, copies if has_copies else {}, wanted, is_temporary)
    if not has_copies:
        raise RenderError(
            f"{path}: names like color/{pictures[0].name} tell no view, and gt-color/ lacks pictures to find their order by; "
            "name them <view>/<frame>.png"
        )
    return found_in_order(pictures, [copies[file] for file in pictures], wanted, is_temporary)


def view_of(name: str, views: tuple[str, ...]) -> str | None:
    """The one view whose name stands in a relative path as a word of its own; None where none or several do."""
    found = [view for view in views if re.search(_word(view), name)]
    return found[0] if len(found) == 1 else None


def _word(view: str) -> str:
    return rf"(?<![A-Za-z0-9]){re.escape(view)}(?![A-Za-z0-9])"


def _found_by_name(path: Path, names: dict[Path, str], copies: dict[Path, Path], wanted: Wanted, is_temporary: bool) -> Found:
    """Predictions whose names tell view and frame."""
    by_view: dict[str, list[tuple[int | None, Path]]] = {}
    extras, notes = [], []
    for file, name in names.items():
        view = view_of(name, wanted.views)
        if view is None:
            extras.append(f"color/{name}")
        else:
            by_view.setdefault(view, []).append((last_number(re.sub(_word(view), "", name)), file))
    views: dict[str, RenderedView] = {}
    claims: dict[tuple[str, int], Path] = {}
    for view, items in by_view.items():
        numbered = number_items(items, wanted.frames, wanted.n_frames)
        views[view] = PictureView(numbered.frames, is_temporary)
        extras += [f"color/{names[file]}" for file in numbered.extras]
        notes += [f"{view}: {numbered.note}"] if numbered.note else []
        claims |= {(view, frame): copies[file] for frame, file in numbered.frames.items() if file in copies}
    try:
        level = check_truth(claims, wanted)
    except RenderError as error:
        raise RenderError(f"{path}: {error}") from None
    agreeing = f"gt-color/ agrees with the captured frames ({level:.1f} levels of 255 apart)"
    notes.append(agreeing if claims else "no complete gt-color/ to compare with the capture")
    return Found(views, tuple(extras), tuple(notes))


def _pictures(folder: Path) -> list[Path]:
    """All pictures below a folder, by path."""
    return sorted(file for file in folder.rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES and file.is_file())
