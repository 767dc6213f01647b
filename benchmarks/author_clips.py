"""No-reference metrics of the authors' result clips: their method next to each baseline, and the
floor that the codec sets.

``python -m benchmarks.author_clips FOLDER [--colmap] [--out out/author_clips.json]``

FOLDER holds the clips of the paper's project page (github.com/nkhan2/nkhan2.github.io,
``projects/geometry-guided-2025/videos/comparison/*_vs_ours.mp4``; no licence: read them, do not
pass them on). Each shows a baseline in its left half and the paper's method in its right one, along
one moving camera. A clip that has been measured is not measured again. `--colmap` adds one run of
COLMAP per data set and method, and one with the views shuffled.

The same frames of the paper's method are in the clips of all three baselines, encoded three times:
what a metric differs by between them is the codec's.
"""

import argparse
import re
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.more_metrics.colmap_consistency import colmap_consistency
from ggvs_eval.errors import CaptureError, GgvsError
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.metrics.series_scores import mean_values, score_frames
from ggvs_eval.run_folder import read_json, write_json

PATTERN = re.compile(
    r"(?P<dataset>dynerf|enerf|d3dmv)_(?P<sequence>.+)_(?P<baseline>enerf|gpsg|ibrnet)_vs_ours\.mp4"
)
LABEL_ROWS = 40  # the names of the methods are in the upper corners, in rows 5 to 38
COLMAP_VIEWS = 30  # evenly spaced frames of each half
LEAST_FRAMES = 3  # of a second difference
OURS, SHUFFLED = "ours", "ours, shuffled"


@dataclass(frozen=True)
class Clip:
    """One clip.

    Attributes:
        path: its file.
        dataset: ``dynerf``, ``enerf`` (ENeRF-Outdoor) or ``d3dmv``.
        sequence: of that data set.
        baseline: what its left half shows.
    """

    path: Path
    dataset: str
    sequence: str
    baseline: str

    def half(self, side: Literal[0, 1]) -> Iterator[Image8]:
        """Left (0) or right (1) half of each frame, without the rows of the labels.

        Raises:
            CaptureError: a clip that ends too early, cannot be read, or has no two halves.
        """
        video = VideoFrames(self.path)
        width, height = video.size
        if width % 2 or height <= 2 * LABEL_ROWS or video.n_frames < LEAST_FRAMES:
            raise CaptureError(
                f"{self.path}: wanted {LEAST_FRAMES} frames or more of two equal halves and more "
                f"than {2 * LABEL_ROWS} rows, got {video.n_frames} of {width} x {height}; fetch "
                "the clip again"
            )
        for frame in video.frames(0, video.n_frames):
            yield frame[LABEL_ROWS:, side * width // 2 : (side + 1) * width // 2]


def main(arguments: Sequence[str] | None = None) -> None:
    """Measure what has not been measured, and write it after every clip."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folder", type=Path)
    parser.add_argument("--out", type=Path, default=Path("out/author_clips.json"))
    parser.add_argument(
        "--colmap", action="store_true", help="also one run of COLMAP per data set and method"
    )
    options = parser.parse_args(arguments)
    try:
        measure(options.folder, options.out, with_colmap=options.colmap)
    except GgvsError as error:
        sys.exit(f"author_clips: {error}")


def measure(folder: Path, out: Path, *, with_colmap: bool = False) -> dict[str, Any]:
    """Measure every clip of a folder.

    Args:
        folder: see above.
        out: JSON file: ``clips`` (file -> what it shows, digest, metric -> value of each half),
            ``colmap`` (data set -> method -> values); a clip that is in it with the same digest is
            kept.
        with_colmap: also the COLMAP consistency of the first sequence of each data set.

    Raises:
        CaptureError: no folder, no clips in it, or a damaged one.
    """
    clips = find_clips(folder)
    record: dict[str, Any] = read_json(out) if out.is_file() else {"clips": {}, "colmap": {}}
    for number, clip in enumerate(clips, start=1):
        digest = VideoFrames(clip.path).digest
        if record["clips"].get(clip.path.name, {}).get("digest") == digest:
            continue
        record["clips"][clip.path.name] = measured_clip(clip) | {"digest": digest}
        write_json(out, record)
        print(f"{number} of {len(clips)}: {clip.path.name}", flush=True)
    if with_colmap:
        _measure_colmap(clips, record, out)
    return record


def find_clips(folder: Path) -> list[Clip]:
    """List the clips of a folder by name.

    Raises:
        CaptureError: no such folder, or none of its files has the name of a clip.
    """
    if not folder.is_dir():
        raise CaptureError(
            f"{folder}: wanted the folder of the authors' clips, there is none; see the head of "
            f"this program"
        )
    named = [(path, PATTERN.fullmatch(path.name)) for path in sorted(folder.iterdir())]
    clips = [Clip(path, **match.groupdict()) for path, match in named if match]
    if not clips:
        raise CaptureError(
            f"{folder}: wanted clips like dynerf_flame_steak_enerf_vs_ours.mp4, got {len(named)} "
            f"other files"
        )
    return clips


def measured_clip(clip: Clip) -> dict[str, Any]:
    """Return metric -> mean over the frames, of both halves of a clip, and what the clip shows."""
    shown = {name: value for name, value in asdict(clip).items() if name != "path"}
    values = {
        clip.baseline: mean_values(score_frames(clip.half(0))),
        OURS: mean_values(score_frames(clip.half(1))),
    }
    return shown | {"n_frames": VideoFrames(clip.path).n_frames, "values": values}


def _measure_colmap(clips: Sequence[Clip], record: dict[str, Any], out: Path) -> None:
    """COLMAP consistency of each method on the first sequence of each data set, and of the paper's
    with its views shuffled.
    """
    for dataset in dict.fromkeys(clip.dataset for clip in clips):
        of_dataset = [clip for clip in clips if clip.dataset == dataset]
        of_first = [clip for clip in of_dataset if clip.sequence == of_dataset[0].sequence]
        measured = record["colmap"].setdefault(dataset, {})
        runs: list[tuple[str, Clip, Literal[0, 1]]] = [
            (clip.baseline, clip, 0) for clip in of_first
        ]
        for label, clip, side in [*runs, (OURS, of_first[0], 1), (SHUFFLED, of_first[0], 1)]:
            if label not in measured:
                views = _spread_views(clip, side)
                ordered = (
                    views
                    if label != SHUFFLED
                    else [views[i] for i in np.random.default_rng(0).permutation(len(views))]
                )
                measured[label] = {"sequence": clip.sequence, **asdict(colmap_consistency(ordered))}
                write_json(out, record)
                print(f"COLMAP, {dataset}, {label}: {measured[label]}", flush=True)


def _spread_views(clip: Clip, side: Literal[0, 1]) -> list[Image8]:
    """Evenly spaced frames of a half, for COLMAP."""
    taken = set(
        np.linspace(0, VideoFrames(clip.path).n_frames - 1, COLMAP_VIEWS)
        .round()
        .astype(int)
        .tolist()
    )
    return [frame for index, frame in enumerate(clip.half(side)) if index in taken]


if __name__ == "__main__":
    main()
