"""Warnings about a capture's depth, in words, each with a remedy."""

from collections.abc import Iterator, Sequence

import numpy as np

from ggvs_eval.reports.depth_page.pairs import PairErrors
from ggvs_eval.reports.depth_page.record import CameraRecord, DepthRecord

LEAST_MEASURED = 0.5  # of the pixels; the rest of the picture is guesswork
LEAST_CONFIDENCE = 0.3  # what `FuseOptions` and `WorkspaceOptions` ask for
MOST_ROW_PX = 1.0  # a matcher looks for a match on one row; a pixel beside it everything is blurred or missed
MOST_OUTSIDE = 0.05  # of the matches; mismatches alone stay well below
MOST_ERROR = 2.0  # times what is usual among the cameras ...
LEAST_ERROR = 8.0  # ... and not less than this, of 255 levels: sensor noise and resampling
MOST_GAIN = 1.15  # matchers mind contrast, not exposure; but a blend of the images shows it


def find_warnings(record: DepthRecord) -> list[str]:
    """One or two sentences about each thing that looks wrong, what concerns most of the capture first."""
    return [
        *_about_pairs(record.pairs),
        *(text for camera in record.cameras for text in _about_camera(camera)),
        *_about_outliers(record),
    ]


def find_notes(record: DepthRecord) -> list[str]:
    """Note facts that are not necessarily wrong but good to know."""
    notes = []
    notes += [f"{pair.camera}-{pair.partner} cannot be rectified: {pair.obstacle}." for pair in record.pairs if pair.obstacle]
    unmeasured = [f"{pair.camera}-{pair.partner}" for pair in record.pairs if not pair.matches and not pair.obstacle]
    if unmeasured:
        notes.append(
            f"Of {_listed(unmeasured)} too few features match to say whether the two are calibrated well: they look from too "
            "different places, or see little texture."
        )
    if record.unmatched:
        notes.append(f"No camera is matched with {_listed(record.unmatched)}.")
    notes += [f"Sensor depth was registered to its colour by the images: {each}." for each in record.registrations]
    return notes


def _about_pairs(pairs: Sequence[PairErrors]) -> Iterator[str]:
    measured = [pair for pair in pairs if pair.matches]
    off = sorted((pair for pair in measured if pair.row_px > MOST_ROW_PX), key=lambda pair: -pair.row_px)
    if off:
        listed = _listed([f"{pair.camera}-{pair.partner} {pair.row_px:.1f} px" for pair in off])
        yield (
            f"Matched points lie off their common row by more than {MOST_ROW_PX:g} px (median) in {len(off)} of {len(measured)} "
            f"pairs: {listed}. A camera in each is calibrated wrongly or did not film at the same instant; ggvs-eval check tells "
            "which."
        )
    outside = sorted((pair for pair in measured if pair.outside > MOST_OUTSIDE), key=lambda pair: -pair.outside)
    if outside:
        listed = _listed([f"{pair.camera}-{pair.partner} {pair.outside:.0%}" for pair in outside])
        yield (
            f"Matched points have disparities that are not looked for in {len(outside)} of {len(measured)} pairs: {listed}. The "
            "depth range of the capture is too narrow, or these cameras are calibrated wrongly."
        )


def _about_camera(camera: CameraRecord) -> Iterator[str]:
    for stored, statistics in camera.jobs:
        worst = min(statistics, key=lambda each: each.measured)
        if worst.measured < LEAST_MEASURED:
            yield (
                f"{camera.label(stored)}: only {worst.measured:.0%} of the pixels have a depth of their own at frame "
                f"{worst.frame}; {worst.filled:.0%} were filled in, {worst.empty:.0%} are empty."
            )
        elif worst.confidence < LEAST_CONFIDENCE:
            yield (
                f"{camera.label(stored)}: half of the pixels that were measured at frame {worst.frame} have a confidence below "
                f"{LEAST_CONFIDENCE:g} (median {worst.confidence:.2f}): its partners do not confirm each other."
            )
        if len(stored.job.partner_names) == 1:
            yield f"{camera.label(stored)}: matched with {stored.job.partner_names[0]} alone, so that nothing confirms its depth."
    gains = [gain for each in camera.pictures.instants if each.again for gain in each.again.gain]
    if gains:
        extreme = max(gains, key=lambda gain: abs(np.log(gain)))
        if abs(np.log(extreme)) > np.log(MOST_GAIN):
            yield (
                f"{camera.name}: its colours differ from those of {camera.pictures.again_from} by a factor of {extreme:.2f}; "
                "ggvs-eval check compares the exposures of all cameras."
            )


def _about_outliers(record: DepthRecord) -> Iterator[str]:
    """Cameras whose image, made again through their depth, is far worse than is usual here."""
    made_again = [(camera, [each.again.error for each in camera.pictures.instants if each.again]) for camera in record.cameras]
    worst = [(camera, max(errors)) for camera, errors in made_again if errors]
    usual = float(np.median([error for _, error in worst])) if worst else 0.0
    for camera, error in worst:
        if error > max(MOST_ERROR * usual, LEAST_ERROR):
            yield (
                f"{camera.name}: made again from {camera.pictures.again_from} through its depth, its image differs by "
                f"{error:.1f} of 255 levels, usual here are {usual:.1f}. Its depth is wrong, or one of the two looks different."
            )


def _listed(names: list[str] | tuple[str, ...]) -> str:
    return ", ".join(names)
