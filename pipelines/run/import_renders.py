"""Renders of others become a method of a run: understood, checked against the protocol, and put in
place whole or not at all.

The run folder that they are scored in is one that there is, or one made of a capture and a
protocol.
"""

import os
import re
import shutil
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.coverage import IMPORT_FILE, read_import
from ggvs_eval.errors import GgvsError, MetricError, ProtocolError, RenderError, no_such_path
from ggvs_eval.files.archive import Limits, is_archive, unpack
from ggvs_eval.files.atomic import absent_unless_made, remove_leftovers, scratch_folder
from ggvs_eval.files.digest import digest_files, digest_values
from ggvs_eval.jobs.processes import worker_pool
from ggvs_eval.metrics.registry import METRICS, select_metrics
from ggvs_eval.pipelines.methods.registry import METHODS
from ggvs_eval.pipelines.run.claim import require_protocol
from ggvs_eval.pipelines.run.prepare import prepare_truth
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.progress import track
from ggvs_eval.protocol import Protocol, load_protocol, packaged_protocols
from ggvs_eval.renders.kinds import KINDS, detect
from ggvs_eval.renders.request import (
    Fit,
    FrameRequest,
    RenderedView,
    RenderSet,
    fit,
    partial_text,
    request_of,
    require_whole,
)
from ggvs_eval.run_folder import JOB_FILE, RunFolder, as_ranges, frame_path, write_json
from ggvs_eval.tasks.task import Task

NAME = re.compile(r"\w[\w.+-]*")
# bytes; file systems take 255, of which temporary folders add their own, host and process to the
# name
LONGEST_NAME = 128
# An archive may hold renders, truth, depth and masks of each frame, with little that compresses.
ARCHIVE_BYTES_PER_PIXEL = 24
ARCHIVE_FILES_PER_FRAME = 12
SMALL = 20  # pixels per byte that zeros at least take as written here; about a hundred really
ARCHIVE_SLACK_FILES, ARCHIVE_SLACK_BYTES = 1000, 256 << 20
SCORES_ROOT = Path("scores")
TOLD_BYTES = 20_000_000


def import_renders(
    run: RunFolder,
    label: str,
    path: Path,
    allow_partial: bool = False,
    workers: int = 1,
    first_frame: int | None = None,
    link: bool = False,
) -> dict[str, Any]:
    """Make frames that others rendered a method of a run.

    PNG files are copied, so that the run stays complete if the originals are removed; JPEG files,
    videos and arrays are written to PNG once. A second call with the same files does nothing.

    Args:
        run: a folder with the captured frames of the protocol's views.
        label: what to call the method.
        path: folder, archive or file, see `kinds.KINDS`.
        allow_partial: take what fits where not everything does; its row is marked.
        workers: processes that decode videos and arrays, one view each.
        first_frame: number of the protocol's first frame in their names, of all views, where the
            numbers are ambiguous; in videos and arrays its place, counted from 0.
        link: take PNG files as links, which costs no space and breaks where they are moved.

    Returns:
        The record of the import, ``import.json``: kind, source, digests, notes, frames, and the
        basis of the row if partial.

    Raises:
        RenderError: a label that is taken, or renders that are unreadable or do not fit the
            protocol; everything missing, extra or of wrong size is listed.
    """
    require_there({label: path})
    request = request_of(run, label, first_frame)
    target = run.root / "renders" / label
    if target.exists() and path.resolve() in (run.root.resolve(), target.resolve()):
        raise RenderError(
            f"{path}: these renders are already in the run {run.root}; score it without --renders"
        )
    if target.exists() and not target.is_symlink() and read_import(run, label) is None:
        raise RenderError(
            f"{target}: wanted a new name, got an existing one; choose another name for these "
            f"renders"
        )
    remove_leftovers(target)
    with (
        scratch_folder(target.with_name(f"{label}.unpacked")) as unpacked,
        _named_as_given(unpacked, path),
    ):
        return _import(run, request, path, unpacked, allow_partial, workers, link)


def require_there(renders: Mapping[str, Path]) -> None:
    """Refuse names that renders cannot have, and paths that there are not, before anything is done
    about the others.
    """
    for label, path in renders.items():
        if _is_taken(label) or not NAME.fullmatch(label) or len(label.encode()) > LONGEST_NAME:
            reason = (
                "the name of a built-in method"
                if _is_taken(label)
                else f"not a plain name of at most {LONGEST_NAME} bytes"
            )
            reason = "the captured frames" if label == "truth" else reason
            raise RenderError(
                f"renders cannot be called {label!r}, which is {reason}; give another: --renders "
                f"{plain_label(label)}=PATH"
            )
        if not path.exists():
            raise RenderError(no_such_path(path, "renders"))


@contextmanager
def _named_as_given(unpacked: Path, path: Path) -> Iterator[None]:
    """Let errors name the archive that the user gave, not the folder that it was unpacked to."""
    try:
        yield
    except GgvsError as error:
        raise type(error)(str(error).replace(str(unpacked), str(path))) from error


def _import(
    run: RunFolder,
    request: FrameRequest,
    path: Path,
    unpacked: Path,
    allow_partial: bool,
    workers: int,
    link: bool,
) -> dict[str, Any]:
    """Understand, check and put in place, unless it is there."""
    packed = is_archive(path)
    kind = "" if packed else detect(path, request)
    sources = [path] if packed else KINDS[kind].files(path, request)
    identity = _identity(request, path, sources, allow_partial)
    record = read_import(run, request.label)
    target = run.root / "renders" / request.label
    task = Task(name=request.label, folder=target, inputs=identity)
    is_earlier = (
        record is not None and not (target / JOB_FILE).is_file() and _are_there(target, record)
    )
    if record and record["identity"] == identity and (task.is_done() or is_earlier):
        return record
    root = unpack(path, unpacked, _limits(request), RenderError) if packed else path
    kind = kind or detect(root, request)
    renders = KINDS[kind].find(root, request, packed)
    fitted = fit(renders, request)
    if not allow_partial:
        require_whole(fitted, path, renders.numbering)
    record = {
        "kind": KINDS[kind].describe + (" in an archive" if packed else ""),
        "source": path.resolve().name,
        "sha256": digest_values(*identity["files"], *identity["files"].values()),
        "partial": partial_text(fitted, request),
        "notes": [
            *filter(None, [renders.numbering]),
            *renders.notes,
            *_left_out(fitted),
            *_black_truth(request),
        ],
        "frames": {view: list(frames) for view, frames in fitted.usable.items()},
        # a guess; what the user says is none
        "counted_from": 0 if request.first_frame is not None else renders.first,
        "identity": identity,
    }
    if target.is_symlink():
        target.unlink()
    replace(task, make=partial(_fill, renders, fitted, record, workers, link, request.label)).run()
    return record


def _are_there(target: Path, record: Mapping[str, Any]) -> bool:
    """Return whether an earlier version's import has its frames; it knew no list of files."""
    frames = (
        frame_path(target / view, frame)
        for view, numbers in record["frames"].items()
        for frame in numbers
    )
    return all(frame.is_file() for frame in frames)


def _fill(
    renders: RenderSet,
    fitted: Fit,
    record: dict[str, Any],
    workers: int,
    link: bool,
    label: str,
    folder: Path,
) -> dict[str, Any]:
    views = {view: (renders.views[view], frames) for view, frames in fitted.usable.items()}
    notes = _write(views, folder, workers)
    if not link:
        _copy_linked(folder, label)
    record["notes"] += [f"{view}: {note}" for view, lines in notes.items() for note in lines]
    write_json(folder / IMPORT_FILE, record)
    return {}


def _write(
    views: Mapping[str, tuple[RenderedView, tuple[int, ...]]], folder: Path, workers: int
) -> dict[str, list[str]]:
    """Write the frames of each view; gives back the notes of each."""
    if workers == 1 or len(views) == 1:
        return {
            view: rendered.write(folder / view, frames)
            for view, (rendered, frames) in views.items()
        }
    with worker_pool(min(workers, len(views))) as pool:
        running = {
            view: pool.submit(rendered.write, folder / view, frames)
            for view, (rendered, frames) in views.items()
        }
        return {view: job.result() for view, job in running.items()}


def _copy_linked(folder: Path, label: str) -> None:
    """Put copies in the place of links to pictures; of many megabytes a line says so before."""
    links = [file for file in sorted(folder.rglob("*.png")) if file.is_symlink()]
    size = sum(file.stat().st_size for file in links)
    if size >= TOLD_BYTES:
        message = (
            f"{label}: copying {size / 1e6:,.0f} MB of frames into the run (--link links "
            f"them instead)"
        )
        print(message, file=sys.stderr, flush=True)
    for file in track(links, f"copying frames of {label}"):
        source = file.resolve()
        file.unlink()
        shutil.copyfile(source, file)


def plain_label(name: str) -> str:
    """Return a name that renders can have, made of that of their folder.

    Examples:
        >>> plain_label("my renders (2)"), plain_label("enerf")
        ('my-renders-2', 'enerf-renders')
    """
    label = re.sub(r"(?<=^.{100}).+|[^\w.+-]+", "-", name).strip("-.+") or "renders"
    return f"{label}-renders" if _is_taken(label) else label


def _is_taken(label: str) -> bool:
    """Return whether a name means something else in a run, or is what tables call one of this
    package's methods.
    """
    return label.lower() in {"truth", *METHODS, *(spec.title.lower() for spec in METHODS.values())}


def _identity(
    request: FrameRequest, path: Path, sources: list[Path], allow_partial: bool
) -> dict[str, Any]:
    names = [file.relative_to(path).as_posix() if file != path else path.name for file in sources]
    return {
        "files": {name: digest_files([file]) for name, file in zip(names, sources, strict=True)},
        "frames": [request.frames.start, request.frames.stop],
        "sizes": {view: list(request.sizes[view]) for view in request.views},
        "allow_partial": allow_partial,
        "first_frame": request.first_frame,
    }


def _black_truth(request: FrameRequest) -> list[str]:
    """Return the captured frames of which every pixel is 0.

    The size of their files gives them away.
    """
    notes = []
    for view in request.views:
        width, height = request.sizes[view]
        files = {frame: frame_path(request.truth_root / view, frame) for frame in request.frames}
        small = (
            frame
            for frame, file in files.items()
            if file.is_file() and file.stat().st_size < width * height / SMALL + 1000
        )
        black = [frame for frame in small if not request.truth(view, frame).any()]
        notes += [f"captured frames of {view} are all zero: {as_ranges(black)}"] if black else []
    return notes


def _limits(request: FrameRequest) -> Limits:
    """More than any renders of the whole capture need."""
    n_frames = max(request.n_frames, len(request.frames))
    n_pixels = n_frames * sum(width * height for width, height in request.sizes.values())
    n_files = n_frames * len(request.views) * ARCHIVE_FILES_PER_FRAME + ARCHIVE_SLACK_FILES
    return Limits(n_files, n_pixels * ARCHIVE_BYTES_PER_PIXEL + ARCHIVE_SLACK_BYTES)


def _left_out(fitted: Fit) -> list[str]:
    """List what partial renders lack and what the protocol does not want, for the record.

    Nothing is cut short here.
    """
    groups = {"missing": fitted.missing, "not usable": fitted.faulty, "not used": fitted.extras}
    untested = (
        [f"{', '.join(fitted.untested)}: not used, as the protocol does not test these cameras"]
        if fitted.untested
        else []
    )
    return [f"{title}: {item}" for title, items in groups.items() for item in items] + untested


@contextmanager
def run_for(
    root: Path | None,
    open_capture: Callable[[], Capture] | None,
    protocol: str | None,
    workers: int,
) -> Iterator[RunFolder]:
    """Open a run folder, or make one that holds the captured frames of the test views and nothing
    else.

    Renders are imported in its block: a folder that it made is removed where that fails.

    Args:
        root: the folder; ``scores/<capture's folder>`` where None. Alone it need not hold a run
            yet: its block makes one.
        open_capture: opens what was rendered, once all else is known to be right; None if the
            folder has a run.
        protocol: a .toml file or a packaged name; the folder's own, or the packaged one that fits,
            where None.

    Raises:
        ProtocolError: neither a folder nor a capture, or a folder of another protocol or capture.
    """
    terms = asked_protocol(protocol) if protocol else None
    if root is None and open_capture is None:
        raise ProtocolError(
            "wanted a run folder, or --capture CAPTURE to make one, got neither; if renders come "
            "with their truth: --with-truth"
        )
    capture = open_capture() if open_capture else None
    run = RunFolder(root or SCORES_ROOT / (capture.path.resolve().name if capture else ""))
    run_protocol = run.protocol() if run.protocol_file.is_file() else None
    with absent_unless_made(run.root):
        if terms:
            require_protocol(
                run, terms.over(run_protocol.frames.numbers.stop) if run_protocol else terms
            )
        if capture:
            prepare_truth(
                run.root, capture, terms or run_protocol or suggest_protocol(capture), workers
            )
        yield run


def named_renders(items: tuple[str, ...], in_run: bool = True) -> dict[str, Path]:
    """Return name -> path of ``NAME=PATH`` or of a bare path, named after its last component if
    unused and valid.

    In a run, renders that are called as a built-in method, as many call their own "ours", get
    another name, which a line says.
    """
    named: dict[str, Path] = {}
    for item in items:
        name, separator, path = item.partition("=")
        if not separator or "/" in name:  # a path may hold = too
            name, path = plain_label(Path(os.path.abspath(item)).name.split(".")[0]), item
        elif in_run and _is_taken(name) and name != "truth":
            name_in_use, name = name, plain_label(name)
            print(
                f"{path}: called {name} here, since {name_in_use} is a built-in method",
                file=sys.stderr,
            )
        if name in named:
            raise ProtocolError(
                f"--renders: {named[name]} and {path} would both be called {name}; give NAME=PATH"
            )
        named[name] = Path(path)
    return named


def asked_protocol(source: str) -> Protocol:
    """Load a protocol and refuse metrics that there are not.

    A packaged protocol may name metrics whose package is not installed; these are not computed.

    Raises:
        ProtocolError: no such protocol, or an invalid one; a mistyped metric is named with the
            nearest one.
    """
    protocol = load_protocol(source)
    try:
        select_metrics(protocol.measurement.metrics)
        absent = next(filter(None, map(METRICS.why_absent, protocol.measurement.metrics)), None)
        if absent and source not in packaged_protocols():
            raise MetricError(absent)
    except MetricError as error:
        raise ProtocolError(f"{source}: measurement.metrics: {error}") from None
    return protocol
