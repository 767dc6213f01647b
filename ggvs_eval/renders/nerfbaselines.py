"""Renders as NerfBaselines writes its predictions: ``info.json``, ``color/<name>.png``, ``gt-color/<name>.png``.

The names are the data set's relative image paths with the suffix .png; views and frames are read from them where they tell
(``cam00/0001.png``, ``images/cam00/0001.png``, ``cam00_0001.png``), else found as in a flat list.
"""

import re
from pathlib import Path

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import IMAGE_SUFFIXES
from ggvs_eval.renders.flat_set import found_in_order
from ggvs_eval.renders.numbering import last_number, name_as_word, number_views
from ggvs_eval.renders.picture import PictureView
from ggvs_eval.renders.request import FrameRequest, RenderedView, RenderSet
from ggvs_eval.renders.truth_match import check_truth
from ggvs_eval.renders.view_folders import names_of


def refuse(path: Path, request: FrameRequest) -> str | None:
    """Say why this is not an output of NerfBaselines; None if it is."""
    del request
    if not (path / "info.json").is_file():
        return "no info.json"
    return None if _pictures(path / "color") else "no pictures in color/"


def files(path: Path, request: FrameRequest) -> list[Path]:
    """The pictures of both sides."""
    del request
    return [*_pictures(path / "color"), *_pictures(path / "gt-color")]


def find(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """The predictions by view and frame, after their copy of the truth was compared with the captured frames.

    Raises:
        RenderError: names that tell no view while there is no truth to find the order by, or a truth that is not the capture's.
    """
    root = path / "color"
    pictures = _pictures(root)
    names = {file: file.relative_to(root).with_suffix("").as_posix() for file in pictures}
    copies = {file: path / "gt-color" / file.relative_to(root) for file in pictures}
    has_copies = all(copy.is_file() for copy in copies.values())
    if any(view_of(name, request.views) for name in names.values()):
        return _found_by_name(path, names, copies if has_copies else {}, request, is_temporary)
    if not has_copies:
        raise RenderError(
            f"{path}: names like color/{pictures[0].name} tell no view, and gt-color/ lacks pictures to find their order by; "
            "name them <view>/<frame>.png"
        )
    return found_in_order(pictures, [copies[file] for file in pictures], request, is_temporary)


def view_of(name: str, views: tuple[str, ...]) -> str | None:
    """The one view whose name stands in a relative path as a word of its own; None where none or several do."""
    named = [view for view in views if re.search(name_as_word(view), name)]
    return named[0] if len(named) == 1 else None


def _found_by_name(
    path: Path, names: dict[Path, str], copies: dict[Path, Path], request: FrameRequest, is_temporary: bool
) -> RenderSet:
    """Predictions whose names tell view and frame."""
    by_view: dict[str, list[tuple[int | None, Path]]] = {}
    extras = []
    for file, name in names.items():
        view = view_of(name, request.views)
        if view is None:
            extras.append(f"color/{name}")
        else:
            by_view.setdefault(view, []).append((last_number(re.sub(name_as_word(view), "", name)), file))
    numbered = number_views(path, by_view, request)
    views: dict[str, RenderedView] = {view: PictureView(frames, is_temporary) for view, frames in numbered.frames.items()}
    extras += [f"color/{names[file]}" for some in numbered.extras.values() for file in some]
    placed = {(view, frame): file for view, frames in numbered.frames.items() for frame, file in frames.items()}
    claims = {place: copies[file] for place, file in placed.items() if file in copies}
    try:
        level = check_truth(claims, request)
    except RenderError as error:
        raise RenderError(f"{path}: {error}") from None
    agreeing = f"gt-color/ agrees with the captured frames ({level:.1f} levels of 255 apart)"
    compared = agreeing if claims else "no complete gt-color/ to compare with the capture"
    doubles = {view: names_of(by_frame) for view, by_frame in numbered.doubles.items()}
    return RenderSet(views, tuple(extras), (compared,), numbered.note, numbered.first, doubles)


def _pictures(folder: Path) -> list[Path]:
    """All pictures below a folder, by path."""
    return sorted(file for file in folder.rglob("*") if file.suffix.lower() in IMAGE_SUFFIXES)
