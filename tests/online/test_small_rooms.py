"""The learned method where promises are easily broken: small pictures, cameras that see nothing,
odd units.
"""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.contrib.worlds.film.film import read_exact_depth
from ggvs_eval.datasets import open_capture
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.methods.registry import find_method
from helpers.packed_films import FILMS_FOLDER
from helpers.photographs import psnr_db
from helpers.scenes import camera_at, instant, look

METHODS = ("ours", "ours-geometric")
TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]


@cache
def score(method: str, number: int, blind: bool = False) -> float:
    """PSNR of the view of one camera from the three nearest others, and from one that looks the
    other way and is nearer.
    """
    folder = FILMS_FOLDER / "small"
    capture = open_capture(folder)
    target, truth = capture.cameras[number], capture.frame(capture.camera_names[number], 0)
    views = []
    for camera in nearest_cameras(
        target, [camera for camera in capture.cameras if camera is not target], 3
    ):
        depth = read_exact_depth(folder, camera.name, 0)
        views.append(SourceView(camera, capture.frame(camera.name, 0), depth, np.ones_like(depth)))
    if blind:
        turned = target.world_to_camera.copy()
        turned[:3] = np.diag([-1.0, 1.0, -1.0]) @ turned[:3]
        picture = np.random.default_rng(0).integers(0, 255, truth.shape, dtype=np.uint8)
        depth = np.full(truth.shape[:2], (target.near * target.far) ** 0.5, np.float32)
        views.insert(
            0,
            SourceView(
                replace(target, name="blind", world_to_camera=turned),
                picture,
                depth,
                np.ones_like(depth),
            ),
        )
    seen = Instant(0, replace(target, name="target"), tuple(views), capture.units_per_metre)
    return psnr_db(find_method(method).make().step(seen).image, truth)


def test_small_pictures_are_no_worse_than_geometric_weights():
    """At 64 x 48 the network is no worse than geometric weights in the mean of two views."""
    ours, geometric = (np.mean([score(method, number) for number in (1, 4)]) for method in METHODS)
    assert ours > geometric


@pytest.mark.parametrize("method", METHODS)
def test_a_camera_that_sees_nothing_costs_nothing(method):
    """A source nearer than all others that looks the other way costs .1 dB at most: it has no place
    among the views.
    """
    for number in (1, 4):
        assert score(method, number, blind=True) > score(method, number) - 0.1


@pytest.mark.parametrize(("method", "least_db"), list(zip(METHODS, (44, 49), strict=True)))
def test_a_source_next_to_the_target_is_shown(method, least_db):
    """Though its depth is a tenth too large: nearly as it is, where Distance-based Blending has 28
    dB.
    """
    for share in (0.0, 0.02):
        seen = instant(
            0,
            camera_at(-0.25 * share, 0.1 * share, "target"),
            [camera_at(0.0), *SOURCES[2:], camera_at(0, 0.5)],
        )
        nearest, *others = seen.sources
        wrong = replace(nearest, depth=nearest.depth * np.float32(1.1))
        image = find_method(method).make().step(replace(seen, sources=(wrong, *others))).image
        assert psnr_db(image, look(seen.target)[0]) > least_db


def scaled(seen: Instant, factor: float) -> Instant:
    """The instant in other units of length."""

    def moved(camera: Camera) -> Camera:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= factor
        return replace(
            camera, world_to_camera=pose, near=camera.near * factor, far=camera.far * factor
        )

    views = [
        replace(view, camera=moved(view.camera), depth=view.depth * np.float32(factor))
        for view in seen.sources
    ]
    return replace(
        seen,
        target=moved(seen.target),
        sources=tuple(views),
        units_per_metre=seen.units_per_metre * factor,
    )


@pytest.mark.parametrize("factor", [2.0**-30, 2.0**-20, 2.0**30])
def test_units_do_not_matter(factor):
    """Lengths in millionths or billions of a unit change no pixel by a hundredth of a level."""
    first, second = find_method("ours").make(), find_method("ours").make()
    for index in range(2):
        seen = instant(index, TARGET, SOURCES, 0.05 * index, depth_noise=0.01)
        pictures = [first.step(seen).image, second.step(scaled(seen, factor)).image]
        assert np.abs(pictures[0] - pictures[1]).max() < 0.01 / 255
