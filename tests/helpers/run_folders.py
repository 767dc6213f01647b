"""A run folder made by hand: real small pictures, made-up values, everything that a report
reads.
"""

import dataclasses
import json
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.files.images import write_image
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.registry import METRICS as REGISTERED
from ggvs_eval.metrics.registry import metric_notes, pooling_records
from ggvs_eval.protocol import Frames, Measurement, Protocol, Synthesis, Views
from ggvs_eval.results import Results, make_table
from ggvs_eval.run_folder import JOB_FILE, RunFolder, frame_path, read_json, write_json
from ggvs_eval.statistics.pooling import MEAN

METRICS = ("PSNR", "PSNR_cc", "SSIM", "LPIPS", "L1", "TCC", "STED", "SDT", "SDV")
UNITS = {"PSNR": "dB", "PSNR_cc": "dB"}
HIGHER = {"PSNR", "PSNR_cc", "SSIM", "TCC"}
SIZES = {
    "PSNR": 40.0,
    "PSNR_cc": 42.0,
    "LPIPS": 0.5,
    "L1": 20.0,
    "STED": 900.0,
    "SDT": 0.5,
    "SDV": 4.0,
}
PER_SEQUENCE = {"STED", "SDT"}
LABELS = ("no-blending", "ours-geometric", "ours-geometric+no-temporal")
NAMES = {
    "no-blending": "No Blending",
    "ours-geometric": "GGVS (online), geometric weights",
    "ours-geometric+no-temporal": "GGVS (online), no temporal filtering",
}
METRIC_NOTES = metric_notes(REGISTERED)
Painter = Callable[[str, str, int], Image8]


@dataclasses.dataclass(frozen=True)
class RunShape:
    """How large a run is, and what it is called."""

    views: tuple[str, ...] = ("cam00", "cam03")
    frames: Frames = dataclasses.field(default_factory=lambda: Frames(2, 4))
    width: int = 64
    height: int = 48
    poses: int = 6
    path_truth: bool = True
    labels: tuple[str, ...] = LABELS
    metrics: tuple[str, ...] = METRICS
    scene: str = "room"
    # digest of its captured frames; follows from the name of the scene where empty
    content: str = ""
    dataset: str = "Demo room"
    names: tuple[tuple[str, str], ...] = tuple(NAMES.items())
    k: int = 2


def write_run(
    root: Path,
    shape: RunShape | None = None,
    paint: Painter | None = None,
    not_computed: dict[str, str] | None = None,
) -> Path:
    """Write a whole run folder; equal arguments give equal bytes.

    Args:
        root: folder to make.
        shape: size and names.
        paint: (label or ``truth``, view or ``path``, index) -> picture.
        not_computed: metric -> reason; these get no values.
    """
    shape, run = shape or RunShape(), RunFolder(root)
    paint = paint or _painter(shape)
    protocol = make_protocol(shape)
    frames = shape.frames.numbers
    for label in ("truth", *shape.labels):
        for view in shape.views:
            folder = run.truth(view) if label == "truth" else run.renders(label, view)
            for index in frames:
                write_image(frame_path(folder, index), paint(label, view, index))
            if label != "truth":
                write_json(
                    folder / JOB_FILE, {"seconds": stage_seconds(label, len(frames)), "threads": 2}
                )
        for pose in range(shape.poses if label != "truth" or shape.path_truth else 0):
            write_image(frame_path(run.path(label), pose), paint(label, "path", pose))
    run.protocol_file.write_text(protocol.to_toml(), encoding="utf-8")
    _write_records(run, shape, protocol, not_computed or {})
    return root


def make_fitted(root: Path, labels: Sequence[str]) -> Path:
    """Make methods of a run fitted ones, two folds of one view each, by three of five cameras."""
    run = RunFolder(root)
    write_json(
        root / "capture.json",
        run.capture_record() | {"cameras": {f"cam{at:02d}": {} for at in range(5)}},
    )
    fit = {
        "instants": 4,
        "cameras": 3,
        "look_ahead": "sequence",
        "seed": 0,
        "size_bytes": 8_000_000,
    }
    for label in labels:
        for view, seconds in zip(run.protocol().views.test, (40.0, 80.0), strict=True):
            job = run.renders(label, view) / JOB_FILE
            machine = {"seconds": seconds, "threads": 2, "machine": "a processor"}
            write_json(job, read_json(job) | {"fit": fit | machine})
    return root


def make_protocol(shape: RunShape) -> Protocol:
    """The protocol of a run of that shape."""
    measured = Measurement(metrics=shape.metrics)
    return Protocol(
        "tiny",
        shape.dataset,
        Views(shape.views, "by hand"),
        shape.frames,
        Synthesis(k=shape.k),
        measured,
    )


def stage_seconds(label: str, count: int) -> dict[str, list[float]]:
    """Times of two stages: the first frame slow, the others 10, 11, ... and 20, 22, ...
    milliseconds.
    """
    return {
        "splat": [9.0, *(0.010 + 0.001 * index for index in range(count - 1))],
        "blend": [9.0, *(0.020 + 0.002 * index for index in range(count - 1))],
    }


def _write_records(
    run: RunFolder, shape: RunShape, protocol: Protocol, not_computed: dict[str, str]
) -> None:
    capture = {
        "path": "/home/somebody/captures/room",
        "scene": shape.scene,
        "layout": "dynerf",
        "fps": 30.0,
    }
    write_json(run.root / "capture.json", capture)
    write_json(
        run.root / "methods.json",
        {
            "labels": shape.labels,
            "names": dict(shape.names),
            "ours": LABELS[1:],
            "from_sources": shape.labels,
        },
    )
    notes = {
        name: {
            "unit": UNITS.get(name, ""),
            "higher_is_better": name in HIGHER,
            "describe": f"{name} & more.",
            "reference": "somebody",
            **{field: METRIC_NOTES[name][field] for field in ("group", "group_title", "decimals")},
        }
        for name in shape.metrics
    }
    write_json(run.root / "metrics.json", notes)
    provenance = {
        "protocol": json.loads(json.dumps(dataclasses.asdict(protocol))),
        "protocol_sha256": protocol.sha256,
        "inputs": {f"{shape.scene}/cam00": shape.content or f"frames of {shape.scene}"},
        # without its parts
        "pooling": pooling_records(shape.metrics, MetricOptions()) | {"STED": MEAN.record()},
        "versions": {"ggvs-eval": "0.1.0"},
    }
    rows = [
        row for label in shape.labels for row in _values(shape, label) if row[6] not in not_computed
    ]
    Results(make_table(rows), provenance, not_computed).write(run.root)


def _values(shape: RunShape, label: str) -> list[Sequence[object]]:
    """Made-up values of plausible size; methods later in the list are better."""
    method, _, variant = label.partition("+")
    head = (shape.dataset, shape.scene, method, variant)
    random = np.random.default_rng(shape.labels.index(label))
    good = 0.3 + 0.2 * shape.labels.index(label)
    rows: list[Sequence[object]] = []
    for name in shape.metrics:
        size = SIZES.get(name, 1.0) * (good if name in HIGHER else 1.0 - good)
        views: Sequence[str | None] = (None,) if name == "SDV" else shape.views
        frames = shape.frames.numbers
        indices = [-1] if name in PER_SEQUENCE else [*frames][1 if name == "TCC" else 0 :]
        rows += [
            (*head, view, index, name, size * (1 + 0.005 * random.standard_normal()))
            for view in views
            for index in indices
        ]
    return rows


def _painter(shape: RunShape) -> Painter:
    """A textured wall with a square that moves, and noise that is smaller the further down the list
    a method stands.
    """

    def paint(label: str, view: str, index: int) -> Image8:
        y, x = np.mgrid[: shape.height, : shape.width]
        shift = 3 * index if view == "path" else 5 * shape.views.index(view)
        image = np.stack(
            [(5 * (x + shift)) % 200, (7 * y + x) % 220, np.full_like(x, 90)], axis=-1
        ).astype(np.float64)
        at = 4 + 3 * index
        image[10:22, at : at + 12] = (230, 60, 40)
        noise = 0.0 if label == "truth" else 20.0 / (1 + shape.labels.index(label))
        return np.clip(
            image + noise * np.random.default_rng(index).standard_normal(image.shape), 0, 255
        ).astype(np.uint8)

    return paint
