"""Clouds of finished fits: what is exported of them is what they render."""

import numpy as np
import pytest
import torch

from ggvs_eval.baselines.fitted.clouds import FittedClouds
from ggvs_eval.baselines.fitted.four_d import FourD
from ggvs_eval.baselines.fitted.per_instant import PerInstant
from ggvs_eval.baselines.fitted.stream import Stream
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import render_gaussians
from ggvs_eval.method import NEAR_M
from ggvs_eval.run_folder import JOB_FILE
from helpers.fitted_footage import footage_of, rig, wall
from helpers.refusals import refused

SHORT = {"steps": 24, "points": 200, "most": 250}
FITTERS = {
    "3dgs-per-instant": PerInstant(**SHORT),
    "4dgs": FourD(**SHORT),
    "4dgs+motion=linear": FourD(motion="linear", **SHORT),
    "3dgstream": Stream(transforming=10, spawning=8, spawned=10, **SHORT),
}


@pytest.fixture(scope="module")
def footage(tmp_path_factory):
    cloud = wall()
    return footage_of(lambda _: cloud, tmp_path_factory.mktemp("still"), instants=3)


@pytest.mark.slow
@pytest.mark.parametrize("label", FITTERS)
def test_clouds_are_those_of_the_renders(label, footage, tmp_path):
    """Every instant of every fitter, asked for in any order; a fit that is not finished is
    refused.
    """
    fitter = FITTERS[label]
    fitter.fit(footage, tmp_path, lambda done, steps: None)
    with refused(RenderError, str(tmp_path), "finished fit"):
        FittedClouds(tmp_path)
    (tmp_path / JOB_FILE).write_text("{}")
    scene, clouds, camera = fitter.load(tmp_path), FittedClouds(tmp_path), rig()[2]

    assert list(clouds.instants) == list(footage.indices)
    for index in (2, 0, 1):
        with torch.no_grad():
            picture = render_gaussians(
                clouds.cloud(index), camera, near=NEAR_M * footage.units_per_metre
            )
        assert np.array_equal(picture.image.clamp(max=1).numpy(), scene.render(index, camera).image)
