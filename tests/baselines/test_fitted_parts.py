"""Parts of fitted methods: field, motions, loss, first points, density control, against formulas
and outside references.
"""

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation

from ggvs_eval.baselines.fitted.hexplane import (
    PUBLISHED,
    DeformationNetwork,
    PlaneGrid,
    compact,
    read_deformation,
)
from ggvs_eval.baselines.fitted.optimiser import (
    DensitySchedule,
    control_density,
    photometric_loss,
    rotated,
    structural_loss,
)
from ggvs_eval.baselines.fitted.points import Points, initial_points
from ggvs_eval.baselines.fitted.published import PublishedScene
from ggvs_eval.baselines.fitted.scene import (
    HexPlaneMotion,
    LinearMotion,
    NoMotion,
    PolynomialMotion,
    TransformationMotion,
    canonical,
    faded,
    quaternion_product,
)
from ggvs_eval.baselines.fitted.state import FitState, box_of, first_gaussians
from ggvs_eval.errors import DepthError, RenderError, WeightsError
from ggvs_eval.gaussians import GaussianCloud, render_gaussians
from ggvs_eval.gaussians.ply import write_ply
from helpers.fitted_footage import footage_of, rig, wall
from helpers.refusals import refused

ORACLE = Path(__file__).parents[1] / "data" / "four_d_state_dict.json"
BOX = torch.tensor([[2.0, 3.0, 4.0], [-2.0, -1.0, -4.0]])  # the larger corner first


def published_tensors() -> dict[str, torch.Tensor]:
    """A checkpoint of the authors' names and shapes, with seeded values."""
    generator = torch.Generator().manual_seed(4)
    shapes = json.loads(ORACLE.read_text(encoding="utf-8"))
    tensors = {
        name: 0.1 * torch.randn(shape, generator=generator) for name, shape in shapes.items()
    }
    tensors["deformation_net.grid.aabb"] = BOX
    return tensors


def points_of(means: torch.Tensor, steady: bool = True) -> Points:
    """Grey points of the middle of the clip, which last through all of it."""
    count = len(means)
    return Points(
        means,
        torch.full((count, 3), 0.5),
        torch.full((count,), 0.5),
        torch.full((count,), 1e6),
        torch.full((count,), steady),
    )


def test_files_of_the_authors_load_strictly(tmp_path):
    """Names and shapes of `deformation.pth` are those of the network; every value arrives; what
    differs is refused by name.
    """
    tensors = published_tensors()
    torch.save(tensors, tmp_path / "deformation.pth")

    network = read_deformation(tmp_path / "deformation.pth")

    assert {
        name: list(tensor.shape) for name, tensor in network.state_dict().items()
    } == json.loads(ORACLE.read_text())
    # buffers are no parameters
    assert sum(value.numel() for value in network.parameters()) + 18 == 2_462_561 + 18
    assert all(torch.equal(value, tensors[name]) for name, value in network.state_dict().items())
    torch.save(
        tensors | {"deformation_net.feature_out.0.weight": torch.zeros(128, 16)},
        tmp_path / "other.pth",
    )
    with pytest.raises(
        WeightsError,
        match=r"other.pth: 1 tensors differ from 4DGS .*feature_out.0.weight: wanted \(128, 32\), "
        r"got",
    ):
        read_deformation(tmp_path / "other.pth")


def test_features_are_products_of_bilinear_planes():
    """Features of points in and outside the box are those of a loop over planes, from the
    definition: mirrored axes, raw time.
    """
    torch.manual_seed(1)
    grid = PlaneGrid(BOX, PUBLISHED)
    for plane in grid.parameters():
        if plane.requires_grad:
            torch.nn.init.uniform_(plane)
    points = torch.from_numpy(np.random.default_rng(2).uniform(-5, 5, (7, 3)).astype(np.float32))
    time = 0.37

    features = grid(points, time).detach().numpy()

    for row, point in enumerate(points.numpy()):
        high, low = BOX.numpy()
        place = np.clip([*(2 * (point - high) / (low - high) - 1), time], -1, 1)
        for level, planes in enumerate(grid.grids):
            product = np.ones(16)
            for plane, (first, second) in zip(planes, grid.axes, strict=True):
                nodes = plane.detach().numpy()[0]
                column, line = (
                    (place[axis] + 1) / 2 * (size - 1)
                    for axis, size in ((first, nodes.shape[2]), (second, nodes.shape[1]))
                )
                i, j = min(int(column), nodes.shape[2] - 2), min(int(line), nodes.shape[1] - 2)
                a, b = column - i, line - j
                product *= (1 - b) * ((1 - a) * nodes[:, j, i] + a * nodes[:, j, i + 1]) + b * (
                    (1 - a) * nodes[:, j + 1, i] + a * nodes[:, j + 1, i + 1]
                )
            np.testing.assert_allclose(
                features[row, 16 * level : 16 * level + 16], product, atol=2e-5
            )


def motions(means: torch.Tensor) -> list:
    """One of each kind, as fits begin with them."""
    return [
        HexPlaneMotion(DeformationNetwork(box_of(means), compact(12, 1)), 2.0),
        LinearMotion(),
        PolynomialMotion(),
        TransformationMotion(box_of(means), 2.0, 0),
    ]


@pytest.mark.parametrize("kind", range(4))
def test_a_scene_at_rest_gives_the_same_bits_at_all_times(kind):
    """Before anything is learned nothing moves: pictures of all times are equal bit by bit.

    But for a field's, whose heads begin with random weights and shift all times alike, they are
    also those without motion.
    """
    means = wall().means
    motion = motions(means)[kind]
    gaussians = first_gaussians(points_of(means), 1, motion)
    camera = rig()[1]

    with torch.no_grad():
        still = render_gaussians(canonical(gaussians), camera).image
        pictures = [
            render_gaussians(motion.cloud(gaussians, time), camera).image
            for time in (0.0, 0.31, 0.5, 1.0)
        ]

    assert all(torch.equal(picture, pictures[0]) for picture in pictures)
    assert torch.equal(pictures[0], still) or isinstance(motion, HexPlaneMotion)


def test_explicit_motions_are_their_formulas():
    """Positions, axes and opacities at a time are those that Spacetime Gaussians and FreeTimeGS
    print.
    """
    random = np.random.default_rng(3)
    gaussians = first_gaussians(points_of(wall().means), 1, PolynomialMotion())
    for name in ("velocities", "turns"):
        gaussians[name] = torch.from_numpy(
            random.normal(size=gaussians[name].shape).astype(np.float32)
        )
    gaussians["times"] = torch.from_numpy(
        random.uniform(0, 1, len(gaussians["times"])).astype(np.float32)
    )
    gaussians["log_durations"] = torch.from_numpy(
        random.uniform(-2, 0, len(gaussians["times"])).astype(np.float32)
    )
    ahead = (0.7 - gaussians["times"])[:, None]

    curved = PolynomialMotion().cloud(gaussians, 0.7)
    straight = LinearMotion().cloud(
        {**gaussians, "velocities": gaussians["velocities"][:, :1]}
        | {"turns": torch.zeros(300, 4)},
        0.7,
    )

    powers = sum(gaussians["velocities"][:, power] * ahead ** (power + 1) for power in range(3))
    share = (ahead[:, 0] / gaussians["log_durations"].exp()) ** 2
    torch.testing.assert_close(curved.means, gaussians["means"] + powers)
    torch.testing.assert_close(
        curved.quaternions, gaussians["quaternions"] + gaussians["turns"] * ahead
    )
    torch.testing.assert_close(torch.sigmoid(curved.opacity_logits), 0.1 * torch.exp(-share))
    torch.testing.assert_close(
        straight.means, gaussians["means"] + gaussians["velocities"][:, 0] * ahead
    )
    torch.testing.assert_close(torch.sigmoid(straight.opacity_logits), 0.1 * torch.exp(-share / 2))


def test_faded_logits_lose_nothing_to_rounding():
    """Logits of faded opacities are exact where nothing fades, and finite with finite gradients
    where next to nothing is left.
    """
    logits = torch.tensor([-4.0, 0.0, 9.0, 0.0], requires_grad=True)
    fading = torch.tensor([0.0, 0.0, 0.0, 200.0])

    values = faded(logits, fading)
    values.sum().backward()

    assert torch.equal(values[:3], logits[:3])
    assert torch.isfinite(values).all()
    assert torch.isfinite(logits.grad).all()


def test_rotations_are_those_of_scipy():
    """Products of quaternions and turned vectors agree with SciPy's."""
    random = np.random.default_rng(5)
    left, right, vectors = (
        random.normal(size=(9, 4)),
        random.normal(size=(9, 4)),
        random.normal(size=(9, 3)),
    )
    first, second = (Rotation.from_quat(values, scalar_first=True) for values in (left, right))

    product = quaternion_product(torch.from_numpy(left), torch.from_numpy(right)).numpy()

    np.testing.assert_allclose(
        Rotation.from_quat(product, scalar_first=True).as_matrix(),
        (first * second).as_matrix(),
        atol=1e-12,
    )
    np.testing.assert_allclose(
        rotated(torch.from_numpy(left), torch.from_numpy(vectors)).numpy(),
        first.apply(vectors),
        atol=1e-12,
    )


def test_the_loss_and_its_gradient_are_those_of_kornia():
    """0.8 L1 + 0.2 (1 - SSIM) with SSIM by kornia gives the same value and, through its
    convolutions, the same gradient.
    """
    generator = torch.Generator().manual_seed(6)
    truth = torch.rand(23, 31, 3, generator=generator)
    image = (truth + 0.2 * torch.rand(23, 31, 3, generator=generator)).requires_grad_()
    twin = image.detach().clone().requires_grad_()

    loss = photometric_loss(image, truth)
    loss.backward()
    structure = structural_loss(twin.permute(2, 0, 1)[None], truth.permute(2, 0, 1)[None])
    expected = 0.8 * (twin - truth).abs().mean() + 0.2 * structure
    expected.backward()

    torch.testing.assert_close(loss, expected, atol=1e-6, rtol=1e-5)
    torch.testing.assert_close(image.grad, twin.grad, atol=1e-8, rtol=1e-3)


def test_first_points_lie_on_the_surface_once(tmp_path):
    """Points of a wall that stands still lie on it, in its colours, as many as asked, and once for
    all instants.
    """
    cloud = wall()
    footage = footage_of(lambda _: cloud, tmp_path)

    points = initial_points(footage, [0, 2, 3], 500)

    with torch.no_grad():
        distance, nearest = torch.cdist(points.means, cloud.means).min(dim=1)
    assert 300 < len(points.means) <= 500
    assert points.steady.float().mean() > 0.95
    assert float(distance.quantile(0.95)) < 0.3  # Gaussians are 0.27 apart, 0.16 large
    colours = 0.5 + 0.28209479 * cloud.sh[nearest, 0]
    assert float((points.colours - colours).abs().mean()) < 0.08  # neighbours differ by 0.2


def test_first_points_want_cameras_that_agree(tmp_path):
    """Depth on which no cameras agree gives no points, and a message that says so."""
    footage = footage_of(lambda _: wall(), tmp_path, instants=1)
    for place, camera in enumerate(footage.cameras):
        stored = footage.depth_map(camera.name, 0)
        stored.depth[:] = 2.5 + 0.7 * place
        footage.depths.write(camera.name, 0, stored)

    with refused(DepthError, "6 cameras", "1 instants"):
        initial_points(footage, [0], 500)


def test_density_control_clones_splits_and_prunes():
    """Faint Gaussians go, small ones that the image pulls at come twice, large ones become two
    smaller ones, others stay.
    """
    motion = LinearMotion()
    gaussians = first_gaussians(
        points_of(torch.rand(5, 3, generator=torch.Generator().manual_seed(0))), 1, motion
    )
    gaussians["log_scales"][:] = torch.tensor([0.001, 0.001, 0.5, 0.5, 0.001]).log()[:, None]
    gaussians["opacity_logits"][4] = -9.0
    state = FitState(gaussians, motion)
    sum(tensor.sum() for tensor in state.gaussians.values()).backward()
    state.optimiser.step()
    state.gradient_sum[:] = torch.tensor([0.0, 1.0, 1.0, 0.0, 1.0])
    state.visits[:] = 2
    before = {name: tensor.detach().clone() for name, tensor in state.gaussians.items()}

    control_density(state, 1.0, DensitySchedule(), seed=0)

    after = state.gaussians
    assert len(state) == 6
    for name, tensor in after.items():
        assert torch.equal(tensor[:4].detach(), before[name][[0, 1, 3, 1]]), name
    torch.testing.assert_close(
        after["log_scales"][4:].exp(), before["log_scales"][[2, 2]].exp() / 1.6
    )
    assert not torch.equal(after["means"][4], after["means"][5])
    moments = state.optimiser.state[after["means"]]["exp_avg"]
    assert (moments[:3] != 0).all()
    assert (moments[3:] == 0).all()
    assert float(state.visits.sum()) == 0


def test_density_control_keeps_to_its_cap():
    """Where there is room for one, the Gaussian that the image pulls at most is the one that comes
    twice.
    """
    gaussians = first_gaussians(
        points_of(torch.rand(6, 3, generator=torch.Generator().manual_seed(0))), 0, NoMotion()
    )
    gaussians["log_scales"][:] = -7
    state = FitState(gaussians, NoMotion())
    state.gradient_sum[:] = torch.tensor([1.0, 2, 3, 9, 4, 5])
    state.visits[:] = 1

    control_density(state, 1.0, DensitySchedule(most=7), seed=0)

    assert len(state) == 7
    assert torch.equal(state.gaussians["means"][6], gaussians["means"][3])


def test_opacity_that_a_published_field_gives_is_added_before_the_sigmoid():
    """Every head of the authors' field moves its property by an addition before the activation."""
    torch.manual_seed(7)
    network = DeformationNetwork(BOX, PUBLISHED)
    gaussians = first_gaussians(points_of(wall().means), 3, NoMotion())
    cloud: GaussianCloud = HexPlaneMotion(network).cloud(gaussians, 0.25)

    with torch.no_grad():
        moved = network(gaussians["means"], 0.25)

    torch.testing.assert_close(cloud.means - gaussians["means"], moved["pos"])
    torch.testing.assert_close(cloud.log_scales - gaussians["log_scales"], moved["scales"])
    torch.testing.assert_close(cloud.quaternions - gaussians["quaternions"], moved["rotations"])
    torch.testing.assert_close(
        cloud.opacity_logits - gaussians["opacity_logits"], moved["opacity"][:, 0]
    )
    torch.testing.assert_close(cloud.sh - canonical(gaussians).sh, moved["shs"].view(-1, 16, 3))


def test_an_output_folder_of_the_authors_renders(tmp_path):
    """Their point cloud is moved by their field at raw times: the first instant is time 0, and the
    last one is not yet 1.
    """
    means = wall().means
    cloud = canonical(first_gaussians(points_of(means), 3, NoMotion()))
    iteration = tmp_path / "point_cloud" / "iteration_14000"
    iteration.mkdir(parents=True)
    write_ply(iteration / "point_cloud.ply", cloud)
    torch.save(published_tensors(), iteration / "deformation.pth")

    scene = PublishedScene(tmp_path, range(10, 14), near=0.2)

    network = read_deformation(iteration / "deformation.pth")
    for index, time in ((10, 0.0), (13, 0.75)):
        torch.testing.assert_close(scene.cloud(index).means, means + network(means, time)["pos"])
    assert scene.render(11, rig()[0]).image.shape == (48, 64, 3)
    assert scene.size_bytes > 9_850_000  # the field alone
    with refused(RenderError, "10..13", "got 14"):
        scene.cloud(14)
    with refused(RenderError, "point_cloud.ply", "deformation.pth"):
        PublishedScene(iteration.parent, range(4), near=0.2)
