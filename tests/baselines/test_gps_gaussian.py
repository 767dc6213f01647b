"""GPS-Gaussian: names and shapes of the published checkpoint, the authors' outputs, rectification,
rendering, whole steps.
"""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from torch.optim.lr_scheduler import OneCycleLR

from ggvs_eval.baselines.gps_gaussian.method import MOST_PIXELS, GpsGaussian, choose_pairs, rectify
from ggvs_eval.baselines.gps_gaussian.network import MAX_SCALE_M, GpsGaussianNetwork, load_network
from ggvs_eval.baselines.gps_gaussian.rendering import (
    Gaussians,
    blend_gaussians,
    render_gaussians,
    rotation_matrices,
)
from ggvs_eval.compute_device import one_thread
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import quantise
from ggvs_eval.method import SourceView
from helpers.geometry_scenes import random_camera
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.scenes import WALL_Z, camera_at, instant, look, texture
from helpers.seeded_networks import seeded_pair, seeded_state

SCALES = "gs_parm_regresser.scale_head.2.weight"


def seeded_weights():
    """Weights drawn by name; scales small enough not to lie at their limit everywhere."""
    shapes = {
        name: tuple(tensor.shape) for name, tensor in GpsGaussianNetwork().state_dict().items()
    }
    state = seeded_state(shapes)
    return {**state, SCALES: 0.01 * state[SCALES]}


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """A checkpoint as the authors write theirs, with seeded weights."""
    path = tmp_path_factory.mktemp("gps") / "GPS-GS_stage2_final.pth"
    return write_checkpoint(path, seeded_weights())


def write_checkpoint(path, network):
    """The authors' dict; torch 2.0, which they trained with, kept a function of its own in the
    scheduler's state.
    """
    layer = torch.nn.Linear(2, 2)
    optimizer = torch.optim.AdamW(layer.parameters(), lr=2e-4)
    scheduler = {
        **OneCycleLR(optimizer, 2e-4, 1000).state_dict(),
        "anneal_func": OneCycleLR._annealing_linear,
    }
    torch.save(
        {
            "total_steps": 7,
            "network": network,
            "optimizer": optimizer.state_dict(),
            "scheduler": scheduler,
        },
        path,
    )
    return path


def test_names_and_shapes_are_those_of_the_checkpoint():
    """Every parameter of the published network exists under its name with its shape, in its order,
    and no other.
    """
    network = GpsGaussianNetwork()
    oracle = json.loads((DATA_FOLDER / "gps_gaussian_state_dict.json").read_text())
    shapes = {name: list(tensor.shape) for name, tensor in network.state_dict().items()}
    assert list(shapes.items()) == list(oracle["network"].items())
    assert sum(parameter.numel() for parameter in network.parameters()) == oracle["n_params"]


def test_outputs_are_the_authors():
    """Features, flow and Gaussians agree with the authors' code on the same weights
    (tests/data/GPS_GAUSSIAN_ORACLES.md).
    """
    network = GpsGaussianNetwork().eval()
    network.load_state_dict(seeded_weights())
    images = torch.cat(seeded_pair(64, 160)) / 127.5 - 1
    with one_thread(), torch.inference_mode():
        features = network.features(images)
        flow = network.flow(features)
        inverse = (flow - torch.tensor([3.5, -3.5]).view(2, 1, 1, 1)) / torch.tensor(
            [-40.0, 40.0]
        ).view(2, 1, 1, 1)
        inverse[..., :4] = 0
        maps = network.gaussians(images, inverse, features)
    golden = np.load(DATA_FOLDER / "gps_gaussian_golden.npz")
    np.testing.assert_allclose(features[2][:, ::4], golden["eighth"], atol=1e-4)
    np.testing.assert_allclose(flow[..., ::2, ::2], golden["flow"], atol=1e-4)
    np.testing.assert_allclose(inverse[..., ::4, ::4], golden["inverse_depth"], atol=1e-5)
    np.testing.assert_allclose(maps.rotation[..., ::4, ::4], golden["rot"], atol=1e-5)
    np.testing.assert_allclose(maps.scale_m[..., ::4, ::4], golden["scale"], atol=1e-7)
    np.testing.assert_allclose(maps.opacity[..., ::4, ::4], golden["opacity"], atol=1e-5)
    assert float(maps.scale_m.max()) == pytest.approx(MAX_SCALE_M)


@pytest.mark.parametrize("prefix", [pytest.param("", marks=pytest.mark.slow), "module."])
def test_the_authors_checkpoint_loads_strictly(tmp_path, prefix):
    """The authors' dict, scheduler state of torch 2.0 and all, becomes the network bit for bit,
    with and without ``module.``.
    """
    state = seeded_weights()
    loaded = load_network(
        write_checkpoint(
            tmp_path / "stage2.pth", {f"{prefix}{name}": tensor for name, tensor in state.items()}
        )
    )
    assert not loaded.training
    assert all(torch.equal(tensor, state[name]) for name, tensor in loaded.state_dict().items())


def turned(camera, *angles):
    """The camera turned about its own axes, radians."""
    world_to_camera = np.eye(4)
    world_to_camera[:3, :3] = Rotation.from_rotvec(angles).as_matrix()
    return replace(camera, world_to_camera=world_to_camera @ camera.world_to_camera)


PAIRS = {
    "parallel": (camera_at(-0.2), camera_at(0.2)),
    "converging": (turned(camera_at(-0.6), 0, -0.1, 0), turned(camera_at(0.6), 0.02, 0.12, 0.03)),
    "oblique": (
        camera_at(-0.2, -0.1),
        turned(camera_at(0.2, 0.15, width=80, height=60), 0, 0, 0.1),
    ),
    "upright": (camera_at(0.0, -0.3), camera_at(0.05, 0.3)),
}


@pytest.mark.parametrize("title", PAIRS)
def test_matches_lie_on_one_row_and_flow_gives_their_depth(title):
    """A point projects to one row of both canvases, and the exact flow between them gives its exact
    inverse depth in both.
    """
    pair = rectify(*PAIRS[title])
    left, right = (view.camera for view in pair.views)
    points = np.random.default_rng(1).uniform((-1, -1, 3), (1, 1, 6), (20, 3))
    (uv_left, z_left), (uv_right, z_right) = left.project(points), right.project(points)
    np.testing.assert_allclose(uv_left[:, 1], uv_right[:, 1], atol=1e-9)
    np.testing.assert_allclose(z_left, z_right)
    assert left.width % 8 == left.height % 8 == 0
    for index, z in enumerate(z_left):
        shift = uv_right[index, 0] - uv_left[index, 0]
        flow = np.stack(
            [np.full((left.height, left.width), value, np.float32) for value in (shift, -shift)]
        )
        inverse = pair.inverse_depth(flow)
        for half, view in enumerate(pair.views):
            np.testing.assert_allclose(inverse[half][view.inside], 1 / z, rtol=1e-4)
            assert (inverse[half][~view.inside] == 0).all()


@pytest.mark.parametrize("title", ["parallel", "converging"])
def test_rectification_is_the_authors_recipe(title):
    """Turned cameras are those of OpenCV's stereoRectify without flags, as the authors call it, up
    to how it halves the turn.
    """
    left, right = PAIRS[title]
    turn = right.rotation @ left.rotation.T
    shift = (right.translation - turn @ left.translation)[:, None]
    half = np.array([[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]])  # OpenCV has pixel centres at integers
    results = cv2.stereoRectify(
        left.K - half, np.zeros(4), right.K - half, np.zeros(4), left.size, turn, shift, flags=0
    )
    pair = rectify(left, right)
    for view, camera, rotation, projection in zip(
        pair.views, (left, right), results[:2], results[2:4], strict=True
    ):
        off_rad = Rotation.from_matrix(
            view.camera.rotation @ (rotation @ camera.rotation).T
        ).magnitude()
        assert off_rad < 2e-3
        np.testing.assert_allclose(view.camera.K, projection[:, :3] + half, atol=0.2)


def see_wall(camera):
    """Image (H, W, 3) uint8 and depth (H, W) float32 of the wall alone, from a camera that may be
    turned.
    """
    rays = camera.rays()
    depth = (WALL_Z - camera.centre[2]) / rays[..., 2]
    return quantise(texture(camera.centre + depth[..., None] * rays, 0.0)), depth.astype(np.float32)


@pytest.mark.parametrize("title", PAIRS)
def test_canvases_are_what_turned_cameras_see(title):
    """The rectified image and given depth are those that a camera turned so would have captured."""
    cameras = PAIRS[title]
    for view, camera in zip(rectify(*cameras).views, cameras, strict=True):
        image, depth = see_wall(camera)
        source = SourceView(camera, image, depth, np.ones_like(depth))
        expected, expected_depth = see_wall(view.camera)
        assert view.inside.mean() > 0.5
        off = np.abs(view.image(source) - expected.astype(np.float32) / 255).max(axis=-1)[
            view.inside
        ]
        assert off.max() < 0.02
        ratio = (view.inverse_depth(source) * expected_depth)[view.inside]
        assert np.abs(ratio - 1).max() < 5e-3
        assert (view.image(source)[~view.inside] == 0).all()


@pytest.mark.parametrize("ahead", [0.0, 0.2, 0.3, 0.45])
def test_whole_canvases_stay_within_a_multiple_of_the_image(ahead):
    """However far ahead of the other the right camera stands: all of both images, on no more than
    so many of their pixels.
    """
    left, right = camera_at(-0.15), camera_at(0.15)
    walked = np.array(right.world_to_camera)
    walked[2, 3] -= ahead
    cameras = left, replace(right, world_to_camera=walked)
    pair = rectify(*cameras, entire=True)
    width, height = pair.left.camera.size
    assert (width - 8) * (height - 8) <= MOST_PIXELS * left.width * left.height
    shrunken = pair.left.camera.focal_px < left.focal_px * (1 - 1e-9)
    assert shrunken == (ahead > 0.2)  # 8.5 and 81 times the image otherwise
    for view, camera in zip(pair.views, cameras, strict=True):
        uv, depth = view.camera.project(
            camera.unproject(camera.pixel_centres(), np.ones(camera.pixel_centres().shape[:-1]))
        )
        assert (depth > 0).all()
        assert ((uv >= 0) & (uv <= [width, height])).all()
    left_uv, right_uv = (
        view.camera.project(np.array([[0.1, -0.2, 4.0]]))[0] for view in pair.views
    )
    np.testing.assert_allclose(left_uv[:, 1], right_uv[:, 1], atol=1e-9)


def test_the_nearest_pair_that_is_one_is_taken():
    """Pairs go by their distance to the target, the left camera first; cameras that are behind each
    other make no pair.
    """
    behind = replace(camera_at(0.0), name="behind")
    shifted = behind.world_to_camera.copy()
    shifted[2, 3] += 0.1
    behind = replace(behind, world_to_camera=shifted)
    cameras = [camera_at(0.0), behind, camera_at(0.3), camera_at(-0.4), camera_at(2.0)]
    assert choose_pairs(camera_at(0.01), cameras, 1) == [(0, 2)]
    assert choose_pairs(camera_at(-0.01), cameras[:1] + cameras[3:], 1) == [(1, 0)]
    assert choose_pairs(camera_at(0.01), cameras, 2) == [(0, 2), (3, 1)]
    with pytest.raises(RenderError, match="are behind each other"):
        choose_pairs(camera_at(0.0), cameras[:2], 1)
    with refused(RenderError, "stereo pair", "one camera"):
        choose_pairs(camera_at(0.0), cameras[:1], 1)


def random_set(seed, count=60):
    """Anisotropic Gaussians before a camera, and the camera."""
    random = np.random.default_rng(seed)
    camera = random_camera(random, 37, 29)
    quaternions = Rotation.random(count, rng=random).as_quat()[:, [3, 0, 1, 2]]
    gaussians = Gaussians(
        torch.from_numpy(random.uniform((-0.9, -0.7, 0.1), (0.9, 0.7, 3.0), (count, 3))),
        rotation_matrices(torch.from_numpy(quaternions).float()),
        torch.from_numpy(random.uniform(0.005, 0.2, (count, 3))).float(),
        torch.from_numpy(random.uniform(0.02, 1, count)).float(),
        torch.from_numpy(random.uniform(0, 1, (count, 3))).float(),
    )
    return gaussians, camera


def plain_render(gaussians, camera, near):
    """Colour, alpha and depth sums by loops over Gaussians and pixels in float64, from the
    published formulas.
    """
    names = ("centres", "axes", "scales", "opacities", "colours")
    centres, axes, scales, opacities, colours = (
        getattr(gaussians, name).numpy().astype(np.float64) for name in names
    )
    points = centres @ camera.rotation.T + camera.translation
    (fx, _, cx), (_, fy, cy) = camera.K[:2]
    limit = 1.3 * np.array([camera.width / (2 * fx), camera.height / (2 * fy)])
    sums, light = np.zeros((camera.height, camera.width, 5)), np.ones((camera.height, camera.width))
    done = np.zeros_like(light, bool)
    for index in np.argsort(points[:, 2], kind="stable"):
        x, y, z = points[index]
        if z <= near:
            continue
        tx, ty = np.clip([x / z, y / z], -limit, limit) * z
        jacobian = (
            np.array([[fx / z, 0, -fx * tx / z**2], [0, fy / z, -fy * ty / z**2]]) @ camera.rotation
        )
        covariance = axes[index] @ np.diag(scales[index] ** 2) @ axes[index].T
        covariance = jacobian @ covariance @ jacobian.T + 0.3 * np.eye(2)
        mid = np.trace(covariance) / 2
        radius = np.ceil(3 * np.sqrt(mid + np.sqrt(max(0.1, mid**2 - np.linalg.det(covariance)))))
        at, inverse = np.array([fx * x / z + cx, fy * y / z + cy]) - 0.5, np.linalg.inv(covariance)
        low, high = np.floor((at - radius) / 16), np.floor((at + radius + 15) / 16)
        for row, column in np.ndindex(light.shape):
            tile = np.array([column // 16, row // 16])
            away = np.array([column, row]) - at
            alpha = min(0.99, opacities[index] * np.exp(-0.5 * away @ inverse @ away))
            if done[row, column] or (tile < low).any() or (tile >= high).any() or alpha < 1 / 255:
                continue
            if light[row, column] * (1 - alpha) < 1e-4:
                done[row, column] = True
                continue
            sums[row, column] += light[row, column] * alpha * np.array([*colours[index], z, 1])
            light[row, column] *= 1 - alpha
    return sums


@pytest.mark.slow
@pytest.mark.parametrize("seed", [1, 3])
def test_gaussians_are_rendered_by_the_published_formulas(seed):
    """Colour, coverage and depth of anisotropic Gaussians are those of a loop over pixels, tile
    borders included.
    """
    gaussians, camera = random_set(seed)
    expected = plain_render(gaussians, camera, 0.3)
    found = render_gaussians(gaussians, camera, 0.3)
    ours = np.concatenate(
        [found.colour, (found.depth * found.alpha)[..., None], found.alpha[..., None]], axis=-1
    )
    expected[..., 3] *= expected[..., 4] > 1 / 255
    off = np.abs(ours - expected).max(axis=-1)
    assert (off > 1e-5).sum() <= 1  # an alpha at 1/255 may fall to either side
    assert off.max() < 0.03
    assert expected[..., 4].max() > 0.9


def test_rendering_passes_gradients():
    """Colours, opacities, scales, axes and centres receive finite gradients, so that the network
    can be trained through it.
    """
    gaussians, camera = random_set(4)
    parts = {name: getattr(gaussians, name).clone().requires_grad_() for name in vars(gaussians)}
    (blend_gaussians(Gaussians(**parts), camera, 0.3) ** 2).sum().backward()
    for part in parts.values():
        assert bool(torch.isfinite(part.grad).all())
        assert bool((part.grad != 0).any())


def rig(count):
    """Source cameras around a target, nearest first, not all on one line."""
    return [
        camera_at(x, y)
        for x, y in [(0.1, 0.0), (-0.2, 0.05), (0.35, -0.1), (-0.4, 0.2), (0.0, 0.5)][:count]
    ]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "depth"), [(2, "given"), (5, "own")])
def test_a_step_gives_an_image(weights, count, depth):
    """A finite image of the target's size, in [0, 1], the same bits from a fresh object and
    whatever the threads.
    """
    target = camera_at(0.0, width=70, height=50)
    method = GpsGaussian(weights, depth)
    first = method.step(instant(3, target, rig(count), square_x=0.4))
    threads = torch.get_num_threads()
    torch.set_num_threads(2)
    again = method.step(instant(3, target, rig(count), square_x=0.4))
    torch.set_num_threads(threads)
    assert first.image.shape == (50, 70, 3)
    assert first.image.dtype == np.float32
    assert np.isfinite(first.image).all()
    assert 0 <= first.image.min() < first.image.max() <= 1
    assert not any(parameter.is_inference() for parameter in load_network(weights).parameters())
    np.testing.assert_array_equal(first.image, again.image)
    np.testing.assert_array_equal(first.depth, again.depth)


def test_given_depth_shows_the_scene(weights):
    """With exact depth every Gaussian lies where it should, so that the view is close to the truth
    even by seeded weights.
    """
    target = camera_at(0.05)
    rendering = GpsGaussian(weights, "given").step(instant(0, target, rig(3)))
    truth, depth = look(target)
    covered = rendering.image.sum(axis=-1) > 0.3
    off = np.abs(rendering.image - truth.astype(np.float32) / 255).mean(axis=-1)
    assert np.median(off[covered]) < 0.1
    assert np.median(np.abs(rendering.depth / depth - 1)[covered]) < 1e-3


def test_options_that_mean_nothing_are_refused(weights):
    """A depth or a frame of rotations that does not exist, or no pair at all, is refused in one
    line that names it.
    """
    with refused(RenderError, "own or given", "'sensor'"):
        GpsGaussian(weights, "sensor")
    with refused(RenderError, "one pair", "and 0"):
        GpsGaussian(weights, pairs=0)


def scaled(moment, factor):
    def camera(old):
        world_to_camera = old.world_to_camera.copy()
        world_to_camera[:3, 3] *= factor
        return replace(
            old, world_to_camera=world_to_camera, near=old.near * factor, far=old.far * factor
        )

    sources = tuple(
        replace(source, camera=camera(source.camera), depth=source.depth * np.float32(factor))
        for source in moment.sources
    )
    return replace(
        moment,
        target=camera(moment.target),
        sources=sources,
        units_per_metre=moment.units_per_metre * factor,
    )


@pytest.mark.parametrize("depth", [pytest.param("own", marks=pytest.mark.slow), "given"])
def test_the_unit_of_the_world_does_not_matter(weights, depth):
    """The same scene in units eight times as small gives the same image: inverse depth and scales
    are metric to the network.
    """
    moment = instant(0, camera_at(0.05), rig(2))
    method = GpsGaussian(weights, depth)
    plain, in_other_units = method.step(moment).image, method.step(scaled(moment, 8.0)).image
    assert np.quantile(np.abs(plain - in_other_units), 0.99) < 1e-3


@pytest.mark.slow
def test_camera_rotations_make_the_world_free_to_turn(weights):
    """With rotations in the camera's frame a turned world gives the same image; with the published
    ones it need not.
    """
    moment = instant(0, camera_at(0.05), rig(2))
    turn = np.eye(4)
    turn[:3, :3] = Rotation.from_rotvec([0.4, -0.7, 0.3]).as_matrix()

    def moved(camera):
        return replace(camera, world_to_camera=camera.world_to_camera @ turn)

    sources = tuple(replace(source, camera=moved(source.camera)) for source in moment.sources)
    other = replace(moment, target=moved(moment.target), sources=sources)
    free = GpsGaussian(weights, "given", rotations_in="camera")
    assert np.quantile(np.abs(free.step(moment).image - free.step(other).image), 0.99) < 1e-3
    bound = GpsGaussian(weights, "given")
    assert np.abs(bound.step(moment).image - bound.step(other).image).max() > 1e-3
