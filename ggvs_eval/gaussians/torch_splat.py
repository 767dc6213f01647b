"""The splat in torch: Gaussians projected to ellipses as in 3D Gaussian splatting, and blended
front to back, tile by tile.

It is readable, the reference of the compiled kernel, and the path on a GPU.

Autograd differentiates it. Any float, so that its gradients can be compared with finite differences
in double precision.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from math import log

import torch
from torch.utils.checkpoint import checkpoint

from ggvs_eval.camera import Camera
from ggvs_eval.gaussians.cloud import GaussianCloud, harmonic_colours

# added to both variances in the image, so that no Gaussian falls between the pixels
LOW_PASS_PX2 = 0.3
LEAST_COMPENSATION = 0.005  # of an antialiased cloud's opacities
LEAST_ALPHA = 1 / 255  # what covers less of a pixel does not touch it
# of half the image's extent: by how far outside the slopes of the Jacobian are held
SLOPE_MARGIN = 0.3
TILE = 16  # pixels, across and down
MOST_ALPHA = 0.99
LEAST_TRANSMITTANCE = 1e-4  # a pixel stops before the Gaussian that would reduce it below this
MOST_AT_ONCE = 8_000_000  # pairs of pixel and Gaussian, which bounds the memory


@dataclass(frozen=True, eq=False)
class Ellipses:
    """Gaussians in an image; rows of Gaussians that are not visible are without meaning.

    Attributes:
        centres: pixel index coordinates (integers are pixel centres), (N, 2).
        conics: a, b, c of the quadratic form a dx^2 + 2 b dx dy + c dy^2 of the inverse covariance,
            (N, 3).
        reach: half extents of the box outside of which alpha is below 1/255, pixels, (N, 2).
        radii: 3 standard deviations along the longer axis, rounded up, pixels, 0 where not visible,
            (N,) int32.
        opacities: (N,), in (0, 1).
        colours: as seen from the camera, (N, 3), not below 0.
        depths: z of the centres in the camera, (N,).
        visible: (N,), True if a Gaussian touches the image.
    """

    centres: torch.Tensor
    conics: torch.Tensor
    reach: torch.Tensor
    radii: torch.Tensor
    opacities: torch.Tensor
    colours: torch.Tensor
    depths: torch.Tensor
    visible: torch.Tensor


def project(cloud: GaussianCloud, camera: Camera, near: float) -> Ellipses:
    """Project every Gaussian: cov2d = J W Sigma W^T J^T + 0.3 I, with the Jacobian J of the pinhole
    K at the Gaussian's centre.

    Args:
        near: Gaussians at or before this depth are left out, world units.

    Reading:
        The reference builds its projection from fields of view and holds the slopes x/z and y/z of
        the Jacobian within 1.3 tan(fov / 2). With the principal point off the middle the same
        margin is kept beyond each border of the image: for a principal point in the middle both are
        the same.
    """
    centre = torch.tensor(camera.centre, dtype=cloud.means.dtype, device=cloud.means.device)
    centres, z, in_front, (var_x, var_y, covariance, plain) = _shadows(cloud, camera, near)
    determinant = _low_passed(var_x, var_y, plain)
    var_x, var_y = var_x + LOW_PASS_PX2, var_y + LOW_PASS_PX2
    conics = torch.stack([var_y, -covariance, var_x], -1) / determinant[:, None]

    opacities = cloud.opacity_logits.sigmoid()
    # alpha = o exp(-q / 2) >= 1/255 holds up to q = 2 ln(255 o); the bound is a little generous,
    # alpha itself decides.
    furthest = (2 * (opacities.detach().log() - log(LEAST_ALPHA)) + 0.01).clamp_min(0)
    reach = (furthest[:, None] * torch.stack([var_x, var_y], -1).detach()).sqrt()
    last = torch.tensor([camera.width - 1, camera.height - 1], device=reach.device)
    inside = ((centres.detach() + reach >= 0) & (centres.detach() - reach <= last)).all(-1)
    visible = in_front & inside & (opacities >= LEAST_ALPHA) & determinant.isfinite()
    radii = torch.where(
        visible, _radii(var_x.detach(), var_y.detach(), determinant.detach()), 0
    ).to(torch.int32)

    directions = torch.nn.functional.normalize(cloud.means - centre, dim=-1)
    seen_colours = harmonic_colours(cloud.sh, directions)
    return Ellipses(
        centres=centres,
        conics=conics,
        reach=reach,
        radii=radii,
        opacities=opacities,
        colours=seen_colours,
        depths=z,
        visible=visible,
    )


def _shadows(
    cloud: GaussianCloud, camera: Camera, near: float
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, tuple[torch.Tensor, ...]]:
    """Return centres in the image, z, what is in front, and var_x, var_y, covariance and
    determinant before the low pass.
    """
    rotation, shift = (
        torch.tensor(part, dtype=cloud.means.dtype, device=cloud.means.device)
        for part in (camera.rotation, camera.translation)
    )
    x, y, z = (cloud.means @ rotation.T + shift).unbind(-1)
    in_front = z > near
    z = torch.where(in_front, z, 1)  # what is left out can be at 0
    fx, fy, cx, cy = (float(camera.K[at]) for at in ((0, 0), (1, 1), (0, 2), (1, 2)))
    # pixel centres at integers
    centres = torch.stack([fx * x / z + (cx - 0.5), fy * y / z + (cy - 0.5)], -1)

    slope_x, slope_y = _held(x / z, fx, cx, camera.width), _held(y / z, fy, cy, camera.height)
    zero = torch.zeros_like(z)
    jacobian = torch.stack(
        [fx / z, zero, -fx * slope_x / z, zero, fy / z, -fy * slope_y / z], -1
    ).reshape(-1, 2, 3)
    # (N, 3, 3): columns are the axes, of their lengths
    axes = rotations(cloud.quaternions) * cloud.log_scales.exp()[:, None, :]
    # (N, 3) each: cov2d is the matrix of their products
    row_x, row_y = (jacobian @ rotation @ axes).unbind(1)
    var_x, var_y = (row_x * row_x).sum(-1), (row_y * row_y).sum(-1)
    covariance = (row_x * row_y).sum(-1)
    # Lagrange's identity for var_x var_y - covariance^2, which would cancel for thin Gaussians.
    plain = torch.linalg.cross(row_x, row_y, dim=-1).square().sum(-1)
    return centres, z, in_front, (var_x, var_y, covariance, plain)


def _low_passed(var_x: torch.Tensor, var_y: torch.Tensor, plain: torch.Tensor) -> torch.Tensor:
    """Return the determinant after the low pass."""
    return plain + LOW_PASS_PX2 * (var_x + var_y) + LOW_PASS_PX2**2


def compensated(cloud: GaussianCloud, camera: Camera, near: float) -> GaussianCloud:
    """Return an antialiased cloud as a plain one of a camera: opacities times sqrt(det S / det(S +
    0.3 I)).

    Reading:
        The factor is at least 0.005, as 3D Gaussian splatting holds it; gsplat lets it fall to 0,
        which a pixel of 8 bits shows in neither case.
    """
    _, _, _, (var_x, var_y, _, plain) = _shadows(cloud, camera, near)
    factor = (plain / _low_passed(var_x, var_y, plain)).clamp_min(LEAST_COMPENSATION**2).sqrt()
    return GaussianCloud(
        **cloud.parameters()
        | {"opacity_logits": torch.logit(cloud.opacity_logits.sigmoid() * factor)}
    )


def rotations(quaternions: torch.Tensor) -> torch.Tensor:
    """Return the rotation matrices of quaternions of any length but 0, w first: (N, 4) -> (N, 3,
    3).
    """
    w, x, y, z = torch.nn.functional.normalize(quaternions, dim=-1).unbind(-1)
    rows = [
        *(1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)),
        *(2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)),
        *(2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)),
    ]
    return torch.stack(rows, -1).reshape(-1, 3, 3)


def _held(slope: torch.Tensor, focal: float, principal: float, size: int) -> torch.Tensor:
    margin = SLOPE_MARGIN * size / (2 * focal)
    return slope.clamp(-principal / focal - margin, (size - principal) / focal + margin)


def _radii(var_x: torch.Tensor, var_y: torch.Tensor, determinant: torch.Tensor) -> torch.Tensor:
    middle = (var_x + var_y) / 2
    largest = middle + (middle * middle - determinant).clamp_min(0.1).sqrt()
    return (3 * largest.sqrt()).ceil().clamp_max(2**30)


def splat(
    cloud: GaussianCloud, camera: Camera, near: float, screen_offsets: torch.Tensor | None
) -> tuple[torch.Tensor, torch.Tensor, torch.Tensor, torch.Tensor]:
    """Render without a background.

    Args:
        near: Gaussians at or before this depth are left out, world units.
        screen_offsets: added to the centres in the image, pixels, (N, 2); or None.

    Returns:
        Sums of colour (H, W, 3) weighted by what each Gaussian covers, transmittance (H, W) to what
        is behind all, sums of depth (H, W), weighted in the same way, and radii in pixels, (N,)
        int32.

    Reading:
        A Gaussian ends where its alpha falls below 1/255. The reference cuts it also at the border
        of the 16-pixel tiles that a square of 3 standard deviations touches, so that its picture
        depends on how the image is cut. Equal depths keep the order of the cloud.
    """
    ellipses = project(cloud, camera, near)
    centres = ellipses.centres if screen_offsets is None else ellipses.centres + screen_offsets
    across, down = -(-camera.width // TILE), -(-camera.height // TILE)
    tiles = cloud.means.new_zeros(across * down, TILE * TILE, 5)
    tiles[..., 4] = 1  # transmittance
    with torch.no_grad():
        numbers, starts = _listed(ellipses, across, down)
    shape = torch.cat(
        [
            centres,
            ellipses.conics,
            ellipses.opacities[:, None],
            ellipses.colours,
            ellipses.depths[:, None],
        ],
        -1,
    )  # (N, 10)
    groups, blended = [], []
    for group, lists in _groups(numbers, starts):
        groups.append(group)
        blended.append(checkpoint(_blend, shape, lists, group, across, use_reentrant=False))
    tiles = tiles + shape[:0].sum()  # gradients are 0, not absent, where nothing is visible
    if groups:
        tiles = tiles.index_copy(0, torch.cat(groups), torch.cat(blended))
    picture = (
        tiles.reshape(down, across, TILE, TILE, 5)
        .transpose(1, 2)
        .reshape(down * TILE, across * TILE, 5)
    )
    picture = picture[: camera.height, : camera.width]
    return picture[..., :3], picture[..., 4], picture[..., 3], ellipses.radii


def _listed(ellipses: Ellipses, across: int, down: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Numbers of the Gaussians that each tile lists, nearest first, tile after tile.

    And where each tile's list starts.
    """
    order = torch.argsort(ellipses.depths, stable=True)
    order = order[ellipses.visible[order]]
    last = torch.tensor([across - 1, down - 1], device=order.device)
    low = ((ellipses.centres - ellipses.reach)[order] / TILE).clamp_min(0).long()
    high = torch.minimum(
        ((ellipses.centres + ellipses.reach)[order] / TILE).clamp_max(2.0**30).long(), last
    )
    width = high[:, 0] - low[:, 0] + 1
    counts = width * (high[:, 1] - low[:, 1] + 1)
    pair = torch.repeat_interleave(torch.arange(len(order), device=order.device), counts)
    within = torch.arange(len(pair), device=order.device) - (counts.cumsum(0) - counts)[pair]
    tile = (low[pair, 1] + within // width[pair]) * across + low[pair, 0] + within % width[pair]
    starts = torch.zeros(across * down + 1, dtype=torch.long, device=order.device)
    starts[1:] = torch.bincount(tile, minlength=across * down).cumsum(0)
    return order[pair[torch.argsort(tile, stable=True)]], starts


def _groups(
    numbers: torch.Tensor, starts: torch.Tensor
) -> Iterator[tuple[torch.Tensor, torch.Tensor]]:
    """Yield the tiles with lists of like lengths: the tiles' numbers (G,), and their lists (G, M),
    filled up with -1.
    """
    lengths = starts.diff()
    order = torch.argsort(lengths, descending=True)
    in_order = lengths[order].tolist()
    first, filled = 0, sum(length > 0 for length in in_order)
    while first < filled:
        longest = in_order[first]
        size = min(max(1, MOST_AT_ONCE // (longest * TILE * TILE)), filled - first)
        while in_order[first + size - 1] < longest // 2:  # much shorter lists wait for their like
            size = max(1, size // 2)
        group = order[first : first + size]
        places = torch.arange(longest, device=numbers.device)
        listed = numbers[(starts[group, None] + places).clamp_max(len(numbers) - 1)]
        yield group, torch.where(places < lengths[group, None], listed, -1)
        first += size


def _blend(
    shape: torch.Tensor, lists: torch.Tensor, tiles: torch.Tensor, across: int
) -> torch.Tensor:
    """Blend the listed Gaussians of some tiles: sums of colour and depth, and transmittance, (G, P,
    5).
    """
    u, v, xx, xy, yy, opacity, *_ = shape[lists].unbind(-1)  # (G, M) each
    pixel = torch.arange(TILE * TILE, device=shape.device)
    columns = (tiles % across * TILE)[:, None] + pixel % TILE  # (G, P)
    rows = (tiles // across * TILE)[:, None] + pixel // TILE
    dx, dy = columns[:, None] - u[..., None], rows[:, None] - v[..., None]  # (G, M, P)
    quadratic = xx[..., None] * dx * dx + 2 * xy[..., None] * dx * dy + yy[..., None] * dy * dy
    alpha = (opacity[..., None] * torch.exp(-quadratic.clamp_min(0) / 2)).clamp_max(MOST_ALPHA)
    alpha = torch.where((alpha >= LEAST_ALPHA) & (lists >= 0)[..., None], alpha, 0)
    alpha = torch.where(torch.cumprod(1 - alpha.detach(), 1) >= LEAST_TRANSMITTANCE, alpha, 0)
    transmittance = torch.cumprod(1 - alpha, 1)
    weights = alpha * torch.cat([torch.ones_like(alpha[:, :1]), transmittance[:, :-1]], 1)
    sums = torch.einsum("gmp,gmc->gpc", weights, shape[lists][..., 6:])
    return torch.cat([sums, transmittance[:, -1, :, None]], -1)
