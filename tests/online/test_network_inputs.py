"""The blending network's input: order, closed forms before a plane, laws, pixels that
nobody knows.
"""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.training.samples.sample_kinds import raw_views
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.splat import splat
from ggvs_eval.pipelines.online.blending import BlendingInputs
from ggvs_eval.pipelines.online.network_inputs import (
    FAINT,
    BlendMaps,
    blend_maps,
    channel_count,
    input_channels,
    reference_depth,
    surface_normals,
    surface_points,
)
from helpers.refusals import refused
from helpers.scenes import HEIGHT, WALL_Z, WIDTH, camera_at, instant, look

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(0.15), camera_at(-0.3), camera_at(0.45)]
K = len(SOURCES)
GROUPS = {
    "colours": 3 * K,
    "depths": K,
    "alphas": K,
    "fused": 1,
    "normal": K,
    "target": K,
    "distance": K,
    "axis": K,
}


def plane_maps(depth: float = WALL_Z) -> BlendMaps:
    """Three views of a plane at one depth, with colours, depths and coverages that tell the
    view.
    """
    shape = (K, HEIGHT, WIDTH)
    number = np.arange(K, dtype=np.float32)[:, None, None]
    return BlendMaps(
        target=TARGET,
        sources=tuple(SOURCES),
        colours=np.random.default_rng(0).uniform(size=(*shape, 3)).astype(np.float32),
        depths=np.broadcast_to(depth + 0.1 * number, shape).astype(np.float32),
        coverage=np.broadcast_to(0.6 + 0.1 * number, shape).astype(np.float32),
        visibilities=np.broadcast_to(0.5 + 0.1 * number, shape).astype(np.float32),
        alphas=np.broadcast_to(0.6 + 0.1 * number, shape).astype(np.float32),
        fused_depth=np.full(shape[1:], depth, np.float32),
    )


def grouped(channels: np.ndarray) -> dict[str, np.ndarray]:
    """The channels by the name of their group."""
    parts = np.split(channels, np.cumsum(list(GROUPS.values()))[:-1])
    return dict(zip(GROUPS, parts, strict=True))


def test_a_plane_in_closed_form():
    """Before a plane parallel to the image every channel is what paper and pencil say, in the
    paper's order.
    """
    maps = plane_maps()
    found = grouped(input_channels(maps, "channels"))
    points = TARGET.unproject(TARGET.pixel_centres(), maps.fused_depth.astype(np.float64))
    distance = np.linalg.norm(points, axis=-1)
    for k, source in enumerate(SOURCES):
        towards = source.centre - points
        length = np.linalg.norm(towards, axis=-1)
        np.testing.assert_array_equal(
            found["colours"][3 * k : 3 * k + 3], np.moveaxis(maps.colours[k], -1, 0)
        )
        np.testing.assert_allclose(found["depths"][k], WALL_Z / (WALL_Z + 0.1 * k), rtol=1e-6)
        np.testing.assert_allclose(found["alphas"][k], 0.6 + 0.1 * k, rtol=1e-6)
        np.testing.assert_allclose(found["normal"][k], WALL_Z / length, atol=2e-5)
        np.testing.assert_allclose(
            found["target"][k], (towards * -points).sum(-1) / (length * distance), atol=1e-6
        )
        np.testing.assert_allclose(found["distance"][k], abs(source.centre[0]) / WALL_Z, rtol=1e-6)
        np.testing.assert_allclose(found["axis"][k], 1.0, rtol=1e-6)
    np.testing.assert_allclose(found["fused"], 1.0, rtol=1e-6)


def test_a_turned_camera_is_told_by_its_axis():
    """The last group holds the cosine between the axes."""
    turned = np.eye(4)
    turned[:3, :3] = Rotation.from_euler("y", 30, degrees=True).as_matrix()
    maps = replace(
        plane_maps(), sources=(*SOURCES[:2], replace(SOURCES[2], world_to_camera=turned))
    )
    axis = grouped(input_channels(maps, "channels"))["axis"]
    np.testing.assert_allclose(axis[:, 0, 0], [1, 1, np.cos(np.pi / 6)], rtol=1e-6)


def test_normals_of_a_slanted_plane():
    """The plane z = a x + c has the normal (a, 0, -1), normalised, up to the border."""
    slope = 0.4
    rays = TARGET.rays()
    depth = (WALL_Z / (1 - slope * rays[..., 0])).astype(np.float32)
    normals = surface_normals(surface_points(TARGET, depth), depth > 0)
    expected = np.array([slope, 0, -1]) / np.hypot(slope, 1)
    np.testing.assert_allclose(
        normals, np.broadcast_to(expected[:, None, None], normals.shape), atol=2e-4
    )


def test_views_may_be_permuted():
    """Views in another order give the same channels in another order within every group."""
    maps, order = plane_maps(), [2, 0, 1]
    other = replace(
        maps,
        sources=tuple(maps.sources[k] for k in order),
        colours=maps.colours[order],
        depths=maps.depths[order],
        alphas=maps.alphas[order],
    )
    first, second = (
        grouped(input_channels(maps, "channels")),
        grouped(input_channels(other, "channels")),
    )
    for name, size in GROUPS.items():
        values = (
            first[name]
            if size == 1
            else first[name].reshape(K, -1, HEIGHT, WIDTH)[order].reshape(size, HEIGHT, WIDTH)
        )
        np.testing.assert_array_equal(second[name], values, err_msg=name)


@pytest.mark.parametrize("guidance", ["channels", "none"])
def test_unknown_pixels(guidance):
    """Where depth is unknown inverse depths and cosines to the normal are 0, directions go to the
    far plane, nothing is NaN.
    """
    maps = plane_maps()
    hole = np.s_[20:30, 40:60]
    maps.fused_depth[hole] = 0
    for values in (maps.depths, maps.alphas):
        values[(slice(None), *hole)] = 0
    channels = input_channels(maps, guidance)
    far = input_channels(
        replace(maps, fused_depth=np.full_like(maps.fused_depth, TARGET.far)), "channels", unit=1.0
    )
    assert np.isfinite(channels).all()
    assert (channels[3 * K : 5 * K, 20:30, 40:60] == 0).all()
    to_target = (
        channels[6 * K + 1 : 7 * K + 1] if guidance == "channels" else channels[5 * K : 6 * K]
    )
    np.testing.assert_array_equal(
        to_target[:, 20:30, 40:60], grouped(far)["target"][:, 20:30, 40:60]
    )
    if guidance == "channels":
        found = grouped(channels)
        assert (found["fused"][0, 20:30, 40:60] == 0).all()
        # neighbours of the hole have no normal either
        assert (found["normal"][:, 19:31, 40:60] == 0).all()
        assert (found["normal"][:, :18] > 0.5).all()


def test_nothing_known_at_all():
    """With no depth anywhere the far plane is the unit, and the channels are finite."""
    empty = plane_maps()
    maps = replace(
        empty, depths=0 * empty.depths, alphas=0 * empty.alphas, fused_depth=0 * empty.fused_depth
    )
    assert reference_depth(maps.fused_depth, TARGET) == TARGET.far
    assert np.isfinite(input_channels(maps, "channels")).all()
    assert np.isfinite(input_channels(maps, "none")).all()
    assert np.isfinite(input_channels(maps.reduced(2), "registered")).all()


def test_without_guidance_the_fused_depth_is_not_seen():
    """8 K channels, the same whatever the fused depth; angles are measured at the nearest view that
    covers the pixel.
    """
    maps = plane_maps()
    maps.alphas[0, :, :50] = 0.2
    other = replace(maps, fused_depth=np.zeros_like(maps.fused_depth))
    found = input_channels(maps, "none")
    assert len(found) == channel_count(K, "none") == 8 * K
    np.testing.assert_array_equal(found, input_channels(other, "none"))
    surface = np.full_like(maps.fused_depth, WALL_Z)
    surface[:, :50] = WALL_Z + 0.1
    guided = input_channels(replace(maps, fused_depth=surface), "channels", unit=1.0)
    np.testing.assert_array_equal(found[5 * K : 6 * K], grouped(guided)["target"])


def moved(camera: Camera, scale: float, rotation: np.ndarray, shift: np.ndarray) -> Camera:
    """The camera after the world was scaled, turned and shifted."""
    pose = np.eye(4)
    pose[:3, :3] = camera.rotation @ rotation.T
    pose[:3, 3] = scale * camera.translation - pose[:3, :3] @ shift
    return replace(camera, world_to_camera=pose, near=scale * camera.near, far=scale * camera.far)


@settings(max_examples=15, deadline=None, derandomize=True)
@given(
    scale=st.floats(0.02, 50),
    turn=st.tuples(*[st.floats(-3, 3)] * 3),
    shift=st.tuples(*[st.floats(-100, 100)] * 3),
)
def test_the_frame_of_the_world_does_not_matter(scale, turn, shift):
    """Scaling, turning and shifting the world changes no channel."""
    _, depth = look(TARGET)
    maps = replace(plane_maps(), fused_depth=depth)
    rotation = Rotation.from_rotvec(turn).as_matrix()
    other = replace(
        maps,
        target=moved(TARGET, scale, rotation, np.array(shift)),
        sources=tuple(moved(source, scale, rotation, np.array(shift)) for source in SOURCES),
        depths=maps.depths * np.float32(scale),
        fused_depth=depth * np.float32(scale),
    )
    np.testing.assert_allclose(
        input_channels(other, "channels"), input_channels(maps, "channels"), atol=3e-4
    )


def test_a_crop_is_a_part_of_the_whole():
    """Channels of a window, in the unit of the whole view, are those of the whole view; only
    normals lack neighbours outside.
    """
    raw = raw_views(blending_inputs([0, 1, 2]))
    unit = reference_depth(raw.fused_depth, TARGET)
    part = input_channels(raw.cropped(10, 5, 48, 32).maps("registered"), "registered", unit=unit)
    whole = input_channels(raw.maps("registered"), "registered")[:, 5:37, 10:58]
    np.testing.assert_allclose(part[:, 1:-1, 1:-1], whole[:, 1:-1, 1:-1], atol=1e-5)


def blending_inputs(order: list[int]) -> BlendingInputs:
    """What the online method hands over, sources in that order."""
    moment = instant(0, TARGET, [SOURCES[k] for k in order])
    splats = [splat([source], TARGET, near=moment.near_plane) for source in moment.sources]
    return BlendingInputs(moment, splats, look(TARGET)[1], 0.05)


def test_views_are_ordered_by_their_distance():
    """Nearest camera first, in whatever order the instant has them."""
    first, second = (
        blend_maps(blending_inputs(order), "registered") for order in ([0, 1, 2], [2, 0, 1])
    )
    assert [camera.name for camera in second.sources] == ["x+0.15", "x-0.30", "x+0.45"]
    np.testing.assert_array_equal(
        input_channels(first, "registered"), input_channels(second, "registered")
    )


def test_registered_views_are_sharper_and_splats_stand_in():
    """Where a view sees the fused surface its source image is shown, elsewhere its splat,
    faintly.
    """
    raw = raw_views(blending_inputs([0, 1, 2]))
    visible, hidden = raw.visibilities == 1, raw.visibilities == 0
    assert visible.mean() > 0.5
    assert hidden.any()
    maps = raw.maps("registered")
    np.testing.assert_allclose(maps.colours[visible], raw.warps[visible], atol=1e-6)
    np.testing.assert_array_equal(maps.colours[hidden], raw.splats[hidden])
    np.testing.assert_array_equal(maps.coverage[hidden], FAINT * raw.alphas[hidden])
    truth = look(TARGET)[0].astype(np.float32) / 255
    inner = np.s_[:, 8:-8, 8:-8]
    errors = [
        np.abs(colours - truth)[inner][visible[inner]].mean() for colours in (raw.warps, raw.splats)
    ]
    assert errors[0] < 0.7 * errors[1]
    np.testing.assert_array_equal(raw.maps("none").colours, raw.splats)
    np.testing.assert_array_equal(raw.maps("channels").coverage, raw.alphas)


def test_a_view_that_is_not_there_is_black():
    """A network made for more views gets zeros for the others, after those of the views in every
    group.
    """
    maps = plane_maps()
    found, wide = input_channels(maps, "registered"), input_channels(maps, "registered", views=5)
    assert len(found) == channel_count(3, "registered") == 31
    assert len(wide) == channel_count(5, "registered") == 51
    np.testing.assert_array_equal(wide[:9], found[:9])
    assert not wide[9:15].any()
    np.testing.assert_array_equal(wide[15:18], found[9:12])
    np.testing.assert_array_equal(wide[25], found[15])  # the fused depth belongs to no view
    np.testing.assert_array_equal(wide[-5:-2], found[-3:])


def test_reduced_maps_are_averages():
    """Half the size: means of two by two pixels, one depth of four, a camera of that size; odd
    sizes are continued.
    """
    maps = plane_maps()
    small = maps.reduced(2)
    assert small.target.size == (WIDTH // 2, HEIGHT // 2)
    np.testing.assert_allclose(small.target.K[0, 0], TARGET.K[0, 0] / 2)
    means = maps.colours.reshape(K, HEIGHT // 2, 2, WIDTH // 2, 2, 3).mean(axis=(2, 4))
    np.testing.assert_allclose(small.colours, means, atol=1e-6)
    np.testing.assert_array_equal(small.depths, maps.depths[:, 1::2, 1::2])
    raw = raw_views(blending_inputs([0, 1, 2])).cropped(0, 0, 41, 33)
    odd = raw.maps("registered").reduced(2)
    assert odd.fused_depth.shape == (17, 21)
    assert odd.colours.shape == (3, 17, 21, 3)
    assert input_channels(odd, "registered").shape == (31, 17, 21)


def test_every_view_wants_its_splat():
    """A splat too few is an error that says how many are wanted."""
    inputs = blending_inputs([0, 1, 2])
    with refused(RenderError, "2 for 3"):
        blend_maps(replace(inputs, splats=inputs.splats[:2]), "none")
