"""Dataset adapters: `open_capture` returns a `Capture` from any supported layout."""

import os
from collections.abc import Callable, Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path

from ggvs_eval import built_in
from ggvs_eval.capture import Capture, GivenDepth
from ggvs_eval.datasets.assemble import apply_known_traps
from ggvs_eval.datasets.corrections import apply_corrections, corrections_file, read_corrections
from ggvs_eval.datasets.depth_range import settle_depth_ranges
from ggvs_eval.datasets.layout import DatasetSpec
from ggvs_eval.datasets.public_captures import locate
from ggvs_eval.datasets.units import GivenUnits
from ggvs_eval.datasets.unread_files import unused_note
from ggvs_eval.errors import CaptureError, GgvsError, did_you_mean, no_such_path
from ggvs_eval.files.listing import list_entries
from ggvs_eval.files.plain import watch_reads
from ggvs_eval.plugins import Registry, foreign


def _checked(name: str, spec: object) -> DatasetSpec:
    if not isinstance(spec, DatasetSpec):
        raise TypeError(f"wanted a DatasetSpec, got {type(spec).__name__}")
    return replace(
        spec, refuse=partial(_refused, name, spec.refuse), load=partial(_loaded, name, spec.load)
    )


def _refused(name: str, refuse: Callable[[Path], str | None], path: Path) -> str | None:
    """Return the reason why a path is not of a plug-in's layout, including that it cannot
    decide.
    """
    try:
        with foreign(f"layout {name}: failed"):
            refusal = refuse(path)
            if not isinstance(refusal, str | None):
                raise TypeError(f"wanted a reason or None, got {type(refusal).__name__}")
            return refusal
    except GgvsError as error:
        return str(error)


def _loaded(
    name: str, load: Callable[[Path, GivenUnits], Capture], path: Path, units: GivenUnits
) -> Capture:
    with foreign(f"layout {name}: {path} cannot be opened", CaptureError):
        capture = load(path, units)
        if not isinstance(capture, Capture):
            raise TypeError(f"wanted a Capture, got {type(capture).__name__}")
        return capture


DEPTH_FILES: Registry[Callable[[Capture, GivenDepth], Capture]] = Registry(
    "depth files", built_in.DEPTH_FILES
)
REFUSALS: Registry[Callable[[Path, Mapping[str, str]], str]] = Registry(
    "refusals", built_in.REFUSALS
)
# in the order in which they are tried
DATASETS: Registry[DatasetSpec] = Registry("datasets", built_in.DATASETS, _checked)


def open_capture(
    path: str | Path,
    layout: str | None = None,
    *,
    units: GivenUnits = None,
    drop_unsynced: bool = True,
    measure_depth: bool = True,
) -> Capture:
    """Open a capture.

    Args:
        path: folder of one scene, or the file of one (``scene000.h5``); or ``DATASET:SCENE`` of a
            public capture that `ggvs_eval.datasets.public_captures.get_capture` has fetched.
        layout: a name in `DATASETS`; the first that fits when None.
        units: world units per metre where the user knows better than the capture, or a TOML file
            that says how to measure them; see `ggvs_eval.datasets.units.choose_units`.
        drop_unsynced: leave out cameras known to be out of step: cam13 of coffee_martini.
        measure_depth: measure depth ranges that the capture does not give, which takes a second or
            some; without, they are guessed from where its cameras look.

    Raises:
        CaptureError: nothing there, no layout that fits (with the reason of each), or a capture
            that is damaged.

    Reading:
        What ``corrections.toml`` in the capture says is done to its frames, see
        `ggvs_eval.datasets.corrections`. What is known to be wrong with a public scene becomes a
        note, see `ggvs_eval.datasets.assemble`. Near and far of its cameras are settled by
        `ggvs_eval.datasets.depth_range.settle_depth_ranges`.

    Examples:
        >>> import json, tempfile
        >>> import numpy as np
        >>> from ggvs_eval.files.images import write_image
        >>> transforms = {"fl_x": 8, "fl_y": 8, "cx": 4, "cy": 3, "w": 8, "h": 6, "frames": []}
        >>> with tempfile.TemporaryDirectory() as folder:
        ...     for i in range(2):
        ...         pose = {
        ...             "file_path": f"images/cam{i}.png",
        ...             "transform_matrix": (np.eye(4) + i * np.eye(4, k=3)).tolist(),
        ...         }
        ...         transforms["frames"].append(pose)
        ...         write_image(Path(folder) / pose["file_path"], np.full((6, 8, 3), i, np.uint8))
        ...     _ = (Path(folder) / "transforms.json").write_text(json.dumps(transforms))
        ...     capture = open_capture(folder)
        ...     capture.layout, capture.camera_names, capture.frame("cam1", 0).shape
        ('nerfstudio', ('cam0', 'cam1'), (6, 8, 3))
    """
    path = locate(Path(path))
    if not path.exists():
        raise CaptureError(no_such_path(path, "a folder with a capture"))
    if path.is_dir() and not list_entries(path):
        raise CaptureError(
            f"{path}: wanted a capture, got an empty folder; add frames and poses, or try "
            f"'ggvs-eval demo'"
        )
    spec = DATASETS[detect_layout(path, layout)]
    with watch_reads() as files_read:
        capture = spec.load(path, units)
        corrections = corrections_file(path)
        capture = apply_corrections(capture, read_corrections(corrections), corrections)
        files_read |= {os.path.abspath(file) for mark in spec.marks for file in path.glob(mark)}
    capture = replace(
        capture, notes=(*capture.notes, *unused_note(path, files_read, capture.notes))
    )
    return settle_depth_ranges(apply_known_traps(capture, leave_out=drop_unsynced), measure_depth)


def detect_layout(path: Path, layout: str | None = None) -> str:
    """Return the layout of a capture.

    Args:
        layout: the only one to consider; all when None.
    """
    if layout is not None and layout not in DATASETS:
        layouts = ", ".join(DATASETS)
        raise CaptureError(
            f"{path}: wanted a layout of {layouts}, got {layout!r}{did_you_mean(layout, DATASETS)}"
        )
    candidates = DATASETS.working() if layout is None else [(layout, DATASETS[layout])]
    refusals: dict[str, str] = {}
    for name, spec in candidates:
        refusal = spec.refuse(path)
        if refusal is None:
            return name
        refusals[name] = refusal
    raise CaptureError(REFUSALS["capture"](path, refusals))
