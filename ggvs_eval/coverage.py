"""Frames that each method of a run has: all of the protocol's, or fewer where it refused views or
renders are partial.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image
from ggvs_eval.measured_frames import resized_frame
from ggvs_eval.protocol import Measurement
from ggvs_eval.run_folder import (
    JOB_FILE,
    REFUSED,
    RunFolder,
    as_ranges,
    frame_path,
    missing_frames,
    read_json,
    require_frames,
)

IMPORT_FILE = "import.json"
SHOWN_FIELDS = ("kind", "source", "sha256", "notes")


@dataclass(frozen=True)
class Coverage:
    """Frames that there are to score.

    Attributes:
        numbers: frame numbers of the protocol, which every method has but the partial ones.
        partial: label of a partial method -> view -> its frames, ascending.
        marks: label of a partial method -> what its row is based on.
        imported: label of a method that others rendered -> where it came from.
        refused: label of a method -> view that it cannot show -> why not.
    """

    numbers: range
    partial: Mapping[str, Mapping[str, Sequence[int]]]
    marks: Mapping[str, str]
    imported: Mapping[str, dict[str, Any]]
    refused: Mapping[str, Mapping[str, str]]

    def frames(self, label: str, view: str) -> Sequence[int]:
        """Return the frames of one method in one view, ascending."""
        return self.partial[label].get(view, ()) if label in self.partial else self.numbers

    def stretches(self, label: str, view: str) -> tuple[range, ...]:
        """Return the same as runs of consecutive frames: what changes from frame to frame is
        measured inside of each.
        """
        stretches: list[range] = []
        for frame in self.frames(label, view):
            if stretches and stretches[-1].stop == frame:
                stretches[-1] = range(stretches[-1].start, frame + 1)
            else:
                stretches.append(range(frame, frame + 1))
        return tuple(stretches)

    def unfinished(self, run: RunFolder, views: Sequence[str], labels: Sequence[str]) -> set[str]:
        """Return the methods rendered here that lack frames which they have not refused: an earlier
        call was stopped.
        """
        local_labels = [label for label in labels if label not in self.imported]
        files = {
            label: [
                frame_path(run.renders(label, view), frame)
                for view in views
                for frame in self.frames(label, view)
            ]
            for label in local_labels
        }
        return {
            label for label, frames in files.items() if not all(frame.is_file() for frame in frames)
        }

    def require(self, run: RunFolder, views: Sequence[str], labels: Sequence[str]) -> None:
        """Refuse a run in which frames are missing that should be there."""
        require_imported(run, labels)
        complete = [label for label in labels if label not in self.partial]
        if complete:
            require_frames(
                {
                    f"{label} in {view}": run.renders(label, view)
                    for label in complete
                    for view in views
                },
                self.numbers,
            )
        for label, by_view in self.partial.items():
            for view, frames in by_view.items():
                for stretch in self.stretches(label, view) if frames else ():
                    require_frames({f"{label} in {view}": run.renders(label, view)}, stretch)

    def identity(self, label: str, view: str) -> dict[str, str]:
        """Return what a score depends on besides the pixels: the frames, if they are not the
        protocol's.
        """
        return (
            {"frames": as_ranges(list(self.frames(label, view)))} if label in self.partial else {}
        )


def read_coverage(run: RunFolder, numbers: range, labels: Sequence[str]) -> Coverage:
    """Read the coverage of a run from the records of its imports and renders."""
    records = {label: read_import(run, label) for label in labels}
    imports = {label: record for label, record in records.items() if record}
    scene, views = run.capture_record()["scene"], run.protocol().views.test
    refused = {
        label: reasons
        for label in labels
        if label not in imports and (reasons := _refusals(run, label, views))
    }
    partial = {label: record["frames"] for label, record in imports.items() if record["partial"]}
    partial |= {
        label: {view: numbers for view in views if view not in reasons}
        for label, reasons in refused.items()
    }
    marks = {
        label: f"partial in {scene}: {imports[label]['partial']}"
        for label in imports
        if label in partial
    }
    for label, reasons in refused.items():
        marks[label] = (
            f"partial in {scene}: without {', '.join(reasons)} ({next(iter(reasons.values()))})"
        )
    origins = {
        label: {key: record[key] for key in SHOWN_FIELDS} for label, record in imports.items()
    }
    return Coverage(
        numbers=numbers, partial=partial, marks=marks, imported=origins, refused=refused
    )


def require_imported(run: RunFolder, labels: Sequence[str]) -> None:
    """Refuse imported renders whose files have been moved or removed: a run links to them."""
    for label in labels:
        frames = (run.root / "renders" / label).glob("*/*.png")
        if lost := next((frame for frame in frames if not frame.exists()), None):
            remedy = f"restore them, or run `ggvs-eval score {run.root} --renders {label}=NEWPLACE`"
            raise RenderError(
                f"{run.root}: wanted the frames of {label} in {lost.readlink().parent}, got none; "
                f"{remedy}"
            )


def frame_reader(folder: Path, measurement: Measurement | None = None) -> Callable[[int], Image8]:
    """Return the frames of a folder as they are there, or at the size at which a protocol measures
    them.
    """

    def read(index: int) -> Image8:
        image = read_image(frame_path(folder, index))
        return image if measurement is None else resized_frame(image, measurement)

    return read


def path_poses(run: RunFolder) -> range:
    """Return the numbers of the poses of the camera path; none if there is no path."""
    return range(len(read_json(run.path_record)["cameras"]) if run.path_record.is_file() else 0)


def lacks_path(run: RunFolder, label: str) -> bool:
    """Tell whether a method was rendered along the path and some of it is lost.

    One that refused the path has no picture.
    """
    record = run.path(label) / JOB_FILE
    if not record.is_file() or REFUSED in read_json(record):
        return False
    return bool(missing_frames(run.path(label), path_poses(run)))


def _refusals(run: RunFolder, label: str, views: Sequence[str]) -> dict[str, str]:
    """Return view -> why a method of this package cannot show it."""
    records = {view: run.renders(label, view) / JOB_FILE for view in views}
    return {
        view: why
        for view, file in records.items()
        if file.is_file() and (why := read_json(file).get(REFUSED))
    }


def read_import(run: RunFolder, label: str) -> dict[str, Any] | None:
    """Return the record of an import; None if the method was rendered here."""
    file = run.root / "renders" / label / IMPORT_FILE
    return dict(read_json(file)) if file.is_file() else None


def guessed_first(run: RunFolder, label: str) -> int:
    """Return the number in the names of imported frames that was taken for the capture's first
    instant; 0 if none was guessed.
    """
    return int((read_import(run, label) or {}).get("counted_from", 0))
