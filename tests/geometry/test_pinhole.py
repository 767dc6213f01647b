"""Cameras for the kernels: one with more pixels than they count is refused by name."""

import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.pipelines.methods.registry import find_method
from helpers.refusals import refused
from helpers.scenes import camera_at, instant


@pytest.mark.parametrize("method", ["ours-geometric", "no-blending", "distance-based"])
@pytest.mark.parametrize("widths", [(40, 65536), (65536, 40)])
def test_a_camera_beyond_the_kernels_is_refused(method, widths):
    """65,536 pixels across, of the target or of a source: one line that names the camera and says
    what to do.
    """
    target, source = (
        camera_at(x, name=name, width=width, height=8)
        for x, name, width in zip((0, 0.1), "ts", widths, strict=True)
    )
    with refused(RenderError, "camera", "65535 pixels a side, got 65536 x 8", "Camera.resized"):
        find_method(method).make().step(instant(0, target, [source]))
