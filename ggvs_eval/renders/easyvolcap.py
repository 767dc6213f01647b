"""Renders as EasyVolcap writes them: ``RENDER/frame0000_camera0000.png``, and its copy of the truth as ``..._gt.png`` beside.

Facts of its layout, from github.com/zju3dv/EasyVolcap (commit 4cb3c00, easyvolcap/runners/visualizers/
volumetric_video_visualizer.py and easyvolcap/dataloaders/datasets/volumetric_video_dataset.py): below
``data/result/<experiment>[/<tag>]/`` stands one folder per kind of picture, ``RENDER``, ``DEPTH``, ``ALPHA``; a name has the
frame and the camera in at least four digits; ``_gt`` and ``_error`` pictures follow each where they are asked for; PNG carries
alpha as its fourth channel. The camera's number is its place among the sorted names of all cameras of the capture, the frame's
number counts from the capture's first.
"""

import re
from dataclasses import replace
from pathlib import Path

from ggvs_eval.errors import RenderError
from ggvs_eval.files.listing import list_images
from ggvs_eval.renders.request import FrameRequest, RenderSet
from ggvs_eval.renders.truth_match import check_truth
from ggvs_eval.renders.view_folders import picture_set, placed_pictures

NAME = re.compile(r"frame(\d+)_camera(\d+)(_gt|_error)?")
FOLDER = "RENDER"


def refuse(path: Path, request: FrameRequest) -> str | None:
    """Say why this is not an output of EasyVolcap; None if it is."""
    del request  # its views have numbers, not names
    if not path.is_dir():
        return "not a folder"
    places = _places(path)
    if not places:
        return f"no {FOLDER}/frame0000_camera0000.png"
    if len(places) > 1:
        return f"several sets: give one of {', '.join(str(place.relative_to(path)) for place in places)}"
    return None


def files(path: Path, request: FrameRequest) -> list[Path]:
    """The renders and the copies of the truth."""
    del request
    (place,) = _places(path)
    return [file for file, _, _, suffix in _pictures(place) if suffix != "_error"]


def find(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """The renders by view and frame, after their copies of the truth were compared with the captured frames.

    Raises:
        RenderError: a camera number that the capture does not have, or copies of the truth that are not its frames.
    """
    (place,) = _places(path)
    names = sorted(request.cameras)
    by_view: dict[str, list[tuple[int | None, Path]]] = {}
    for file, frame, camera, suffix in _pictures(place):
        if suffix:
            continue
        if camera >= len(names):
            raise RenderError(
                f"{file}: wanted a camera of 0 to {len(names) - 1}, got {camera}; these are another capture's renders"
            )
        by_view.setdefault(names[camera], []).append((frame, file))
    extras = [
        f"camera {names.index(view)} ({view}, {len(some)} pictures)"
        for view, some in by_view.items()
        if view not in request.views
    ]
    places = ", ".join(f"{names.index(view)} = {view}" for view in request.views)
    items = {view: by_view[view] for view in request.views if view in by_view}
    renders = picture_set(path, items, extras, request, is_temporary)
    claims = {where: copy for where, file in placed_pictures(renders).items() if (copy := _copy(file)).is_file()}
    notes = (f"cameras are taken by their place among the sorted names: {places}", _compared(place, claims, request))
    return replace(renders, notes=notes)


def _compared(place: Path, claims: dict[tuple[str, int], Path], request: FrameRequest) -> str:
    """Compare the copies of the truth with the captured frames."""
    try:
        level = check_truth(claims, request)
    except RenderError as error:
        raise RenderError(f"{place}: {error}") from None
    if not claims:
        return "no _gt pictures to compare with the capture"
    return f"_gt pictures agree with the captured frames ({level:.1f} levels of 255 apart)"


def _copy(file: Path) -> Path:
    return file.with_name(f"{file.stem}_gt{file.suffix}")


def _places(path: Path) -> list[Path]:
    """Folders of renders: this one, its ``RENDER/``, or those of its tags."""
    candidates = [path, path / FOLDER, *sorted(path.glob(f"*/{FOLDER}"))]
    return [place for place in candidates if _pictures(place)]


def _pictures(folder: Path) -> list[tuple[Path, int, int, str]]:
    """Pictures with the frame, the camera and the suffix of their names."""
    matched = [(file, NAME.fullmatch(file.stem)) for file in list_images(folder)]
    return [(file, int(match[1]), int(match[2]), match[3] or "") for file, match in matched if match]
