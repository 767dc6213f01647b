"""The learned method where promises are easily broken: small pictures, cameras that see nothing, odd units."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from ggvs_eval.camera import Camera, nearest_cameras
from ggvs_eval.contrib.worlds.film.film import Footage, lit_room
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.contrib.worlds.film.raycast import UNITS_PER_METRE
from ggvs_eval.contrib.worlds.film.shots import rig_shots
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.methods.registry import find_method
from helpers.photographs import psnr_db
from helpers.scenes import camera_at, instant, render_view

SMALL = DemoOptions(seed=101, width=160, height=120, n_frames=1, cameras_per_row=3, path_poses=0, noise_sigma_255=1.5)


@cache
def filmed() -> dict[Camera, tuple[np.ndarray, np.ndarray]]:
    """Picture and depth of each camera of a validation room."""
    footage = [Footage(SMALL, shot, lambda index: lit_room(SMALL.seed).at(index / SMALL.fps)) for shot in rig_shots(SMALL)]
    return {each.noted_camera(): next((frame.image, frame.depth) for frame in each.frames()) for each in footage}


@cache
def score(method: str, number: int, blind: bool = False) -> float:
    """PSNR of the view of one camera from the three nearest others, and from one that looks the other way and is nearer."""
    room = filmed()
    target = list(room)[number]
    cameras = nearest_cameras(target, [camera for camera in room if camera is not target], 3)
    views = [SourceView(camera, *room[camera], np.ones_like(room[camera][1])) for camera in cameras]
    if blind:
        turned = target.world_to_camera.copy()
        turned[:3] = np.diag([-1.0, 1.0, -1.0]) @ turned[:3]
        picture = np.random.default_rng(0).integers(0, 255, room[target][0].shape, dtype=np.uint8)
        depth = np.full_like(room[target][1], (target.near * target.far) ** 0.5)
        views.insert(0, SourceView(replace(target, name="blind", world_to_camera=turned), picture, depth, np.ones_like(depth)))
    made = find_method(method).make().step(Instant(0, replace(target, name="target"), tuple(views), UNITS_PER_METRE))
    return psnr_db(made.image, room[target][0])


def test_small_pictures_are_no_worse_than_geometric_weights():
    """At 160 x 120 the network is at most .2 dB behind geometric weights in the mean of two views."""
    ours, geometric = (np.mean([score(method, number) for number in (1, 4)]) for method in ("ours", "ours-geometric"))
    assert ours > geometric - 0.2


@pytest.mark.parametrize("method", ["ours", "ours-geometric"])
def test_a_camera_that_sees_nothing_costs_nothing(method):
    """A source nearer than all others that looks the other way costs .1 dB at most: it has no place among the views."""
    for number in (1, 4):
        assert score(method, number, blind=True) > score(method, number) - 0.1


def near_source(share: float) -> tuple[Instant, np.ndarray]:
    """A target on the way from its nearest source, whose depth is a tenth too large, and what it sees; the source at share 0."""
    room = filmed()
    wanted, *cameras = list(room)[1], *nearest_cameras(list(room)[1], list(room), 4)
    views = [SourceView(camera, *room[camera], np.ones_like(room[camera][1])) for camera in cameras]
    views[0] = replace(views[0], depth=views[0].depth * np.float32(1.1))
    pose, centre = cameras[0].world_to_camera.copy(), (1 - share) * cameras[0].centre + share * wanted.centre
    pose[:3, 3] = -pose[:3, :3] @ centre
    target = replace(cameras[0], name="target", world_to_camera=pose) if share else replace(cameras[0], name="target")
    truth = render_view(lit_room(SMALL.seed).at(0.0), target)[0] if share else views[0].image
    return Instant(0, target, tuple(views), UNITS_PER_METRE), truth


@pytest.mark.slow
@pytest.mark.parametrize("method", ["ours", "ours-geometric"])
def test_a_source_next_to_the_target_is_shown(method):
    """Whatever its depth: the source itself at its own place, next to it no worse than Distance-based Blending by .1 dB."""
    scores = []
    for share in (0.0, 0.02, 0.1, 0.3):
        seen, truth = near_source(share)
        made = [find_method(each).make().step(seen).image for each in (method, "distance-based")]
        scores.append([psnr_db(image, truth) for image in made])
    assert scores[0][0] > (38 if method == "ours" else 55)
    assert all(ours > theirs - 0.1 for ours, theirs in scores)


def scaled(seen: Instant, factor: float) -> Instant:
    """The instant in other units of length."""

    def moved(camera: Camera) -> Camera:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= factor
        return replace(camera, world_to_camera=pose, near=camera.near * factor, far=camera.far * factor)

    views = [replace(view, camera=moved(view.camera), depth=view.depth * np.float32(factor)) for view in seen.sources]
    return replace(seen, target=moved(seen.target), sources=tuple(views), units_per_metre=seen.units_per_metre * factor)


@pytest.mark.parametrize("factor", [2.0**-30, 2.0**-20, 2.0**30])
def test_units_do_not_matter(factor):
    """Lengths in millionths or billions of a unit change no pixel by a hundredth of a level."""
    target, sources = camera_at(0.0, name="target"), [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]
    first, second = find_method("ours").make(), find_method("ours").make()
    for index in range(2):
        seen = instant(index, target, sources, 0.05 * index, depth_noise=0.01)
        pictures = [first.step(seen).image, second.step(scaled(seen, factor)).image]
        assert np.abs(pictures[0] - pictures[1]).max() < 0.01 / 255
