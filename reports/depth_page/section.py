"""The depth page, also as a sheet of a report: depth, confidence, rectified pairs, and warnings.

::

    FOLDER/index.html          the page; it loads nothing but its pictures
    FOLDER/index.json          the numbers on it
    FOLDER/pictures/*.jpg
"""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Executor
from dataclasses import asdict
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval import colour_maps
from ggvs_eval.arrays import Array
from ggvs_eval.camera import nearest_cameras
from ggvs_eval.capture import Capture
from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.geometry.epipolar import Features, find_features
from ggvs_eval.jobs.processes import finish_all, worker_pool
from ggvs_eval.reports.depth_page.pairs import PairErrors, measure_pair
from ggvs_eval.reports.depth_page.record import (
    CameraPictures,
    CameraRecord,
    DepthRecord,
    DepthStatistics,
    StoredDepth,
    describe_map,
    write_instant,
    write_pairs,
)
from ggvs_eval.reports.page.page import fill_page
from ggvs_eval.reports.section import Report, SectionContent
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import Task

LEAST_MEASURED = 0.5  # of the pixels; the rest of the picture is guesswork
LEAST_CONFIDENCE = 0.3  # below it `ggvs-eval prepare` fuses and exports nothing
MOST_ROW_PX = 1.0  # a matcher searches one row; a pixel off it everything is blurred or missed
MOST_OUTSIDE = 0.05  # of the matches; mismatches alone stay well below
MOST_ERROR = 2.0  # times what is usual among the cameras ...
LEAST_ERROR = 8.0  # ... and not less than this, of 255 levels: sensor noise and resampling
MOST_GAIN = 1.15  # matchers mind contrast, not exposure; but a blend of the images shows it
FOLDER, RECORD, PICTURES = "depth_page", "index.json", "pictures"
FLATTEST = 1.05  # far over near of the colours, so that noise on a wall does not fill them
Statistics = tuple[DepthStatistics, ...]
Pairs = dict[tuple[str, str], tuple[PairErrors, Array]]


def write_depth_page(
    folder: Path,
    capture: Capture,
    stored: Sequence[StoredDepth],
    store: DepthStore,
    filled_confidence: float,
    workers: int = 1,
) -> Path:
    """Write the page; a complete one of the same depth is left as it is.

    Args:
        capture: the capture that the depth was computed from, at that size.
        stored: what to show; cameras may be in it several times, matched with other partners.
        workers: processes; the page does not depend on it.
    """
    if not stored:
        raise DepthError(
            f"{folder}: wanted depth to show, got none; prepare a capture with at least one test "
            f"view"
        )
    inputs = {
        "code": code_of(__name__),
        "scene": [
            capture.scene,
            capture.units_per_metre,
            capture.units_origin,
            capture.camera_names,
        ],
        "depth": [asdict(maps) for maps in stored],
        "filled_confidence": filled_confidence,
    }

    def write(temporary: Path) -> dict[str, Any]:
        with worker_pool(min(workers, len(stored))) as pool:
            record = examine_depth(
                pool, temporary / PICTURES, capture, stored, store, filled_confidence
            )
        summary = summarise(record)
        write_text(temporary / "index.html", render_depth_page(summary))
        write_json(temporary / RECORD, summary)
        return {}

    task = Task("depth page", folder, inputs=inputs, make=write)
    if not task.is_done():
        task.run()
    return folder / "index.html"


def summarise(record: DepthRecord) -> dict[str, Any]:
    """Return what the page shows and the file next to it says: the record, and what looks wrong in
    it.
    """
    return {"warnings": find_warnings(record), "notes": find_notes(record), **asdict(record)}


def render_depth_page(summary: Mapping[str, Any]) -> str:
    """Return the page of a record, see `summarise`; equal records give equal text."""
    return fill_page(summary["scene"], [_sheet(summary, "depth", "Depth", PICTURES)], refers=True)


def depth_section(report: Report) -> SectionContent:
    """Return a sheet for each run with a depth page.

    With pictures if the report can name the run's folder.
    """
    sheets = []
    for key, run in report.runs.items():
        record = run.folder.root / FOLDER / RECORD
        if record.is_file():
            address = report.data(key).get("full")
            pictures = f"{address}/{FOLDER}/{PICTURES}" if address else ""
            title = "Depth" if len(report.runs) == 1 else f"Depth of {run.title}"
            sheets.append(_sheet(read_json(record), f"depth-{key}", title, pictures))
    return SectionContent(sheets=sheets)


def _sheet(summary: Mapping[str, Any], place: str, title: str, pictures: str) -> dict[str, Any]:
    """What the template reads: the record, and the folder of its pictures, empty if they are
    elsewhere.
    """
    sheet = {"id": place, "title": title, "comes_first": False, "template": "depth"}
    return {**summary, **sheet, "pictures": pictures, "scales": colour_maps}


def examine_depth(
    pool: Executor,
    folder: Path,
    capture: Capture,
    stored: Sequence[StoredDepth],
    store: DepthStore,
    filled_confidence: float,
) -> DepthRecord:
    """Evaluate depth maps and pairs and write the pictures, in three rounds: statistics and
    features, pairs, pictures.

    Args:
        capture: as in `write_depth_page`, and so is the rest.
        filled_confidence: of filled pixels.
    """
    describe = partial(_describe, store, filled_confidence)
    statistics: list[Statistics] = _in_pool(pool, describe, zip(stored), "judging depth maps")
    pairs = _measure_pairs(pool, capture, stored)
    jobs = list(zip(stored, statistics, strict=True))
    cameras = []
    pictured: list[tuple[Any, ...]] = []
    for name in capture.camera_names:
        of_camera = tuple(job for job in jobs if job[0].job.camera_name == name)
        if of_camera:
            cameras.append((name, of_camera))
            worst, maps = min(of_camera, key=lambda job: job[1][0].measured)
            pictured.append((f"c{len(pictured):02d}", worst, maps, _matches_of(worst, pairs)))
    draw = partial(_draw, folder, capture, store, filled_confidence)
    pictures = iter(_in_pool(pool, draw, pictured, "pictures of the depth"))
    matched = {partner for maps in stored for partner in maps.job.partner_names}
    return DepthRecord(
        scene=capture.scene,
        units_per_metre=capture.units_per_metre,
        units_origin=capture.units_origin,
        cameras=tuple(CameraRecord(*camera, next(pictures)) for camera in cameras),
        pairs=tuple(pair for pair, _ in pairs.values()),
        unmatched=tuple(name for name in capture.camera_names if name not in matched),
    )


def _in_pool(
    pool: Executor, work: Callable[..., Any], items: Iterable[tuple[Any, ...]], doing: str
) -> list[Any]:
    running = [pool.submit(work, *item) for item in items]
    finish_all(pool, running, doing)
    return [future.result() for future in running]


def _measure_pairs(pool: Executor, capture: Capture, stored: Sequence[StoredDepth]) -> Pairs:
    """Return the errors and matches of every pair, once, whichever of the two the depth was
    computed of.
    """
    frame_of: dict[tuple[str, str], int] = {}
    for maps in stored:
        for partner in maps.job.partner_names:
            if (partner, maps.job.camera_name) not in frame_of:
                frame_of.setdefault((maps.job.camera_name, partner), maps.frames[0])
    instants = sorted({(name, frame) for pair, frame in frame_of.items() for name in pair})
    find = partial(_find, capture)
    features = dict(zip(instants, _in_pool(pool, find, instants, "features"), strict=True))
    items = []
    for names, frame in frame_of.items():
        items.append((*map(capture.camera, names), *(features[name, frame] for name in names)))
    errors = _in_pool(pool, measure_pair, items, "matching features")
    return dict(zip(frame_of, errors, strict=True))


def _describe(store: DepthStore, filled_confidence: float, stored: StoredDepth) -> Statistics:
    statistics = []
    for frame in stored.frames:
        statistics.append(describe_map(frame, store.read(stored.job.key, frame), filled_confidence))
    return tuple(statistics)


def _find(capture: Capture, name: str, frame: int) -> Features:
    return find_features(capture.frame(name, frame))


def _draw(
    folder: Path,
    capture: Capture,
    store: DepthStore,
    filled_confidence: float,
    stem: str,
    stored: StoredDepth,
    statistics: Statistics,
    matches: dict[str, Array],
) -> CameraPictures:
    camera = capture.camera(stored.job.camera_name)
    partners = [capture.camera(name) for name in stored.job.partner_names]
    nearest = nearest_cameras(camera, partners, 1)[0] if partners else None
    depth_range = _depth_range(statistics, camera.near, camera.far)
    instants = []
    for frame in stored.frames:
        image, depth_map = capture.frame(camera.name, frame), store.read(stored.job.key, frame)
        partner = (nearest, capture.frame(nearest.name, frame)) if nearest else None
        instants.append(
            write_instant(
                folder,
                stem,
                frame,
                camera,
                image,
                depth_map,
                depth_range,
                filled_confidence,
                partner,
            )
        )
    first = stored.frames[0]
    images = [
        (partner, capture.frame(partner.name, first))
        for partner in partners
        if partner.name in matches
    ]
    rectified = write_pairs(
        folder, stem, camera, capture.frame(camera.name, first), images, matches
    )
    again_from = nearest.name if nearest else ""
    return CameraPictures(
        partners=stored.job.partner_names,
        depth_range=depth_range,
        again_from=again_from,
        instants=tuple(instants),
        pairs=rectified,
    )


def _matches_of(stored: StoredDepth, pairs: Pairs) -> dict[str, Array]:
    """Partners that the camera can be rectified with -> matched pixels of the camera and of it, (M,
    2, 2).
    """
    name, matches = stored.job.camera_name, {}
    for partner in stored.job.partner_names:
        is_first = (name, partner) in pairs  # whichever of the two was measured first
        errors, uv = pairs[name, partner] if is_first else pairs[partner, name]
        if not errors.obstacle:
            matches[partner] = uv if is_first else uv[:, ::-1]
    return matches


def _depth_range(statistics: Statistics, near: float, far: float) -> tuple[float, float]:
    """Return the depth range of the colours, the same for all instants, so that they can be
    compared.
    """
    of_maps = [of_map for of_map in statistics if of_map.measured]
    nearest = min((of_map.near for of_map in of_maps), default=near)
    farthest = max((of_map.far for of_map in of_maps), default=far)
    spread = max(FLATTEST / (farthest / nearest), 1.0) ** 0.5
    return nearest / spread, farthest * spread


def find_warnings(record: DepthRecord) -> list[str]:
    """Return one or two sentences about each thing that looks wrong, what concerns most of the
    capture first.
    """
    return [
        *_about_pairs(record.pairs),
        *(text for camera in record.cameras for text in _about_camera(camera)),
        *_about_outliers(record),
    ]


def find_notes(record: DepthRecord) -> list[str]:
    """Note facts that are not necessarily wrong but good to know."""
    rejected = [pair for pair in record.pairs if pair.obstacle]
    notes = [
        f"{pair.camera}-{pair.partner} cannot be rectified: {pair.obstacle}." for pair in rejected
    ]
    unmeasured = [
        f"{pair.camera}-{pair.partner}"
        for pair in record.pairs
        if not pair.matches and not pair.obstacle
    ]
    if unmeasured:
        notes.append(
            f"Of {', '.join(unmeasured)} too few features match to say whether the two are "
            "calibrated well: they look from too different places, or see little texture."
        )
    if record.unmatched:
        notes.append(f"No camera is matched with {', '.join(record.unmatched)}.")
    return notes


def _about_pairs(pairs: Sequence[PairErrors]) -> Iterator[str]:
    matched = [pair for pair in pairs if pair.matches]
    off = sorted(
        (pair for pair in matched if pair.row_px > MOST_ROW_PX), key=lambda pair: -pair.row_px
    )
    if off:
        listed = ", ".join(f"{pair.camera}-{pair.partner} {pair.row_px:.1f} px" for pair in off)
        yield (
            f"Matched points are off their common row by more than {MOST_ROW_PX:g} px (median) in "
            f"{len(off)} of {len(matched)} pairs: {listed}. A camera in each is calibrated wrongly "
            "or did not film at the same instant; ggvs-eval check shows which."
        )
    outside = sorted(
        (pair for pair in matched if pair.outside > MOST_OUTSIDE), key=lambda pair: -pair.outside
    )
    if outside:
        listed = ", ".join(f"{pair.camera}-{pair.partner} {pair.outside:.0%}" for pair in outside)
        yield (
            f"Matched points have disparities that are not looked for in {len(outside)} of "
            f"{len(matched)} pairs: {listed}. The depth range of the capture is too narrow, or "
            "these cameras are calibrated wrongly."
        )


def _about_camera(camera: CameraRecord) -> Iterator[str]:
    for stored, statistics in camera.jobs:
        worst = min(statistics, key=lambda of_map: of_map.measured)
        if worst.measured < LEAST_MEASURED:
            yield (
                f"{camera.label(stored)}: only {worst.measured:.0%} of the pixels have a measured "
                f"depth at frame {worst.frame}; {worst.filled:.0%} were filled in, "
                f"{worst.empty:.0%} are empty."
            )
        elif worst.confidence < LEAST_CONFIDENCE:
            yield (
                f"{camera.label(stored)}: half of the pixels that were measured at frame "
                f"{worst.frame} have a confidence below {LEAST_CONFIDENCE:g} (median "
                f"{worst.confidence:.2f}): its partners do not confirm each other."
            )
        if len(stored.job.partner_names) == 1:
            yield (
                f"{camera.label(stored)}: matched with {stored.job.partner_names[0]} alone, so "
                f"that nothing confirms its depth."
            )
    pictured = [instant.again for instant in camera.pictures.instants if instant.again]
    gains = [gain for again in pictured for gain in again.gain]
    extreme = max(gains, key=lambda gain: abs(np.log(gain)), default=1.0)
    if abs(np.log(extreme)) > np.log(MOST_GAIN):
        yield (
            f"{camera.name}: its colours differ from those of {camera.pictures.again_from} by a "
            f"factor of {extreme:.2f}; ggvs-eval check compares the exposures of all cameras."
        )


def _about_outliers(record: DepthRecord) -> Iterator[str]:
    """Yield the cameras whose image, made again through their depth, is far worse than is usual
    here.
    """
    worst = []
    for camera in record.cameras:
        errors = [instant.again.error for instant in camera.pictures.instants if instant.again]
        if errors:
            worst.append((camera, max(errors)))
    usual = float(np.median([error for _, error in worst])) if worst else 0.0
    for camera, error in worst:
        if error > max(MOST_ERROR * usual, LEAST_ERROR):
            yield (
                f"{camera.name}: made again from {camera.pictures.again_from} through its depth, "
                f"its image differs by {error:.1f} of 255 levels, usual here are {usual:.1f}. Its "
                "depth is wrong, or one of the two looks different."
            )
