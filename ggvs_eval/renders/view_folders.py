"""Renders as ``<view>/<frame>.png`` or ``.jpg``, and our own run folders, which hold such a folder per method."""

from collections.abc import Iterable
from pathlib import Path

from ggvs_eval.datasets.frames import list_images
from ggvs_eval.renders.numbering import number_files
from ggvs_eval.renders.picture import PictureView
from ggvs_eval.renders.wanted import Found, RenderedView, Wanted
from ggvs_eval.run_folder import RunFolder


def refuse(path: Path, wanted: Wanted) -> str | None:
    """Why this is not one folder of pictures per view; None if it is."""
    if not path.is_dir():
        return "not a folder"
    if any(list_images(path / view) for view in wanted.views):
        return None
    return f"no folder {' or '.join(wanted.views)} with PNG or JPEG pictures"


def files(path: Path, wanted: Wanted) -> list[Path]:
    """The pictures of the views."""
    return [file for view in wanted.views for file in list_images(path / view)]


def find(path: Path, wanted: Wanted, is_temporary: bool) -> Found:
    """The views' pictures by frame number."""
    views: dict[str, RenderedView] = {}
    extras, notes = list(_unexpected_files(path, wanted)), []
    for view in wanted.views:
        pictures = list_images(path / view)
        if not pictures:
            continue
        numbered = number_files(pictures, wanted.frames, wanted.n_frames)
        views[view] = PictureView({number: Path(file) for number, file in numbered.frames.items()}, is_temporary)
        extras += [f"{view}/{file.name}" for file in numbered.extras]
        notes += [f"{view}: {numbered.note}"] if numbered.note else []
    return Found(views, tuple(extras), tuple(notes))


def _unexpected_files(path: Path, wanted: Wanted) -> Iterable[str]:
    """Pictures and folders of pictures that belong to no view."""
    yield from (file.name for file in list_images(path))
    for folder in sorted(path.iterdir()):
        if folder.name not in wanted.views and not folder.name.startswith(".") and list_images(folder):
            yield f"{folder.name}/ ({len(list_images(folder))} pictures)"


def refuse_run(path: Path, wanted: Wanted) -> str | None:
    """Why this is not a run folder of ours with renders of one method to take; None if it is."""
    run = RunFolder(path)
    if not run.protocol_file.is_file():
        return "no protocol.toml"
    labels = run.labels()
    if not labels:
        return "its renders/ is empty"
    if len(labels) > 1 and wanted.label not in labels:
        return f"several methods; call it by one of their names: {', '.join(labels)}"
    return refuse(_method_folder(path, wanted), wanted)


def run_files(path: Path, wanted: Wanted) -> list[Path]:
    """The pictures of the method."""
    return files(_method_folder(path, wanted), wanted)


def find_run(path: Path, wanted: Wanted, is_temporary: bool) -> Found:
    """The method's pictures."""
    return find(_method_folder(path, wanted), wanted, is_temporary)


def _method_folder(path: Path, wanted: Wanted) -> Path:
    """The method of the wanted name, else the only one."""
    labels = RunFolder(path).labels()
    return path / "renders" / (wanted.label if wanted.label in labels else labels[0])
