"""Whether sensor depth lies where its colour does: how far the edges of both are apart.

Where a near surface ends before a far one, colour has an edge too. The offset is the one under
which the edges of depth and colour correlate most.
"""

from collections.abc import Sequence

import cv2
import numpy as np

from ggvs_eval.arrays import Image8, Map, Vector
from ggvs_eval.capture import Capture
from ggvs_eval.errors import GgvsError
from ggvs_eval.finding import RIG, Finding, graded

REGISTRATION_QUESTION = "depth registration"
SEQUENCE_LAYOUT = "rgbd"  # frames of one camera and one sensor; of a rig every camera has its own
# Of images 480 pixels wide: a pixel next to an edge mixes in the other surface's colour; three show
# at arm's length.
WARN_PX, BAD_PX = 1.0, 3.0
# Enough frames and edges for a tenth of a pixel where colour is sharp, in a few seconds.
FRAMES, WIDTH_PX, FEWEST_EDGES = 16, 480, 150
# An edge is where depth changes by this share from one pixel to the next.
STEP = 0.06
# Sensors lose the pixels between two surfaces: holes up to this share of the width are the farther
# one's.
HOLE = 0.025
# Half of the largest response is a gradient of six times the image's median, and 1.5 levels of 255
# if there is none: strong edges do not outvote the others.
GRADIENT_FACTOR, LEAST_GRADIENT, SMOOTH_PX = 6.0, 1.5, 1.4
LARGEST_OFFSET_PX = 12
PEAK = 0.25  # of the range of the correlations
# Single frames off what all share, by poses, motion blur or the sensor's delay: sound ones are by a
# tenth or two, those of a room filmed by hand whose depth is a frame late by 1.8.
WARN_FRAME_PX = 1.5
FEWEST_FRAMES = 4
# A displacement is believed beyond this many pixels and standard errors of the frames' mean, and
# where edges correlate better by this much.
LEAST_PX, LEAST_ERRORS, LEAST_GAIN = 0.5, 3.0, 0.01


def check_depth_registration(capture: Capture) -> tuple[Finding, ...]:
    """Measure how far sensor depth is off its colour.

    No finding for captures without sensor depth.
    """
    if not capture.sensed_cameras:
        return ()
    if capture.layout != SEQUENCE_LAYOUT:
        return (_unknown("several cameras with a sensor each: only sequences of one are measured"),)
    try:
        agreements = _agreements(capture)
    except GgvsError as error:
        return (_unknown(f"frames cannot be read: {error}"),)
    if len(agreements) < FEWEST_FRAMES:
        return (_unknown("too few edges of depth to compare with colour"),)
    return (_finding(agreements, capture.cameras[0].width),)


def _agreements(capture: Capture) -> list[Map]:
    """Return how edges of depth correlate with those of colour at each offset, of some frames that
    have enough edges.
    """
    width, height = capture.cameras[0].size
    if width > WIDTH_PX:
        capture = capture.resized(WIDTH_PX, round(height * WIDTH_PX / width), "area")
    sensed = [name for name in capture.camera_names if name in capture.sensed_cameras]
    agreements, reach = [], LARGEST_OFFSET_PX
    for index in np.linspace(0, len(sensed) - 1, min(len(sensed), FRAMES)).round().astype(int):
        source = capture.extras_of(sensed[index]).depth
        assert source is not None
        depth = cv2.resize(
            next(iter(source.depths(0, 1))),
            capture.camera(sensed[index]).size,
            interpolation=cv2.INTER_NEAREST,
        )
        edges = depth_edges(depth)[reach:-reach, reach:-reach]
        if np.count_nonzero(edges) >= FEWEST_EDGES:
            colour = edge_response(capture.frame(sensed[index], 0))
            agreements.append(cv2.matchTemplate(colour, edges, cv2.TM_CCOEFF_NORMED))
    return agreements


def depth_edges(depth: Map) -> Map:
    """Mark the pixels of near surfaces that end before a far one, and those next to them, (H, W), 0
    or 1.

    Args:
        depth: (H, W), 0 = unknown.
    """
    hole_px = 2 * round(HOLE * depth.shape[1] / 2) + 1
    logarithm = np.log(
        np.maximum(cv2.morphologyEx(depth, cv2.MORPH_CLOSE, np.ones((hole_px, hole_px))), 1e-6)
    )
    steps = cv2.morphologyEx(logarithm.astype(np.float32), cv2.MORPH_GRADIENT, np.ones((3, 3)))
    return (steps > STEP).astype(np.float32)


def edge_response(image: Image8) -> Map:
    """Measure how much like an edge every pixel of an RGB image looks, by its Lab channels, (H, W)
    in [0, 1).
    """
    lab = cv2.cvtColor(image, cv2.COLOR_RGB2LAB).astype(np.float32)
    smooth = cv2.GaussianBlur(lab, (0, 0), SMOOTH_PX)
    slopes = (
        np.stack([cv2.Sobel(smooth, cv2.CV_32F, *order, ksize=3) for order in ((1, 0), (0, 1))]) / 8
    )
    size = np.sqrt(np.square(slopes).sum(axis=(0, 3)))
    return size / (size + GRADIENT_FACTOR * np.median(size) + LEAST_GRADIENT)


def _best_offset(agreement: Map) -> Vector:
    """Return by how much depth has to move, right and down, pixels: the middle of the peak."""
    low = agreement.max() - PEAK * np.ptp(agreement)
    height = np.maximum(agreement - low, 0)
    rows, columns = np.indices(agreement.shape) - LARGEST_OFFSET_PX
    return np.array([(height * columns).sum(), (height * rows).sum()]) / max(height.sum(), 1e-9)


def _finding(agreements: Sequence[Map], width_px: int) -> Finding:
    """Return what is found on the edges of a sequence whose frames are so wide."""
    agreement = np.mean(agreements, axis=0)
    offset = _best_offset(agreement)
    scatter_px = np.array(
        [np.linalg.norm(_best_offset(of_frame) - offset) for of_frame in agreements]
    )
    frame_px, displacement_px = np.median(scatter_px), float(np.linalg.norm(offset))
    error_px = np.sqrt(np.square(scatter_px).mean() / (len(agreements) - 1))
    gain = agreement.max() - agreement[LARGEST_OFFSET_PX, LARGEST_OFFSET_PX]
    is_off = gain > LEAST_GAIN and displacement_px > max(LEAST_PX, LEAST_ERRORS * error_px)
    lengths_px = {
        "displacement_px": displacement_px,
        "error_px": error_px,
        "frame_px": frame_px,
        "right_px": offset[0],
        "down_px": offset[1],
    }
    values = {
        name: round(float(px) * max(width_px / WIDTH_PX, 1), 3) for name, px in lengths_px.items()
    }
    text = (
        f"depth edges {values['displacement_px']:.2f} +- {values['error_px']:.2f} px off colour, "
        f"single frames {values['frame_px']:.1f} px"
    )
    verdict, advice = graded(displacement_px if is_off else 0.0, WARN_PX, BAD_PX), ""
    if verdict != "ok":
        advice = (
            f"register the depth maps to the colour camera: {values['right_px']:+.2f} px "
            f"right, {values['down_px']:+.2f} px down"
        )
    elif frame_px > WARN_FRAME_PX:
        verdict = "warn"
        advice = (
            "no common registration corrects it: poses, motion blur or the sensor's delay "
            "differ from frame to frame"
        )
    return Finding(
        subject=RIG,
        question=REGISTRATION_QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )


def _unknown(reason: str) -> Finding:
    return Finding(subject=RIG, question=REGISTRATION_QUESTION, verdict="unknown", measured=reason)
