"""Exposure compensation on the device: gains and fall-off of `ExposureCompensation`, with a mask in place of every selection."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import combinations

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from ggvs_eval.camera import Camera
from ggvs_eval.geometry.per_pixel import view_weights
from ggvs_eval.geometry.pinhole import rigid_between
from ggvs_eval.pipelines.online import exposure_compensation as compensation
from ggvs_eval.pipelines.online import lens_falloff
from ggvs_eval.pipelines.online.device import blend_kernels
from ggvs_eval.pipelines.online.device.launch import launch
from ggvs_eval.pipelines.online.device.order_statistics import masked_median
from ggvs_eval.pipelines.online.device.views import DeviceViews, to_device

REDUCTION = compensation.REDUCTION


@dataclass(frozen=True, eq=False)
class ExposureState:
    """Memory of the sources' colours.

    Attributes:
        index: of the last instant.
        ratios: of two cameras, by their names in order: how often their ratio was measured, and its mean logarithm, (3,).
        count: instants that the slope is the mean of.
        slope: of the fall-off.
    """

    index: int
    ratios: Mapping[tuple[str, str], tuple[Tensor, Tensor]] = field(default_factory=dict)
    count: int = 0
    slope: Tensor | None = None


@dataclass(frozen=True, eq=False)
class Exposure:
    """Gain of each source, (K, 3), the common slope of the fall-off, (), and the largest squared tangent in any picture."""

    gains: Tensor
    slope: Tensor
    corner: float


def estimate_exposure(
    index: int, target: Camera, views: DeviceViews, depths: Tensor, tolerance: float, state: ExposureState | None, memory: int
) -> tuple[Exposure, ExposureState]:
    """Gains that make the sources agree, as `ExposureCompensation.gains`.

    Args:
        index: of the instant.
        views: the sources.
        depths: their filtered depths, (K, H, W).
        tolerance: depths that differ by less are the same surface, world units.
        state: after the instant before.
        memory: see `ExposureCompensation`.
    """
    device = depths.device
    if state is None or state.index != index - 1:
        state = ExposureState(index)
    corner = lens_falloff.corner_of([target, *views.cameras])
    pairs = list(combinations(range(len(views.cameras)), 2))
    before = torch.zeros((), dtype=torch.float64, device=device) if state.slope is None else state.slope
    count = min(state.count + 1, memory)
    if not pairs:
        slope = before - before / count
        gains = torch.ones((len(views.cameras), 3), device=device)
        return Exposure(gains, slope, corner), ExposureState(index, state.ratios, count, slope)
    looks, mask, samples = _shared_looks(views, depths, tolerance, pairs)
    shared = mask.sum(dim=1) >= compensation.FEWEST  # (P,)
    slope = before + (_slope(looks, mask, shared, corner) - before) / count
    medians = masked_median(looks[..., :3] - slope.float() * looks[..., 3:], mask[..., None])  # (P, 3)
    names = [(views.cameras[j].name, views.cameras[k].name) for j, k in pairs]
    means, ratios = _remembered(names, medians.double(), shared, state.ratios, memory)
    log_gains = _solved(pairs, means, torch.where(shared, mask.sum(dim=1), 0).double(), samples.double())
    weights = view_weights(target, views.cameras, views.shares).astype(np.float64) ** compensation.GAUGE_POWER
    log_gains = log_gains - to_device(weights / weights.sum(), device, double=True) @ log_gains
    limit = compensation.LARGEST_LOG_GAIN
    return Exposure(torch.exp(-log_gains.clamp(-limit, limit)).float(), slope, corner), ExposureState(index, ratios, count, slope)


def compensate(views: DeviceViews, exposure: Exposure) -> Tensor:
    """Images of the views times their gains and without fall-off, (K, H, W, 3), uint8, as `flattened`."""
    images = torch.zeros_like(views.images)
    slope = exposure.slope
    for k, camera in enumerate(views.cameras):
        down, across = (to_device(each, slope.device, double=True) for each in lens_falloff.squared_tangents(camera))
        rows = torch.exp(-slope * down - (-slope * exposure.corner).clamp(min=0)).float()
        columns = torch.exp(-slope * across).float()
        image, out = views.layer(views.images, k), views.layer(images, k)
        launch(blend_kernels.shade, image.shape[:2], image, exposure.gains[k], rows, columns, out)
    return images


def show_fall_off(picture: Tensor, target: Camera, exposure: Exposure) -> Tensor:
    """A picture (3, H, W) of compensated sources as the target's lens would show it, as `fallen_off`."""
    slope = exposure.slope
    down, across = (to_device(each, slope.device, double=True) for each in lens_falloff.squared_tangents(target))
    rows = torch.exp(slope * down + (-slope * exposure.corner).clamp(min=0)).float()
    return (picture * rows[:, None] * torch.exp(slope * across).float()).clamp(max=1)


def _shared_looks(
    views: DeviceViews, depths: Tensor, tolerance: float, pairs: list[tuple[int, int]]
) -> tuple[Tensor, Tensor, Tensor]:
    """Of each pair, the log ratios and spans at the lattices of both, (P, 2 N, 4), which of them count, and points per pair."""
    lattices = [_lattice(views, depths, k) for k in range(len(views.cameras))]
    pictures, points, colours, usable = (_stacked([lattice[part] for lattice in lattices]) for part in range(4))
    directed = np.array([order for j, k in pairs for order in ((j, k), (k, j))])  # (2 P, 2)
    own, other = to_device(directed, depths.device).long().T
    ratios, mask = _log_ratios(views, depths, pictures, points[own], colours[own], directed, tolerance)
    signs = to_device(np.tile([1.0, -1.0], len(pairs)), depths.device)[:, None, None]
    samples = usable.sum(dim=1)
    counts = samples[own] + samples[other]
    return (signs * ratios).view(len(pairs), -1, 4), (mask & usable[own]).view(len(pairs), -1), counts[::2]


def _stacked(maps: list[Tensor]) -> Tensor:
    """Arrays beside each other, what is missing of the smaller ones filled with 0."""
    sizes = [max(lengths) for lengths in zip(*(each.shape for each in maps), strict=True)]
    stack = maps[0].new_zeros((len(maps), *sizes))
    for layer, each in zip(stack, maps, strict=True):
        layer[tuple(slice(length) for length in each.shape)] = each
    return stack


def _lattice(views: DeviceViews, depths: Tensor, k: int) -> tuple[Tensor, Tensor, Tensor, Tensor]:
    """A view's reduced image (h, w, 3), and of its lattice the points (N, 3), the colours' logarithms, and which are usable."""
    camera, device = views.cameras[k], depths.device
    image, depth = views.layer(views.images, k), views.layer(depths, k)
    height, width = (max(size // REDUCTION, 1) for size in (camera.height, camera.width))
    blocks = image[: height * REDUCTION, : width * REDUCTION].float()
    picture = blocks.view(height, REDUCTION, width, REDUCTION, 3).sum(dim=(1, 3)).div(REDUCTION**2).round()
    step = max(height // compensation.LATTICE_ROWS, 1)
    colours = picture[step // 2 :: step, step // 2 :: step]
    rows, columns = (torch.arange(count, device=device) * step + step // 2 for count in colours.shape[:2])
    v, u = (
        (REDUCTION * cells + REDUCTION // 2).clamp(max=size - 1)
        for cells, size in ((rows, camera.height), (columns, camera.width))
    )
    z = depth[v][:, u]
    across, down = (
        ((u.double() - camera.K[0, 2]) / camera.K[0, 0])[None],
        ((v.double() - camera.K[1, 2]) / camera.K[1, 1])[:, None],
    )
    points = torch.stack([(z * across).float(), (z * down).float(), z], dim=-1)
    usable = (z > 0) & _linear(colours)
    return picture, points.view(-1, 3), colours.clamp(min=1).log().reshape(-1, 3), usable.flatten()


def _linear(colours: Tensor) -> Tensor:
    return ((colours >= compensation.DARK) & (colours <= compensation.BRIGHT)).all(dim=-1)


def _log_ratios(
    views: DeviceViews,
    depths: Tensor,
    pictures: Tensor,
    points: Tensor,
    logarithms: Tensor,
    directed: NDArray[np.int64],
    tolerance: float,
) -> tuple[Tensor, Tensor]:
    """`log_ratios` of all ordered pairs at once: at the points of the first view's lattice, looked up in the second.

    Args:
        views: the sources.
        depths: their filtered depths.
        pictures: their reduced images, (K, h, w, 3).
        points: of the first view of each pair, (Q, N, 3).
        logarithms: of the colours there, (Q, N, 3).
        directed: the numbers of both views, (Q, 2).
        tolerance: as in `estimate_exposure`.

    Returns:
        (Q, N, 4), 0 where nothing counts, and what counts, (Q, N).
    """
    device, cameras = depths.device, [views.cameras[k] for k in directed[:, 1]]
    firsts = [views.cameras[k] for k in directed[:, 0]]
    transforms = to_device(np.stack([rigid_between(*pair) for pair in zip(firsts, cameras, strict=True)]), device)
    constants = [(*camera.K[[0, 1, 0, 1], [0, 1, 2, 2]], *camera.size) for camera in cameras]
    fx, fy, cx, cy, width, height = to_device(constants, device).T[..., None]  # (Q, 1) each
    number = to_device(directed[:, 1], device).long()[:, None]
    there = points @ transforms[:, :3, :3].transpose(1, 2) + transforms[:, None, :3, 3]
    z = torch.where(there[..., 2] > 0, there[..., 2], torch.inf)
    u, v = fx * there[..., 0] / z + cx, fy * there[..., 1] / z + cy
    inside = (u >= 0) & (u < width) & (v >= 0) & (v < height)
    column, row = (torch.minimum(at.clamp(min=0), size - 1).long() for at, size in ((u, width), (v, height)))
    agrees = inside & ((depths[number, row, column] - z).abs() < tolerance)
    small = ((size // REDUCTION).clamp(min=1) for size in (width, height))
    colours = _sampled(pictures, number, u / REDUCTION - 0.5, v / REDUCTION - 0.5, *small)
    mask = agrees & _linear(colours)
    spans = _squared_tangents(points[..., 0], points[..., 1], points[..., 2]) - _squared_tangents(there[..., 0], there[..., 1], z)
    ratios = torch.cat([logarithms - colours.clamp(min=1).log(), spans[..., None]], dim=-1)
    return torch.where(mask[..., None], ratios, 0.0), mask


def _squared_tangents(x: Tensor, y: Tensor, z: Tensor) -> Tensor:
    return (x.square() + y.square()) / z.square()


def _sampled(images: Tensor, number: Tensor, x: Tensor, y: Tensor, width: Tensor, height: Tensor) -> Tensor:
    """Bilinear samples, (Q, N, 3), of images of these sizes within a stack, see `exposure_compensation.sampled`."""
    zero = torch.zeros_like(width)
    x, y = torch.minimum(x.clamp(min=0), width - 1), torch.minimum(y.clamp(min=0), height - 1)
    left, top = (
        torch.minimum(x.floor(), torch.maximum(width - 2, zero)),
        torch.minimum(y.floor(), torch.maximum(height - 2, zero)),
    )
    right, bottom = torch.minimum(left + 1, width - 1).long(), torch.minimum(top + 1, height - 1).long()
    across, down = (x - left)[..., None], (y - top)[..., None]
    left, top = left.long(), top.long()
    upper = images[number, top, left] + across * (images[number, top, right] - images[number, top, left])
    lower = images[number, bottom, left] + across * (images[number, bottom, right] - images[number, bottom, left])
    return upper + down * (lower - upper)


def _slope(looks: Tensor, mask: Tensor, shared: Tensor, corner: float) -> Tensor:
    """The fall-off that the pairs of an instant share, see `fit_slope` and `shared_slope`, (), float64."""
    x, y = looks[..., 3].double() / corner, looks[..., :3].mean(dim=-1).double()
    y = y - masked_median(y[..., None], mask[..., None])
    weights = mask.double()
    slopes = evidence = torch.zeros(len(looks), dtype=torch.float64, device=looks.device)
    for _ in range(lens_falloff.ROUNDS):
        total = weights.sum(dim=1, keepdim=True).clamp(min=1e-30)
        from_mean, up = x - (weights * x).sum(1, keepdim=True) / total, y - (weights * y).sum(1, keepdim=True) / total
        evidence = (weights * from_mean.square()).sum(dim=1)
        slopes = (weights * from_mean * up).sum(dim=1) / evidence.clamp(min=1e-12)
        residuals = (up - slopes[:, None] * from_mean).abs()
        kept = torch.where(residuals < 4 * lens_falloff.NOISE, lens_falloff.NOISE / residuals.clamp(min=lens_falloff.NOISE), 1e-9)
        weights = kept * mask
    weights = evidence * shared
    mean = (weights * slopes).sum() / (weights.sum() + lens_falloff.PRIOR)
    alike = weights.sum().square() / weights.square().sum().clamp(min=1e-12)
    variance = (weights * (slopes - mean).square()).sum() / (weights.sum() + lens_falloff.PRIOR) / (alike - 1).clamp(min=0.5)
    doubt = lens_falloff.LEAST**2 + 4 * variance
    certain = (shared.sum() >= 2) & (mean.square() > doubt)
    return torch.where(certain, mean * (1 - doubt / mean.square()) / corner, 0.0)


def _remembered(
    names: list[tuple[str, str]],
    ratios: Tensor,
    shared: Tensor,
    before: Mapping[tuple[str, str], tuple[Tensor, Tensor]],
    memory: int,
) -> tuple[Tensor, dict[tuple[str, str], tuple[Tensor, Tensor]]]:
    """Mean log ratio of each pair, (P, 3), and what is remembered of all pairs; what was not measured now stays."""
    keys = [(min(pair), max(pair)) for pair in names]
    signs = to_device([[-1.0 if first > second else 1.0] for first, second in names], ratios.device).double()
    nothing = torch.zeros((), dtype=torch.float64, device=ratios.device), ratios.new_zeros(3)
    counts = torch.stack([before.get(key, nothing)[0] for key in keys])
    means = torch.stack([before.get(key, nothing)[1] for key in keys])
    counts = torch.where(shared, (counts + 1).clamp(max=memory), counts)
    change = (signs * ratios - means) / counts.clamp(min=1)[:, None]
    means = torch.where(shared[:, None], means + change, means)
    return signs * means, {**before, **{key: (counts[n], means[n]) for n, key in enumerate(keys)}}


def _solved(pairs: list[tuple[int, int]], means: Tensor, looks: Tensor, samples: Tensor) -> Tensor:
    """Logarithm of every source's gain, (K, 3): weighted least squares over all pairs."""
    views = max(k for _, k in pairs) + 1
    incidence = np.zeros((len(pairs), views))
    for n, (j, k) in enumerate(pairs):
        incidence[n, j], incidence[n, k] = 1, -1
    signs = to_device(incidence, means.device, double=True)
    weights = (looks / samples.clamp(min=1))[:, None]
    normal = compensation.PRIOR * torch.eye(views, dtype=torch.float64, device=means.device) + signs.T @ (weights * signs)
    return torch.linalg.solve_ex(normal, signs.T @ (weights * means))[0]
