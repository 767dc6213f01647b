"""Renders as ``<view>/<frame>.png`` or ``.jpg``, as ``<view>_<frame>.png`` in one folder, and this
package's run folders.

Names that are spelled otherwise, and pictures in another format, are reported.
"""

import os
import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from ggvs_eval.files.listing import (
    UNREAD_PICTURES,
    find_below,
    list_entries,
    list_images,
    same_name,
    unread_pictures,
    unread_videos,
)
from ggvs_eval.renders.numbering import frame_numbers, number_views, places_of
from ggvs_eval.renders.request import FrameRequest, PictureView, RenderedView, RenderSet
from ggvs_eval.run_folder import RunFolder

LOOKED_THROUGH = 10_000


def refuse_folders(path: Path, request: FrameRequest) -> str | None:
    """State why this is not one folder of pictures per view; None if it is."""
    if not path.is_dir():
        return "not a folder"
    if any(_pictures(path, view) for view in request.views):
        return None
    return f"no folder {' or '.join(request.views)} with PNG or JPEG pictures"


def folder_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the pictures of the views."""
    return [file for view in request.views for file in _pictures(path, view)]


def find_folders(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Return the views' pictures by frame number."""
    pictures = {view: _pictures(path, view) for view in request.views}
    items = {
        view: list(
            zip(frame_numbers(path / view, [file.stem for file in some], view), some, strict=True)
        )
        for view, some in pictures.items()
        if some
    }
    renders = picture_set(
        path, items, list(_unexpected_files(path, request)), request, is_temporary
    )
    return replace(renders, hints={view: instead_of(path, view, request) for view in request.views})


def refuse_flat(path: Path, request: FrameRequest) -> str | None:
    """Return why this is no folder of pictures named by view and frame; None if it is."""
    return (
        None
        if any(_places(path, request).values())
        else f"no {request.views[0]}_0000.png or 0000_{request.views[0]}.png"
    )


def flat_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the pictures of the views."""
    return [file for file, place in _places(path, request).items() if place]


def find_flat(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Return the pictures by the view and the number in their names."""
    items: dict[str, list[tuple[int | None, Path]]] = {}
    extras = []
    for file, place in _places(path, request).items():
        if place:
            items.setdefault(place[0], []).append((place[1], file))
        else:
            extras.append(file.name)
    return picture_set(path, items, extras, request, is_temporary)


def _places(path: Path, request: FrameRequest) -> dict[Path, tuple[str, int | None] | None]:
    """Return the pictures of a folder, with the view and number of those that name one of each."""
    pictures = list_images(path)
    named = places_of(path, [file.stem for file in pictures], request.views)
    counts = {1} if len(request.frames) > 1 else {0, 1}
    return {
        file: (place.view, place.number) if place and place.n_numbers in counts else None
        for file, place in zip(pictures, named, strict=True)
    }


def _pictures(path: Path, view: str) -> list[Path]:
    return list_images(find_below(path, view))


def picture_set(
    path: Path,
    items: Mapping[str, Sequence[tuple[int | None, Path]]],
    unexpected: Sequence[str],
    request: FrameRequest,
    is_temporary: bool,
) -> RenderSet:
    """Return the pictures of views under the protocol's frame numbers.

    Args:
        items: view -> number in the name, and file, of each of its pictures.
        is_temporary: see `PictureView`.
    """
    numbered = number_views(path, items, request)
    extras = [
        file.relative_to(path).as_posix() for some in numbered.extras.values() for file in some
    ]
    doubles = {
        view: {frame: [file.name for file in some] for frame, some in by_frame.items()}
        for view, by_frame in numbered.doubles.items()
    }
    views: dict[str, RenderedView] = {
        view: PictureView(frames, is_temporary) for view, frames in numbered.frames.items()
    }
    return RenderSet(
        views=views,
        extras=(*unexpected, *extras),
        notes=(),
        numbering=numbered.note,
        first=numbered.first,
        doubles=doubles,
    )


def placed_pictures(renders: RenderSet) -> dict[tuple[str, int], Path]:
    """(view, frame) -> the picture of it."""
    pictures = (
        (view, rendered)
        for view, rendered in renders.views.items()
        if isinstance(rendered, PictureView)
    )
    return {
        (view, frame): file
        for view, rendered in pictures
        for frame, file in rendered.pictures.items()
    }


def _unexpected_files(path: Path, request: FrameRequest) -> Iterable[str]:
    yield from (file.name for file in list_images(path))
    views = [same_name(view) for view in request.views]
    for folder in list_entries(path):
        if same_name(folder.name) not in views and list_images(folder):
            yield f"{folder.name}/ ({len(list_images(folder))} pictures)"


def refuse_run(path: Path, request: FrameRequest) -> str | None:
    """State why this is not a run folder of this package with renders of one method to take.

    None if it is.
    """
    run = RunFolder(path)
    if not run.protocol_file.is_file():
        return "no protocol.toml"
    labels = run.labels()
    if not labels:
        return "its renders/ is empty"
    if len(labels) > 1 and request.label not in labels:
        return f"several methods; use one of their names: {', '.join(labels)}"
    return refuse_folders(_method_folder(path, request), request)


def run_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the pictures of the method."""
    return folder_files(_method_folder(path, request), request)


def find_run(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Return the method's pictures, which have the numbers of their instants."""
    folder = _method_folder(path, request)
    if request.first_frame is not None:
        return find_folders(folder, request, is_temporary)
    renders = find_folders(folder, replace(request, first_frame=request.frames.start), is_temporary)
    return replace(renders, numbering="frames of a run folder are numbered by instant")


def _method_folder(path: Path, request: FrameRequest) -> Path:
    """Return the method of the wanted name, else the only one."""
    labels = RunFolder(path).labels()
    return path / "renders" / (request.label if request.label in labels else labels[0])


def instead_of(path: Path, view: str, request: FrameRequest) -> str:
    """Describe files that look like a view's missing frames, with a remedy.

    Empty if there are none.
    """
    folder = find_below(path, view)
    unread = unread_pictures(folder)
    if unread or list_images(folder):
        return unread and f"{view}/ holds {unread}"
    if (path / view).is_symlink() and not (path / view).exists():
        return f"{view} is a broken link; restore its target"
    names = {file.name if file.is_dir() else file.stem: file.name for file in list_entries(path)}
    return unread_videos(path, (view,)) or respelled(view, names, request)


def instead_of_all(path: Path, request: FrameRequest) -> str:
    """Say what the folder has in place of views, where no view is there at all."""
    present = {
        file.name if file.is_dir() else re.split(r"_(?=[^_]*$)", file.stem)[0]
        for file in list_entries(path)
    }
    sources = [name for name in request.cameras if name in present]
    if sources and present.isdisjoint(request.views):
        return (
            f"{path.name} has {', '.join(sources)}, which are sources under this protocol; its "
            f"test views are {', '.join(request.views)}: render these; where the method did not "
            f"use {', '.join(sources)}, hold them out: ggvs-eval protocol CAPTURE mine.toml --test "
            f"{' '.join(sources)}"
        )
    hints = [hint for view in request.views if (hint := instead_of(path, view, request))]
    if hints:
        return "; ".join(dict.fromkeys(hints))
    below = (
        (Path(folder), Path(file).suffix.lower())
        for folder, _, files in os.walk(path)
        for file in files
    )
    folders = sorted(
        {folder for folder, suffix in islice(below, LOOKED_THROUGH) if suffix in UNREAD_PICTURES}
    )
    return f"{folders[0].name}/ holds {unread_pictures(folders[0])}" if folders else ""


def respelled(view: str, names: Mapping[str, str], request: FrameRequest) -> str:
    """Return the name that was probably meant to be a view's, with a remedy.

    Empty if there is none.
    """
    extra_names = {name: label for name, label in names.items() if name not in request.cameras}
    for name, label in extra_names.items():
        if name.casefold() == view.casefold():
            return f"there is {label}: names are case-sensitive, write {view}"
    number = _only_number(view)
    alike = [
        label
        for name, label in extra_names.items()
        if number is not None and _only_number(name) == number
    ]
    return f"there is {alike[0]}: rename it if it is {view}" if len(alike) == 1 else ""


def _only_number(name: str) -> int | None:
    numbers = re.findall(r"\d+", name)
    return int(numbers[0]) if len(numbers) == 1 else None
