"""All evaluates of depth, each on the input that is there; what is absent is named."""

from collections.abc import Collection, Mapping, Sequence
from pathlib import Path

import pandas as pd

from benchmarks.depth_validation import (
    middlebury,
    region_errors,
    rendering,
    sparse_points,
    static_reuse,
    temporal_spread,
)
from benchmarks.depth_validation.figures import Figures
from benchmarks.depth_validation.named_matchers import depth_options, pairwise_matchers
from benchmarks.depth_validation.rooms import film_rooms
from ggvs_eval.datasets import open_capture
from ggvs_eval.errors import DepthError
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.protocol import load_protocol
from ggvs_eval.run_folder import read_json, write_json

PARTS = ("motorcycle", "sparse", "rendering", "rooms", "temporal", "reuse")
REAL_CAPTURE = "n3v_flame_steak"


def validate_depth(
    data: Path, out: Path, matchers: Sequence[str], only: Collection[str] = PARTS
) -> Figures:
    """Evaluate matchers in every way whose input is there.

    Prints the tables and keeps them below `out`.

    Args:
        data: folder with stereo_motorcycle and n3v_flame_steak.
        out: folder of the rooms and of depth_validation/, which gets a table per part and
            figures.json; figures that this call does not compute stay there.
        matchers: names, as `depth_options` knows them.
        only: some of `PARTS`.

    Returns:
        The figures, as `make validate` writes them.

    Raises:
        DepthError: an unknown part or matcher, or no matcher.
    """
    unknown = sorted(set(only) - set(PARTS))
    if unknown or not matchers:
        request = f"parts {', '.join(unknown)}" if unknown else "no matcher"
        raise DepthError(
            f"depth validation: wanted a matcher and parts of {', '.join(PARTS)}, got {request}; "
            f"correct the name"
        )
    options = {name: depth_options(name) for name in dict.fromkeys(matchers)}
    figures: Figures = {}
    if "motorcycle" in only:
        figures |= _motorcycle(data / middlebury.FOLDER, out, options)
    if "sparse" in only:
        figures |= _sparse(data / REAL_CAPTURE, out, options)
    if "rendering" in only:
        figures |= _rendering(data / REAL_CAPTURE, out, list(options))
    of_rooms = {
        "rooms": region_errors.evaluate_rooms,
        "temporal": temporal_spread.evaluate_temporal,
        "reuse": static_reuse.evaluate_reuse,
    }
    if of_rooms.keys() & set(only):
        rooms = film_rooms(out)
        for part, evaluate in of_rooms.items():
            if part in only:
                table, found_figures = evaluate(rooms, options)
                _show(table, out, part)
                figures |= found_figures
    path = out / "depth_validation" / "figures.json"
    write_json(path, (read_json(path) if path.is_file() else {}) | figures)
    return figures


def _motorcycle(folder: Path, out: Path, options: Mapping[str, DepthOptions]) -> Figures:
    if not folder.is_dir():
        print(f"motorcycle: not computed: no pair at {folder}; give --data")
        return {}
    matchers = pairwise_matchers(options)
    for name in options:
        if name not in matchers:
            print(
                f"motorcycle: {name} is not computed: it wants several calibrated partners, this "
                f"is one pair"
            )
    rows, figures = middlebury.evaluate_motorcycle(folder, matchers)
    _show(pd.DataFrame.from_dict(rows, orient="index"), out, "motorcycle")
    return figures


def _sparse(folder: Path, out: Path, options: Mapping[str, DepthOptions]) -> Figures:
    if not folder.is_dir():
        print(f"sparse points: not computed: no capture at {folder}; give --data")
        return {}
    capture = open_capture(folder)
    width, height = capture.cameras[0].size
    table, figures = sparse_points.evaluate_sparse(
        capture.resized(width // 2, height // 2, "lanczos"), options
    )
    _show(pd.concat([table, table.mean().to_frame("mean").T]), out, "sparse")
    return figures


def _rendering(folder: Path, out: Path, matchers: Sequence[str]) -> Figures:
    if not folder.is_dir():
        print(f"rendering: not computed: no capture at {folder}; give --data")
        return {}
    table, figures = rendering.evaluate_rendering(
        open_capture(folder),
        load_protocol("real_frame"),
        out / "depth_rendering",
        matchers,
        usable_cpus(),
    )
    _show(table, out, "rendering")
    return figures


def _show(table: pd.DataFrame, out: Path, part: str) -> None:
    path = out / "depth_validation" / f"{part}.csv"
    path.parent.mkdir(parents=True, exist_ok=True)
    table.to_csv(path)
    print(f"\n{part}\n{table.round(3).to_string()}")
