"""View interpolation: two neighbours warped towards each other by optical flow.

No depth, no learning, no scene.
"""

from collections.abc import Sequence
from itertools import combinations
from time import perf_counter

import cv2
import numpy as np

from ggvs_eval.arrays import Array, Image8, Map
from ggvs_eval.camera import Camera
from ggvs_eval.errors import ViewRefusedError
from ggvs_eval.geometry.source_views import turn_rad
from ggvs_eval.method import Instant, Rendering, SourceView

LARGEST_OFFSET = 0.2  # of the target from the line between two cameras, baselines
# of a source's viewing direction from the target's; farther off little of it is seen
LARGEST_TURN_RAD = np.pi / 4
ON_THE_LINE = 1e-9  # baselines by which a target may overshoot the segment


class ViewInterpolation:
    """The flow-warped mean of two neighbours, as frame interpolators see a row of cameras.

    Nothing is remembered.

    Reading:
        *Between*: the foot of the target's centre on the line through two sources' centres is
        between these, and the centre is at most a fifth of their baseline away from it. Neighbours
        in a row are up to 0.12 away, on real rigs and on the demo's, and cameras of other rows 0.28
        and more. Of several such pairs the nearest is taken, by the sum of distances to the target.
        A target between no two sources is refused. Both images are first turned to the target's
        direction and lens, which needs no depth. What is left is parallax: on the line, points move
        in proportion to the way. Flow at the target is the mixture of both directions' flows of
        Super SloMo (Jiang et al., CVPR 2018, equation 4); flow is OpenCV's dense inverse search
        (Kroeger et al., ECCV 2016, preset medium). The mean is weighted by nearness, and what one
        image does not reach comes from the other alone.
    """

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant.

        Raises:
            ViewRefusedError: the target is between no two of the sources.
        """
        started = perf_counter()
        first, second, share = choose_pair(
            instant.target, [source.camera for source in instant.sources]
        )
        images, masks = zip(
            *(turn_towards(instant.target, instant.sources[k]) for k in (first, second)),
            strict=True,
        )
        forward, back = flow(images[0], images[1]), flow(images[1], images[0])
        flowed = perf_counter()
        to_first = share**2 * back - (1 - share) * share * forward
        to_second = (1 - share) ** 2 * forward - share * (1 - share) * back
        warped = [
            _pull(values, to) for values, to in zip(images, (to_first, to_second), strict=True)
        ]
        weights = [
            nearness
            * np.maximum(_pull(reached, to, cv2.BORDER_CONSTANT), np.float32(1e-6))[..., None]
            for nearness, reached, to in zip(
                (1 - share, share), masks, (to_first, to_second), strict=True
            )
        ]
        image = (weights[0] * warped[0] + weights[1] * warped[1]) / (weights[0] + weights[1]) / 255
        return Rendering(
            image.astype(np.float32),
            None,
            {"flow": flowed - started, "blend": perf_counter() - flowed},
        )


def choose_pair(target: Camera, cameras: Sequence[Camera]) -> tuple[int, int, float]:
    """Return the nearest two cameras on both sides of a target.

    Returns:
        Their indices, nearest first, and how far the target is on its way from the first to the
        second, in [0, 1].

    Raises:
        ViewRefusedError: there are no such two.

    Examples:
        >>> def at(x):
        ...     world_to_camera = np.eye(4)
        ...     world_to_camera[0, 3] = -x
        ...     return Camera(
        ...         "cam",
        ...         np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]]),
        ...         world_to_camera,
        ...         8,
        ...         6,
        ...         near=1.0,
        ...         far=9.0,
        ...     )
        >>> choose_pair(at(0.25), [at(0.0), at(1.0)])
        (0, 1, 0.25)
    """
    pairs = []
    for first, second in combinations(range(len(cameras)), 2):
        a, b = cameras[first].centre, cameras[second].centre
        baseline = float(np.linalg.norm(b - a))
        if baseline < 1e-9 * target.near:
            continue
        share = float((target.centre - a) @ (b - a)) / baseline**2
        offset = float(np.linalg.norm(target.centre - a - share * (b - a))) / baseline
        turns = [turn_rad(cameras[index], target) for index in (first, second)]
        if (
            -ON_THE_LINE <= share <= 1 + ON_THE_LINE
            and offset <= LARGEST_OFFSET
            and max(turns) <= LARGEST_TURN_RAD
        ):
            distance = sum(float(np.linalg.norm(end - target.centre)) for end in (a, b))
            pairs.append((distance, first, second, min(max(share, 0.0), 1.0)))
    if not pairs:
        raise ViewRefusedError("wanted a target between two cameras, got one outside")
    _, first, second, share = min(pairs)
    return first, second, share


def turn_towards(target: Camera, source: SourceView) -> tuple[Image8, Map]:
    """Warp a source to the target's direction and lens, (H, W, 3), with its mask, 1 or 0, (H, W).

    Outside the source's image the border is repeated, so that flow finds no edge of black.
    """
    to_target = (
        target.K_opencv
        @ target.rotation
        @ source.camera.rotation.T
        @ np.linalg.inv(source.camera.K_opencv)
    )
    size = target.width, target.height
    turned = cv2.warpPerspective(
        source.image, to_target, size, flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE
    )
    mask = np.ones(source.image.shape[:2], np.float32)
    return np.asarray(turned), np.asarray(
        cv2.warpPerspective(mask, to_target, size, flags=cv2.INTER_LINEAR)
    )


def flow(first: Image8, second: Image8) -> Map:
    """Return the displacement of each pixel of an image to another, (H, W, 2).

    Reading:
        OpenCV searches in stripes, one per thread, so that the number of threads would move bits:
        here it is one.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        search = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_MEDIUM)
        grey = [cv2.cvtColor(image, cv2.COLOR_RGB2GRAY) for image in (first, second)]
        return np.asarray(search.calc(grey[0], grey[1], None))
    finally:
        cv2.setNumThreads(threads)


def _pull(values: Array, flowed: Map, outside: int = cv2.BORDER_REPLICATE) -> Map:
    """Look up values (H, W, ...) where a flow points to; those of the border, or zeros, outside."""
    rows, columns = np.mgrid[: values.shape[0], : values.shape[1]].astype(np.float32)
    places = columns + flowed[..., 0], rows + flowed[..., 1]
    sampled = cv2.remap(values.astype(np.float32), *places, cv2.INTER_LINEAR, borderMode=outside)
    return np.asarray(sampled)
