"""Renders as the 3DGS family writes them: ``renders/00000.png`` beside ``gt/00000.png``, views and frames in one flat list.

The list says nothing of views or frames; the copies of the truth do, see `truth_match`.

Facts of 4DGaussians, from github.com/hustvl/4DGaussians (commit 0bc8fed, render.py): the model's folder holds
``{train,test,video}/ours_<iteration>/``, each with ``renders/`` and ``gt/`` of five digits in the order of its data loader and a
``video_rgb.mp4`` of the renders; ``gt/`` of ``video`` stays empty, so that it cannot be taken for the test set.
"""

from collections import Counter
from pathlib import Path

from ggvs_eval.datasets.frames import list_images
from ggvs_eval.errors import RenderError
from ggvs_eval.renders.numbering import last_number
from ggvs_eval.renders.picture import PictureView
from ggvs_eval.renders.request import FrameRequest, RenderedView, RenderSet
from ggvs_eval.renders.truth_match import check_truth, find_order


def refuse(path: Path, request: FrameRequest) -> str | None:
    """Return the reason why this is not a flat list of renders beside the truth, or None if it is one."""
    del request  # its views have no names here
    if not path.is_dir():
        return "not a folder"
    places = _places(path)
    if not places:
        return "no renders/ beside gt/, here or in test/ours_<iteration>/"
    if len(places) > 1:
        return f"several sets: give one of {', '.join(str(place.relative_to(path)) for place in places)}"
    return None


def files(path: Path, request: FrameRequest) -> list[Path]:
    """The pictures of both lists."""
    del request
    (place,) = _places(path)
    return [*list_images(place / "renders"), *list_images(place / "gt")]


def find(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """The renders by view and frame.

    Raises:
        RenderError: lists that do not match each other, or copies of the truth that are not the captured frames.
    """
    (place,) = _places(path)
    rendered, copies = (_by_number(place / name) for name in ("renders", "gt"))
    if set(rendered) != set(copies):
        listed = ", ".join(str(number) for number in sorted(set(rendered) ^ set(copies))[:20])
        raise RenderError(f"{place}: wanted the same numbers in renders/ and gt/, one of them lacks {listed}; render them again")
    return found_in_order([rendered[n] for n in sorted(rendered)], [copies[n] for n in sorted(copies)], request, is_temporary)


def found_in_order(rendered: list[Path], copies: list[Path], request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Flat renders by view and frame, as the copies of the truth tell.

    Args:
        rendered: pictures in the list's order.
        copies: of the truth, same order.
        request: what the run asks for.
        is_temporary: see `PictureView`.
    """
    root = copies[0].parent
    try:
        order = find_order(copies, request)
        level = check_truth({place: copies[index] for index, place in order.places.items()}, request)
    except RenderError as error:
        raise RenderError(f"{root}: {error}") from None
    by_view: dict[str, dict[int, Path]] = {}
    for index, (view, frame) in order.places.items():
        by_view.setdefault(view, {})[frame] = rendered[index]
    views: dict[str, RenderedView] = {view: PictureView(frames, is_temporary) for view, frames in by_view.items()}
    note = f"order found by comparing {root.name}/ with the captured frames ({level:.1f} levels of 255 apart): {order.describe}"
    unused = len(rendered) - len(order.places)
    return RenderSet(views, (), (note, *([f"{unused} pictures of other frames of the capture are not used"] if unused else [])))


def _places(path: Path) -> list[Path]:
    """Folders that hold renders/ and gt/: this one, or those below ``test/`` of a model folder."""
    candidates = [path, *sorted(path.glob("ours_*")), *sorted(path.glob("test/ours_*"))]
    return [place for place in candidates if list_images(place / "renders") and list_images(place / "gt")]


def _by_number(folder: Path) -> dict[int, Path]:
    numbered = [(last_number(file.stem), file) for file in list_images(folder)]
    twice = [number for number, count in Counter(number for number, _ in numbered).items() if count > 1 or number is None]
    if twice:
        listed = ", ".join("a name without number" if number is None else str(number) for number in twice[:20])
        raise RenderError(f"{folder}: wanted one picture for each number, got {listed} wrong; keep one of each")
    return {number: file for number, file in numbered if number is not None}
