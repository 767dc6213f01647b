"""Depth as the online part gets it: held against that of other cameras, and guessed where nobody knows any."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.pipelines.offline.depth.consistency import check_consistency
from ggvs_eval.pipelines.offline.stereo.fusion import fill_background

if TYPE_CHECKING:
    from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions


def check_depth(
    camera: Camera, depth_map: DepthMap, others: Sequence[tuple[Camera, DepthMap]], options: "DepthOptions"
) -> DepthMap:
    """Hold a camera's depth against that of the other sources of a view, and fill the rest from the background.

    Args:
        camera: the camera of the depth map.
        depth_map: depth and confidence as they were found, (H, W).
        others: other cameras with theirs, as they were found too.
        options: parameters.

    Returns:
        Depth and confidence, (H, W); those that were given where `options` want no consistency.

    Raises:
        DepthError: a depth map that does not fit its camera.
    """
    if options.consistency is None:
        return depth_map
    checked = check_consistency(camera, depth_map, others, options.consistency)
    return DepthMap(*fill_background(checked.depth, checked.confidence, options.filled_confidence))
