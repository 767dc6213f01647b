"""Frames that each method of a run has: all of the protocol's, or fewer where partial renders were allowed."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from ggvs_eval.run_folder import RunFolder, as_ranges, read_json, require_frames

IMPORT_FILE = "import.json"
SHOWN_FIELDS = ("kind", "source", "sha256", "notes")


@dataclass(frozen=True)
class Coverage:
    """Frames that there are to score.

    Attributes:
        numbers: frame numbers of the protocol, which every method has but the partial ones.
        partial: label of a partial method -> view -> its frames, rising.
        marks: label of a partial method -> what its row stands on.
        imported: label of a method that others rendered -> where it came from.
    """

    numbers: range
    partial: Mapping[str, Mapping[str, Sequence[int]]]
    marks: Mapping[str, str]
    imported: Mapping[str, dict[str, Any]]

    def frames(self, label: str, view: str) -> Sequence[int]:
        """Frames of one method in one view, rising."""
        return self.partial[label].get(view, ()) if label in self.partial else self.numbers

    def stretches(self, label: str, view: str) -> tuple[range, ...]:
        """The same as runs of consecutive frames: what changes from frame to frame is measured inside of each."""
        stretches: list[range] = []
        for frame in self.frames(label, view):
            if stretches and stretches[-1].stop == frame:
                stretches[-1] = range(stretches[-1].start, frame + 1)
            else:
                stretches.append(range(frame, frame + 1))
        return tuple(stretches)

    def require(self, run: RunFolder, views: Sequence[str], labels: Sequence[str]) -> None:
        """Refuse a run in which frames are missing that should be there."""
        whole = [label for label in labels if label not in self.partial]
        if whole:
            require_frames({f"{label} in {view}": run.renders(label, view) for label in whole for view in views}, self.numbers)
        for label, by_view in self.partial.items():
            for view, frames in by_view.items():
                for stretch in self.stretches(label, view) if frames else ():
                    require_frames({f"{label} in {view}": run.renders(label, view)}, stretch)

    def identity(self, label: str, view: str) -> dict[str, str]:
        """Return what a score depends on beside the pixels: which frames they are, where these are not the protocol's."""
        return {"frames": as_ranges(list(self.frames(label, view)))} if label in self.partial else {}


def read_coverage(run: RunFolder, numbers: range, labels: Sequence[str]) -> Coverage:
    """Read the coverage of a run from the records of its imports."""
    records = {label: read_import(run, label) for label in labels}
    imports = {label: record for label, record in records.items() if record}
    scene = run.capture_record()["scene"]
    partial = {label: record["frames"] for label, record in imports.items() if record["partial"]}
    marks = {label: f"partial in {scene}: {imports[label]['partial']}" for label in partial}
    return Coverage(numbers, partial, marks, {label: {key: r[key] for key in SHOWN_FIELDS} for label, r in imports.items()})


def read_import(run: RunFolder, label: str) -> dict[str, Any] | None:
    """The record of an import; None where the method was rendered here."""
    file = run.root / "renders" / label / IMPORT_FILE
    return dict(read_json(file)) if file.is_file() else None
