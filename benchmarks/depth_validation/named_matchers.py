"""The pipeline's options for matchers by name, and those of them that match a pair."""

from collections.abc import Mapping

from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.stereo.pairwise import StereoMatcher


def depth_options(name: str) -> DepthOptions:
    """Return the pipeline's own options with the matcher of that name.

    Raises:
        DepthError: no matcher of that name.
        WeightsError: its weights are absent or damaged.
    """
    return DepthRunOptions(name).options()


def pairwise_matchers(options: Mapping[str, DepthOptions]) -> dict[str, StereoMatcher]:
    """Return the matchers that match one rectified pair, by name.

    The plane sweep wants calibrated partners.
    """
    return {
        name: each.matcher
        for name, each in options.items()
        if isinstance(each.matcher, StereoMatcher)
    }
