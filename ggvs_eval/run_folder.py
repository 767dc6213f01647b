"""Layout of a run folder: one capture under one protocol, from which any step can be resumed.

::

    RUN/protocol.toml  capture.json              what was asked for, of which capture
    RUN/truth/<camera>/<frame>.png               captured frames of the cameras that take part, at
    synthesis size RUN/depth/<key>/<frame>.*                    depth store of the source cameras;
    depth.json says how it was found RUN/depth_page/index.html                    the depth in
    pictures RUN/fused/<frame>/points.ply  mesh.ply       one instant as a point cloud and a mesh,
    where asked for RUN/renders/<method>/<view>/<frame>.png      synthesised frames, and job.json:
    identity, versions, seconds per stage RUN/renders/<method>/<view>/inside/<map>/    depth,
    weights, coverage, motion of those frames, of methods with diagnostics
    RUN/renders/<method>@screen/<view>/          links to what a viewer sees at each instant
    RUN/path/truth/<pose>.png                    a camera path at one instant: truth if there is
    one, poses in path.json RUN/path/<method>/<pose>.png                 the same path synthesised,
    for epipolar plane images RUN/path_depth/<pose>.npy                    depth along the path, the
    same for all methods RUN/path_scores/<method>/job.json            view consistency of every
    method along the path RUN/disoccluded/<view>/<frame>.png           white where no source camera
    sees the view RUN/ceilings/<view>/job.json                 what perfect renderings of the view
    would score RUN/live_depth.json  stream.json             seconds of live depth; what each method
    has on the screen, where asked for RUN/scores/<view>/job.json                   values of every
    method in one view RUN/results.parquet  results.json            every value in one table, and
    where it comes from RUN/report/index.html                        the page job.json
    beside all that is made once: what it was made from, and its files
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ggvs_eval.errors import RenderError, ResultsError, no_such_path
from ggvs_eval.files.atomic import write_text
from ggvs_eval.protocol import Protocol, load_protocol

JOB_FILE = "job.json"
REFUSED = "refused"  # in the record of a render or a fit: why the method cannot show those views
DIAGNOSTICS = "inside"  # folder of diagnostic images, next to a method's frames
ON_SCREEN = "@screen"  # ends the label of a row that is no method: what a viewer sees of one
SCREEN_TITLE = ", on the screen"  # ends its title


@dataclass(frozen=True)
class RunFolder:
    """Paths and small records of one run."""

    root: Path

    @property
    def protocol_file(self) -> Path:
        """The protocol as it was used."""
        return self.root / "protocol.toml"

    @property
    def depth(self) -> Path:
        """Root of the depth store."""
        return self.root / "depth"

    @property
    def depth_record(self) -> Path:
        """File of the options by which that depth is found."""
        return self.root / "depth.json"

    @property
    def live_depth_record(self) -> Path:
        """File of the seconds that live depth took; only if its time counts."""
        return self.root / "live_depth.json"

    @property
    def has_live_depth(self) -> bool:
        """True if depth is found by a matcher that keeps up with cameras: `live`, or IterMVS alone
        on a GPU.
        """
        record = read_json(self.depth_record) if self.depth_record.is_file() else {}
        matcher = record.get("matcher", "")
        is_network_on_gpu = matcher.partition(":")[0] == "itermvs" and "device" in record
        return matcher == "live" or is_network_on_gpu

    @property
    def stream_record(self) -> Path:
        """File of what each method has on the screen while frames keep coming.

        Only where the protocol asks for it.
        """
        return self.root / "stream.json"

    @property
    def check_record(self) -> Path:
        """File of what `ggvs-eval check` found in the capture, as it writes it.

        Only if that was asked.
        """
        return self.root / "check.json"

    @property
    def report(self) -> Path:
        """Folder of the page and its tables."""
        return self.root / "report"

    def truth(self, view: str) -> Path:
        """Return the captured frames of a test view."""
        return self.root / "truth" / view

    def renders(self, label: str, view: str) -> Path:
        """Return the frames of one method (``method`` or ``method+variant``) in one test view."""
        return self.root / "renders" / label / view

    def path(self, label: str) -> Path:
        """Return the frames of one method, or of the ``truth``, along the camera path."""
        return self.root / "path" / label

    def disoccluded(self, view: str) -> Path:
        """Masks of the parts of a test view that no source camera sees."""
        return self.root / "disoccluded" / view

    def ceilings(self, view: str) -> Path:
        """Return the scores that perfect renderings of a test view would have."""
        return self.root / "ceilings" / view

    @property
    def path_record(self) -> Path:
        """File of the poses of the camera path and the source cameras of each."""
        return self.root / "path" / "path.json"

    @property
    def path_depth(self) -> Path:
        """Depth along the camera path, the same for all methods."""
        return self.root / "path_depth"

    def path_scores(self, label: str) -> Path:
        """Return the values of one method, or of the ``truth``, along the camera path."""
        return self.root / "path_scores" / label

    def scores(self, view: str) -> Path:
        """Return the values of every method in one view."""
        return self.root / "scores" / view

    def protocol(self) -> Protocol:
        """Return the protocol of this run.

        Raises:
            ResultsError: the folder is not a run.
        """
        self._require_run()
        return load_protocol(self.protocol_file)

    @property
    def has_capture_record(self) -> bool:
        """False for a folder that holds the numbers of a run alone."""
        return (self.root / "capture.json").is_file()

    def capture_record(self) -> dict[str, Any]:
        """Scene, layout, fps, units and cameras of the capture, as `ggvs-eval prepare` wrote them.

        Raises:
            ResultsError: the folder is not a run, or the record is damaged.
        """
        self._require_run()
        return read_json(self.root / "capture.json")

    def _require_run(self) -> None:
        if not self.root.exists():
            raise ResultsError(no_such_path(self.root, "a run folder"))
        if not self.protocol_file.is_file():
            raise ResultsError(
                f"{self.root}: wanted a run folder with protocol.toml, got none; create one by "
                f"`ggvs-eval run`"
            )

    def capture_path(self) -> Path:
        """Return the capture's folder: where it lay when the run was prepared, or where it moved
        together with the run.
        """
        record = self.capture_record()
        # a run of an earlier version knows only the path as it was given
        place = record.get("place", {})
        candidates = (
            [Path(place["absolute"]), (self.root / place["from_run"]).resolve()] if place else []
        )
        return next((path for path in candidates if path.exists()), Path(record["path"]))

    def labels(self) -> list[str]:
        """Return the methods that have renders here, in the order in which `ggvs-eval render` was
        asked for them.
        """
        folder = self.root / "renders"
        names = sorted(item.name for item in folder.iterdir()) if folder.is_dir() else []
        content = [
            name for name in names if not name.startswith(".") and not name.endswith(ON_SCREEN)
        ]
        order_file = self.root / "methods.json"
        order = read_json(order_file)["labels"] if order_file.is_file() else []
        return [label for label in order if label in content] + [
            label for label in content if label not in order
        ]

    @property
    def shown_names(self) -> dict[str, str]:
        """Label -> name to show, as the score step wrote them."""
        return dict(read_json(self.root / "methods.json")["names"])


def frame_path(folder: Path, index: int) -> Path:
    """Return the path of one frame in a folder of frames.

    Examples:
        >>> frame_path(Path("cam00"), 12).as_posix()
        'cam00/0012.png'
    """
    return folder / f"{index:04d}.png"


def frame_names(numbers: Iterable[int], suffix: str = ".png") -> tuple[str, ...]:
    """Return the names of the files of some frames, each once and in the order of time."""
    return tuple(
        frame_path(Path(), number).with_suffix(suffix).name for number in sorted(set(numbers))
    )


def frame_numbers(names: Iterable[str]) -> list[int]:
    """Return the frames of some files."""
    return [int(Path(name).stem) for name in names]


def diagnostics_path(folder: Path, name: str, index: int) -> Path:
    """Return the path of the picture of something that a method decided on the way to a frame, in
    its folder of frames.
    """
    return frame_path(folder / DIAGNOSTICS / name, index)


def missing_frames(folder: Path, indices: range) -> list[int]:
    """Wanted frames that are not in a folder."""
    return [index for index in indices if not frame_path(folder, index).is_file()]


def require_frames(folders: dict[str, Path], indices: range) -> None:
    """Refuse incomplete renders with the whole list of gaps.

    Args:
        folders: what each folder is, e.g. ``ours in cam00`` -> its path.
    """
    gaps = {name: missing_frames(folder, indices) for name, folder in folders.items()}
    listed = [f"{name} lacks {as_ranges(missing)}" for name, missing in gaps.items() if missing]
    if listed:
        root = next(iter(folders.values())).parents[1]
        raise RenderError(
            f"{root}: wanted all frames, got gaps: {'; '.join(listed)}; run `ggvs-eval render`"
        )


def as_ranges(indices: list[int]) -> str:
    """Write sorted indices briefly: 0-3, 7, 9-11.

    Examples:
        >>> as_ranges([0, 1, 2, 3, 7, 9, 10, 11])
        '0-3, 7, 9-11'
    """
    parts: list[list[int]] = []
    for index in indices:
        if parts and index == parts[-1][-1] + 1:
            parts[-1] = [parts[-1][0], index]
        else:
            parts.append([index])
    return ", ".join("-".join(map(str, part)) for part in parts)


def write_json(path: Path, record: Any) -> None:
    """Write a JSON file whole or not at all."""
    write_text(path, json.dumps(record, indent=1))


def read_json(path: Path) -> Any:
    """Read a JSON file that this package wrote."""
    try:
        return json.loads(path.read_text(encoding="utf-8"))
    except FileNotFoundError:
        raise ResultsError(
            f"{path}: wanted this file, got none; run the step that writes it"
        ) from None
    except (OSError, ValueError) as error:
        raise ResultsError(
            f"{path}: wanted a readable file, got: {error}; move it away and run the step again"
        ) from None
