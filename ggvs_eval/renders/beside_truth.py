"""Renders next to copies of the reference: ``renders/00000.png`` and ``gt/00000.png``, as programs
write them; EasyVolcap's.

EasyVolcap writes ``RENDER/frame0000_camera0000.png``, and its copy of the truth as ``..._gt.png``.

Facts of its layout, from github.com/zju3dv/EasyVolcap (commit 4cb3c00,
easyvolcap/runners/visualizers/ volumetric_video_visualizer.py and
easyvolcap/dataloaders/datasets/volumetric_video_dataset.py): below
``data/result/<experiment>[/<tag>]/`` is one folder per kind of picture, ``RENDER``, ``DEPTH``,
``ALPHA``; a name has the frame and the camera in at least four digits; ``_gt`` and ``_error``
pictures follow each where they are asked for; PNG carries alpha as its fourth channel. The camera's
number is its place among the sorted names of all cameras of the capture, the frame's number counts
from the capture's first.

Views and frames are read from the names where these contain them (``cam00/0001.png``,
``cam00_0001.png``); else the copies of the truth decide, see `truth_match`.

Facts of 4DGaussians, from github.com/hustvl/4DGaussians (commit 0bc8fed, render.py): the model's
folder holds ``{train,test,video}/ours_<iteration>/``, each with ``renders/`` and ``gt/`` of five
digits in the order of its data loader and a ``video_rgb.mp4`` of the renders; ``gt/`` of ``video``
stays empty, so that it cannot be taken for the test set.
"""

import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

from ggvs_eval.errors import RenderError
from ggvs_eval.files.listing import list_files_below, list_images
from ggvs_eval.renders.numbering import frame_numbers, places_of
from ggvs_eval.renders.request import FrameRequest, PictureView, RenderedView, RenderSet
from ggvs_eval.renders.truth_match import check_truth, find_order
from ggvs_eval.renders.view_folders import picture_set, placed_pictures

EASYVOLCAP_NAME = re.compile(r"frame(\d+)_camera(\d+)(_gt|_error)?")
EASYVOLCAP_FOLDER = "RENDER"
# 3DGS and its kin, nerfstudio's `ns-render dataset`, NerfBaselines.
PAIRS = (("renders", "gt"), ("rgb", "gt-rgb"), ("color", "gt-color"))
OTHER_SPLITS = ("train", "video")  # of 3DGS and 4DGS: views that were trained on, and a path
ONLY_VIEW = "view"  # name of that of a flat list without a capture
NERFBASELINES = "info.json"  # next to color/; then gt-color/ may be absent


def refuse_easyvolcap(path: Path, request: FrameRequest) -> str | None:
    """State why this is not an output of EasyVolcap; None if it is."""
    del request  # its views have numbers, not names
    if not path.is_dir():
        return "not a folder"
    places = _easyvolcap_places(path)
    if not places:
        return f"no {EASYVOLCAP_FOLDER}/frame0000_camera0000.png"
    if len(places) > 1:
        return (
            "several sets; give one of "
            f"{', '.join(str(place.relative_to(path)) for place in places)}"
        )
    return None


def easyvolcap_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the renders and the copies of the truth."""
    del request
    (place,) = _easyvolcap_places(path)
    return [file for file, _, _, suffix in _easyvolcap_pictures(place) if suffix != "_error"]


def find_easyvolcap(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Return the renders by view and frame, after their copies of the truth were compared with the
    captured frames.

    Raises:
        RenderError: a camera number that the capture does not have, or copies of the truth that are
            not its frames.
    """
    (place,) = _easyvolcap_places(path)
    names = sorted(request.cameras)
    by_view: dict[str, list[tuple[int | None, Path]]] = {}
    for file, frame, camera, suffix in _easyvolcap_pictures(place):
        if suffix:
            continue
        if camera >= len(names):
            raise RenderError(
                f"{file}: wanted a camera of 0 to {len(names) - 1}, got {camera}; these are "
                f"another capture's renders"
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
    claims = {
        where: copy
        for where, file in placed_pictures(renders).items()
        if (copy := _copy(file)).is_file()
    }
    notes = (
        f"cameras are identified by their place in the sorted names: {places}",
        _compared(place, claims, request),
    )
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


def _easyvolcap_places(path: Path) -> list[Path]:
    """Return the folders of renders: this one, its ``RENDER/``, or those of its tags."""
    candidates = [path, path / EASYVOLCAP_FOLDER, *sorted(path.glob(f"*/{EASYVOLCAP_FOLDER}"))]
    return [place for place in candidates if _easyvolcap_pictures(place)]


def _easyvolcap_pictures(folder: Path) -> list[tuple[Path, int, int, str]]:
    """Return the pictures with the frame, the camera and the suffix of their names."""
    matched = [(file, EASYVOLCAP_NAME.fullmatch(file.stem)) for file in list_images(folder)]
    return [
        (file, int(match[1]), int(match[2]), match[3] or "") for file, match in matched if match
    ]


class _Pair(NamedTuple):
    """A folder of renders and that of the copies of the truth."""

    rendered: Path
    truth: Path


def refuse_flat_set(path: Path, request: FrameRequest) -> str | None:
    """Return the reason why these are not renders next to the reference, or None if they are."""
    del request  # its views may have no names here
    if not path.is_dir():
        return "not a folder"
    pairs = _pairs(path)
    if not pairs:
        none = (
            f"no {', '.join(f'{rendered}/ next to {truth}/' for rendered, truth in PAIRS)}, "
            f"here or in test/ours_<iteration>/"
        )
        sets = [
            place.relative_to(path)
            for split in OTHER_SPLITS
            for place in sorted(path.glob(f"{split}/ours_*/{PAIRS[0][0]}"))
        ]
        return (
            f"{none}; {sets[0]}/ is there, which is no test set: render that (without --skip_test)"
            if sets
            else none
        )
    if len(pairs) > 1:
        places = [pair.rendered.parent for pair in pairs]
        choices = [
            pair.rendered if places.count(place) > 1 else place
            for pair, place in zip(pairs, places, strict=True)
        ]
        return (
            "several sets; give one of "
            f"{', '.join(str(place.relative_to(path)) for place in choices)}"
        )
    return None


def truth_pictures(path: Path) -> dict[str, list[Path]]:
    """Return view -> copies of the truth next to renders: by folders of it, or of a flat list,
    which is one view.

    Raises:
        RenderError: no renders next to copies of the truth, or several sets of them.
    """
    pairs = [pair for pair in _pairs(path) if list_files_below(pair.truth)] if path.is_dir() else []
    if len(pairs) != 1:
        layouts = ", ".join(f"{rendered}/ next to {truth}/" for rendered, truth in PAIRS)
        raise RenderError(
            f"{path}: {len(pairs)} sets of renders with their truth ({layouts}); give a folder "
            f"with one"
        )
    by_view: dict[str, list[Path]] = {}
    for file in _by_key(pairs[0].truth).values():
        view = file.parent.relative_to(pairs[0].truth).as_posix().replace("/", "-")
        by_view.setdefault(ONLY_VIEW if view == "." else view, []).append(file)
    return by_view


def flat_set_files(path: Path, request: FrameRequest) -> list[Path]:
    """Return the pictures of both sides."""
    del request
    (pair,) = _pairs(path)
    return [*list_files_below(pair.rendered), *list_files_below(pair.truth)]


def find_flat_set(path: Path, request: FrameRequest, is_temporary: bool) -> RenderSet:
    """Return the renders by view and frame, after their copies of the truth were compared with the
    captured frames.

    Raises:
        RenderError: lists that do not match each other, names without a view where no truth
            determines the order, or copies of the truth that are not the captured frames.
    """
    (pair,) = _pairs(path)
    rendered, copies = _by_key(pair.rendered), _by_key(pair.truth)
    names = {
        file: file.relative_to(pair.rendered).with_suffix("").as_posix()
        for file in rendered.values()
    }
    if any(places_of(pair.rendered, names.values(), request.views)):
        beside = {file: copies[key] for key, file in rendered.items() if key in copies}
        return _found_by_name(pair, names, beside, request, is_temporary)
    if not copies:
        first = next(iter(names)).relative_to(pair.rendered.parent)
        raise RenderError(
            f"{pair.rendered.parent}: wanted names with a view, got {first}, and "
            f"{pair.truth.name}/ lacks pictures to order them by; name them <view>/<frame>.png"
        )
    if set(rendered) != set(copies):
        listed = ", ".join(str(key) for key in sorted(set(rendered) ^ set(copies), key=str)[:20])
        folders = f"{pair.rendered.name}/ and {pair.truth.name}/"
        raise RenderError(
            f"{pair.rendered.parent}: wanted the same numbers in {folders}, one of them lacks "
            f"{listed}; render them again"
        )
    return _found_in_order(
        list(rendered.values()), [copies[key] for key in rendered], pair, request, is_temporary
    )


def _found_in_order(
    rendered: Sequence[Path],
    copies: Sequence[Path],
    pair: _Pair,
    request: FrameRequest,
    is_temporary: bool,
) -> RenderSet:
    try:
        order = find_order(copies, request)
        level = check_truth(
            {place: copies[index] for index, place in order.places.items()}, request
        )
    except RenderError as error:
        raise RenderError(f"{pair.truth}: {error}") from None
    by_view: dict[str, dict[int, Path]] = {}
    for index, (view, frame) in order.places.items():
        by_view.setdefault(view, {})[frame] = rendered[index]
    views: dict[str, RenderedView] = {
        view: PictureView(frames, is_temporary) for view, frames in by_view.items()
    }
    compared = (
        f"order determined by comparing {pair.truth.name}/ with the captured frames "
        f"({level:.1f} levels of 255 apart)"
    )
    unused = len(rendered) - len(order.places)
    left = [f"{unused} pictures of other frames of the capture are not used"] if unused else []
    return RenderSet(views, (), (f"{compared}: {order.describe}", *left))


def _found_by_name(
    pair: _Pair,
    names: dict[Path, str],
    copies: dict[Path, Path],
    request: FrameRequest,
    is_temporary: bool,
) -> RenderSet:
    items: dict[str, list[tuple[int | None, Path]]] = {}
    extras = []
    for (file, name), place in zip(
        names.items(), places_of(pair.rendered, names.values(), request.views), strict=True
    ):
        if place is None:
            extras.append(f"{pair.rendered.name}/{name}")
        else:
            items.setdefault(place.view, []).append((place.number, file))
    renders = picture_set(pair.rendered.parent, items, extras, request, is_temporary)
    placed = placed_pictures(renders)
    claims = {place: copies[file] for place, file in placed.items() if file in copies}
    try:
        level = check_truth(claims, request)
    except RenderError as error:
        raise RenderError(f"{pair.rendered.parent}: {error}") from None
    is_whole = 0 < len(claims) == len(placed)
    agreeing = (
        f"{pair.truth.name}/ agrees with the truth of the run ({level:.1f} levels of 255 apart)"
    )
    return replace(
        renders,
        notes=(
            agreeing if is_whole else f"no complete {pair.truth.name}/ to compare with the capture",
        ),
    )


def _pairs(path: Path) -> list[_Pair]:
    """Return the sets of a folder: its own, or those below ``test/`` of a model folder."""
    places = [path, path / "test", *sorted(path.glob("ours_*")), *sorted(path.glob("test/ours_*"))]
    pairs = [
        _Pair(place / rendered, place / truth) for place in places for rendered, truth in PAIRS
    ]
    return [pair for pair in pairs if list_files_below(pair.rendered) and _has_truth(pair)]


def _has_truth(pair: _Pair) -> bool:
    is_nerfbaselines = (
        pair.rendered.name == PAIRS[-1][0] and (pair.rendered.parent / NERFBASELINES).is_file()
    )
    return is_nerfbaselines or bool(list_files_below(pair.truth))


def _by_key(folder: Path) -> dict[int | str, Path]:
    """Return the pictures below a folder, in order, by number in a flat list, else by relative
    name.
    """
    pictures = list_files_below(folder)
    numbers = frame_numbers(folder, [file.stem for file in pictures])
    if (
        all(file.parent == folder for file in pictures)
        and None not in numbers
        and len(set(numbers)) == len(pictures)
    ):
        return {
            number: file
            for number, file in sorted(zip(numbers, pictures, strict=True))
            if number is not None
        }
    return {file.relative_to(folder).with_suffix("").as_posix(): file for file in pictures}
