"""Renders that come with their truth become a run without a capture: archives as papers publish
them, or folders.

A folder holds ``renders/`` and ``gt/`` with pictures of equal names, see
`ggvs_eval.renders.beside_truth`. The form of an archive, by the card of 4DGV's evaluation (TOG
44(4), 2025): one ``.npz`` per view or scene with ``renders`` and ``gts``, (T, H, W, 3) as float in
[0, 1] or uint8, and perhaps ``metrics``, one line per frame, whose order it does not say.
"""

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.errors import RenderError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.files.digest import digest_files
from ggvs_eval.files.images import read_image, to_8_bit, write_image
from ggvs_eval.pipelines.run.claim import require_protocol
from ggvs_eval.pipelines.run.import_renders import SCORES_ROOT, asked_protocol, run_for
from ggvs_eval.progress import counted, track
from ggvs_eval.protocol import (
    AGREEING,
    OF_OWN_TRUTH,
    CameraPath,
    Frames,
    Measurement,
    Protocol,
    Synthesis,
    Views,
)
from ggvs_eval.renders.beside_truth import truth_pictures
from ggvs_eval.renders.truth_match import difference
from ggvs_eval.renders.view_streams import (
    OWN_RENDERS,
    OWN_TRUTH,
    ArrayStack,
    npz_members,
    read_small_array,
)
from ggvs_eval.results import Results, split_label
from ggvs_eval.run_folder import RunFolder, frame_path, write_json

NAME = "own-truth"
ROUNDING = 0.51  # levels of 255 by which two copies of one truth may differ
PUBLISHED = "metrics"  # member with what the authors measured, per frame


@contextmanager
def run_with_truth(
    root: Path | None, renders: Mapping[str, Path], protocol: str | None
) -> Iterator[RunFolder]:
    """Open a run folder, or make one, whose captured frames are those in the archives.

    A folder is removed where its block fails.

    Args:
        root: the folder; ``scores/<first method>`` where None.
        renders: label -> archive, or folder with one per view; their truth must be the same.
        protocol: whose measures are taken; its views and frames are those of the archives.

    Raises:
        RenderError: no archives with their truth, or truths that differ.
    """
    if not renders:
        raise RenderError(
            "--with-truth: no renders are named; give --renders NAME=PATH, an .npz or a folder of "
            "renders/ and gt/"
        )
    sets = {label: own_truths(path) for label, path in renders.items()}
    first, stacks = next(iter(sets.items()))
    for label, archives in sets.items():
        if archives.keys() != stacks.keys():
            listed = f"{', '.join(stacks)} of {first}, {', '.join(archives)} of {label}"
            raise RenderError(
                f"{renders[label]}: wanted archives of the same views, got {listed}; score them in "
                f"separate runs"
            )
    counts = {stack.n_frames for stack in stacks.values()}
    if len(counts) > 1:
        raise RenderError(
            f"{renders[first]}: wanted views of one length, got "
            f"{', '.join(map(str, sorted(counts)))} frames; cut them"
        )
    frames = Frames(0, counts.pop())
    measurement = (
        asked_protocol(protocol).measurement
        if protocol
        else Measurement(OF_OWN_TRUTH, ceilings=False)
    )
    with run_for(root or SCORES_ROOT / first, None, None, 1) as run:
        is_new = not run.protocol_file.is_file()
        dataset = renders[first].resolve().stem if is_new else run.protocol().dataset
        views = Views(tuple(stacks), "those of the archives")
        terms = Protocol(
            name=NAME,
            dataset=dataset,
            views=views,
            frames=frames,
            synthesis=Synthesis(),
            measurement=measurement,
            path=CameraPath(0),
        )
        require_protocol(run, terms)
        if is_new:
            _write_truth(run, stacks, terms, renders[first])
        elif "truth" not in run.capture_record():
            raise RenderError(f"{run.root}: holds a run of a capture; choose a new folder by --run")
        for archives in sets.values():
            for view, stack in archives.items():
                _require_same(run, view, stack, frames.numbers)
        yield run


@dataclass(frozen=True)
class Pictures:
    """Truth of a view as pictures, in order."""

    path: Path
    files: tuple[Path, ...]

    @property
    def name(self) -> str:
        """Folder, for messages."""
        return str(self.files[0].parent)

    @property
    def n_frames(self) -> int:
        """Number of pictures."""
        return len(self.files)

    def frames(self, start: int, stop: int) -> Iterator[np.ndarray]:
        """Yield the frames start <= t < stop one by one, RGB (H, W, 3), uint8."""
        return map(read_image, self.files[start:stop])


def own_truths(path: Path) -> dict[str, ArrayStack | Pictures]:
    """Return view -> the truth in an archive, in each of a folder's, or next to a folder of
    renders.

    Raises:
        RenderError: neither, or an archive without both arrays.
    """
    files = sorted(path.glob("*.npz")) if path.is_dir() else [path]
    if not files or not path.exists():
        return {
            view: Pictures(path, tuple(pictures)) for view, pictures in truth_pictures(path).items()
        }
    for file in files:
        if file.suffix.lower() != ".npz" or not {OWN_RENDERS, OWN_TRUTH} <= {*npz_members(file)}:
            names = (
                ", ".join(npz_members(file)[:9])
                if file.suffix.lower() == ".npz"
                else f"a {file.suffix or 'folder'}"
            )
            raise RenderError(
                f"{file}: wanted arrays {OWN_RENDERS} and {OWN_TRUTH}, got {names or 'none'}; save "
                "them by numpy.savez, or give --capture without --with-truth"
            )
    return {file.stem: ArrayStack(file, OWN_TRUTH) for file in files}


def _write_truth(
    run: RunFolder, stacks: Mapping[str, ArrayStack | Pictures], protocol: Protocol, source: Path
) -> None:
    """Write the truth of each view as PNG, then the records of a run."""
    for view, stack in stacks.items():
        for number, frame in enumerate(
            track(stack.frames(0, stack.n_frames), f"truth of {view}", total=stack.n_frames)
        ):
            write_image(frame_path(run.truth(view), number), to_8_bit(frame))
    files = {view: sorted(run.truth(view).glob("*.png")) for view in stacks}
    record = {
        "path": str(source),
        "scene": source.resolve().name.removesuffix(".npz"),
        "layout": "truth beside renders",
        "truth": "came with the renders",
        "fps": 0,
        "n_frames": protocol.frames.count,
        "notes": [],
        "cameras": {view: {} for view in stacks},
        "digests": {view: digest_files(pictures) for view, pictures in files.items()},
        "coding": dict.fromkeys(stacks),
    }
    write_json(run.root / "capture.json", record)
    write_text(run.protocol_file, protocol.to_toml())


def _require_same(run: RunFolder, view: str, stack: ArrayStack | Pictures, frames: range) -> None:
    """Refuse an archive whose truth is not that of the run."""
    if stack.n_frames != len(frames):
        raise RenderError(
            f"{stack.name}: wanted the {len(frames)} frames of this run's reference, got "
            f"{stack.n_frames}; choose another --run"
        )
    for number, frame in enumerate(stack.frames(0, stack.n_frames)):
        levels = difference(to_8_bit(frame), read_image(frame_path(run.truth(view), number)))
        if levels > ROUNDING:
            deviation = (
                f"{levels:.2f} levels of 255 away" if np.isfinite(levels) else "of another size"
            )
            raise RenderError(
                f"{stack.name}: wanted the reference of this run, frame {number} is {deviation}; "
                f"score it with another --run"
            )


def compare_published(renders: Mapping[str, Path], results: Results) -> list[str]:
    """Compare what the archives say of each frame with what was measured, a line for each column
    that is a known metric's.

    Reading:
        The order of the columns is stated nowhere: a column is that metric's which most of its
        values agree with.
    """
    return [line for label, path in renders.items() for line in _compare(label, path, results)]


def _compare(label: str, path: Path, results: Results) -> Iterator[str]:
    for view, stack in own_truths(path).items():
        if isinstance(stack, Pictures) or PUBLISHED not in npz_members(stack.path):
            continue
        published = np.asarray(read_small_array(stack.path, PUBLISHED), np.float64)
        if published.ndim != 2 or len(published) != stack.n_frames:
            shape = " x ".join(map(str, published.shape))
            yield (
                f"{label}, {view}: {PUBLISHED} is {shape}, not a line for each frame; not compared"
            )
            continue
        for at, column in enumerate(published.T):
            yield (
                f"{label}, {view}: {PUBLISHED} column {at} "
                f"{_column_words(column, split_label(label), view, results)}"
            )


def _column_words(
    published: np.ndarray, method: tuple[str, str], view: str, results: Results
) -> str:
    """State the metric of a column, and its differences."""
    apart: dict[str, np.ndarray] = {}
    for metric in AGREEING:
        table = results.per_frame(metric, view)
        if method in table and len(table[method].dropna()) == len(published):
            apart[metric] = np.abs(table[method].to_numpy() - published) / AGREEING[metric]
    near = {metric: float(np.median(ratios)) for metric, ratios in apart.items()}
    best = min(near, key=lambda metric: near[metric], default="")
    if not best or not near[best] <= 1.0:
        return "is none of " + ", ".join(AGREEING) + " as measured here"
    ratios = apart[best]
    wrong: Sequence[int] = np.flatnonzero(~(ratios <= 1.0)).tolist()
    if not wrong:
        return f"is {best} and agrees (at most {float(ratios.max()) * AGREEING[best]:.4f} apart)"
    worst = int(np.argmax(ratios))
    value = float(results.per_frame(best, view)[method].to_numpy()[worst])
    many = counted(len(wrong), "frame")
    return (
        f"is {best} and differs in {many}, most in frame {worst}: {published[worst]:.4f} there, "
        f"{value:.4f} here"
    )
