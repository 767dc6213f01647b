"""Lookalikes of renders: names spelled otherwise, pictures in another format."""

import os
import re
from collections.abc import Mapping
from itertools import islice
from pathlib import Path

from ggvs_eval.files.listing import UNREAD_PICTURES, find_below, list_entries, list_images, unread_pictures, unread_videos
from ggvs_eval.renders.request import FrameRequest

LOOKED_THROUGH = 10_000


def instead_of(path: Path, view: str, request: FrameRequest) -> str:
    """Describe files that look like a view's missing frames, with a remedy; empty where there are none."""
    folder = find_below(path, view)
    unread = unread_pictures(folder)
    if unread or list_images(folder):
        return unread and f"{view}/ holds {unread}"
    if (path / view).is_symlink() and not (path / view).exists():
        return f"{view} is a link to nothing: restore what it leads to"
    names = {file.name if file.is_dir() else file.stem: file.name for file in list_entries(path)}
    return unread_videos(path, (view,)) or respelled(view, names, request)


def instead_of_all(path: Path, request: FrameRequest) -> str:
    """The same where no view is there at all."""
    present = {file.name if file.is_dir() else re.split(r"_(?=[^_]*$)", file.stem)[0] for file in list_entries(path)}
    if tested := [name for name in request.cameras if name in present]:
        return (
            f"{path.name} has {', '.join(tested)}, cameras that the protocol does not test; write one that does: "
            f"ggvs-eval protocol CAPTURE mine.toml --test {' '.join(tested)}"
        )
    hints = [hint for view in request.views if (hint := instead_of(path, view, request))]
    if hints:
        return "; ".join(dict.fromkeys(hints))
    below = ((Path(folder), Path(file).suffix.lower()) for folder, _, files in os.walk(path) for file in files)
    folders = sorted({folder for folder, suffix in islice(below, LOOKED_THROUGH) if suffix in UNREAD_PICTURES})
    return f"{folders[0].name}/ holds {unread_pictures(folders[0])}" if folders else ""


def respelled(view: str, names: Mapping[str, str], request: FrameRequest) -> str:
    """The name that was probably meant to be a view's, with a remedy; empty where there is none."""
    others = {name: shown for name, shown in names.items() if name not in request.cameras}
    for name, shown in others.items():
        if name.casefold() == view.casefold():
            return f"there is {shown}: upper and lower case are told apart, write {view}"
    number = _only_number(view)
    alike = [shown for name, shown in others.items() if number is not None and _only_number(name) == number]
    return f"there is {alike[0]}: if this is {view}, call it so" if len(alike) == 1 else ""


def _only_number(name: str) -> int | None:
    numbers = re.findall(r"\d+", name)
    return int(numbers[0]) if len(numbers) == 1 else None
