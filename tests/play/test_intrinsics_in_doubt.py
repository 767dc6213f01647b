"""Cameras of a live viewer whose intrinsics are no pixels are doubted."""

from dataclasses import replace

import pytest

from ggvs_eval.errors import GgvsWarning
from ggvs_eval.pipelines.play.synthesizer import Doubts
from helpers.scenes import camera_at


@pytest.mark.parametrize("row", [0, 1])
def test_one_focal_length_that_is_no_number_of_pixels_is_enough(row):
    """A row of K that was not multiplied by the width or the height is named with the focal
    lengths.
    """
    camera = camera_at(0.0)
    K = camera.K.copy()
    K[row] /= camera.size[row]

    with pytest.warns(GgvsWarning, match="K is in pixels"):
        Doubts([replace(camera, K=K)])
