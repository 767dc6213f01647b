"""The captures that tests unpack are those that the package films today."""

import numpy as np
import pytest

from ggvs_eval.datasets import open_capture
from helpers.packed_films import FILMS, FILMS_FOLDER, film_again


@pytest.mark.proof
@pytest.mark.parametrize("name", FILMS)
def test_a_packed_film_is_what_is_filmed_today(name, tmp_path):
    """Cameras and frames are the same, but for what another encoder makes of them; where not, pack
    it again.
    """
    packed, filmed = (
        open_capture(FILMS_FOLDER / name),
        open_capture(film_again(name, tmp_path / name)),
    )

    assert filmed.camera_names == packed.camera_names
    for camera, packed_camera in zip(filmed.cameras, packed.cameras, strict=True):
        np.testing.assert_array_equal(camera.K, packed_camera.K)
        np.testing.assert_array_equal(camera.world_to_camera, packed_camera.world_to_camera)
    for camera_name in filmed.camera_names:
        for image, packed_image in zip(
            filmed.frames(camera_name), packed.frames(camera_name), strict=True
        ):
            assert np.abs(image.astype(int) - packed_image).mean() < 1.0
