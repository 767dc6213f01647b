"""Renders as ``<view>/<frame>.png`` or ``.jpg``, and our own run folders, which hold such a folder per method."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from ggvs_eval.datasets.frames import list_images
from ggvs_eval.renders.lookalikes import instead_of
from ggvs_eval.renders.numbering import last_number, number_views
from ggvs_eval.renders.picture import PictureView
from ggvs_eval.renders.request import FrameRequest, RenderedView, RenderSet
from ggvs_eval.run_folder import RunFolder


def refuse(path: Path, request: FrameRequest) -> str | None:
    """Say why this is not one folder of pictures per view; None if it is."""
    if not path.is_dir():
        return "not a folder"
    if any(list_images(path / view) for view in request.views):
        return None
    return f"no folder {' or '.join(request.views)} with PNG or JPEG pictures"


def files(path: Path, request: FrameRequest) -> list[Path]:
    """The pictures of the views."""
    return [file for view in request.views for file in list_images(path / view)]


def find(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """The views' pictures by frame number."""
    pictures = {view: list_images(path / view) for view in request.views}
    items = {view: [(last_number(file.stem, view), file) for file in some] for view, some in pictures.items() if some}
    numbered = number_views(path, items, request)
    views: dict[str, RenderedView] = {view: PictureView(frames, is_temporary) for view, frames in numbered.frames.items()}
    extras = [f"{view}/{file.name}" for view, some in numbered.extras.items() for file in some]
    return RenderSet(
        views,
        (*_unexpected_files(path, request), *extras),
        numbering=numbered.note,
        first=numbered.first,
        doubles={view: names_of(by_frame) for view, by_frame in numbered.doubles.items()},
        hints={view: instead_of(path, view, request) for view in request.views},
    )


def names_of(doubles: Mapping[int, Sequence[Path]]) -> dict[int, list[str]]:
    """The names of several pictures of one frame."""
    return {frame: [file.name for file in files] for frame, files in doubles.items()}


def _unexpected_files(path: Path, request: FrameRequest) -> Iterable[str]:
    """Pictures and folders of pictures that belong to no view."""
    yield from (file.name for file in list_images(path))
    for folder in sorted(path.iterdir()):
        if folder.name not in request.views and not folder.name.startswith(".") and list_images(folder):
            yield f"{folder.name}/ ({len(list_images(folder))} pictures)"


def refuse_run(path: Path, request: FrameRequest) -> str | None:
    """Say why this is not a run folder of ours with renders of one method to take; None if it is."""
    run = RunFolder(path)
    if not run.protocol_file.is_file():
        return "no protocol.toml"
    labels = run.labels()
    if not labels:
        return "its renders/ is empty"
    if len(labels) > 1 and request.label not in labels:
        return f"several methods; call it by one of their names: {', '.join(labels)}"
    return refuse(_method_folder(path, request), request)


def run_files(path: Path, request: FrameRequest) -> list[Path]:
    """The pictures of the method."""
    return files(_method_folder(path, request), request)


def find_run(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """The method's pictures, which bear the numbers of their instants."""
    folder = _method_folder(path, request)
    if request.first_frame is not None:
        return find(folder, request, is_temporary)
    renders = find(folder, replace(request, first_frame=request.frames.start), is_temporary)
    return replace(renders, numbering="frames of a run folder bear the numbers of their instants")


def _method_folder(path: Path, request: FrameRequest) -> Path:
    """The method of the wanted name, else the only one."""
    labels = RunFolder(path).labels()
    return path / "renders" / (request.label if request.label in labels else labels[0])
