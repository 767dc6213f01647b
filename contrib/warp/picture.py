"""From registered views to a picture: maps and channels of the network's size, push-pull, and
composition (Eqs. 4-5).
"""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from ggvs_eval.contrib.warp.constants import FAR, StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch
from ggvs_eval.contrib.warp.network import DeviceNetwork
from ggvs_eval.contrib.warp.splat import DeviceSplats
from ggvs_eval.contrib.warp.tables import (
    Corners,
    Tables,
    corners_around,
    enlarged_place,
    masked_median,
)
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online import refiner
from ggvs_eval.pipelines.online.blend_network import SURE
from ggvs_eval.pipelines.online.network_inputs import channel_count

wp.set_module_options(MODULE_OPTIONS)

_SURE = wp.constant(wp.float32(SURE))
_LEAST_WEIGHT = wp.constant(wp.float32(refiner.NO_WEIGHT))
_LEAST_LENGTH = wp.constant(wp.float32(1e-12))
_COVERED = wp.constant(wp.float32(COVERED_ALPHA))
_COLOUR_GAIN = wp.constant(wp.float32(refiner.COLOUR_GAIN))


@dataclass(frozen=True, eq=False)
class DeviceMaps:
    """The K views registered in the target's view, as `BlendMaps`.

    Attributes:
        colours: (K, 3, H, W).
        coverage: how far a view shows anything to blend, (K, H, W).
        visibilities: how far it shows what the target sees, (K, H, W).
        splats: of the same views.
        fused: depth, (H, W), world units, 0 where unknown.
    """

    colours: Tensor
    coverage: Tensor
    visibilities: Tensor
    splats: DeviceSplats
    fused: Tensor


@wp.kernel
def reduce_maps(
    colours: wp.array4d[wp.float32],
    coverage: wp.array3d[wp.float32],
    visibilities: wp.array3d[wp.float32],
    alphas: wp.array3d[wp.float32],
    depths: wp.array3d[wp.float32],
    fused: wp.array2d[wp.float32],
    scale: wp.int32,
    top: wp.int32,
    left: wp.int32,
    out: wp.array4d[wp.float32],
    picked: wp.array3d[wp.float32],
):
    """Means of blocks, and one depth of each; the last row and column are repeated."""
    k, y, x = wp.tid()
    height = coverage.shape[1]
    width = coverage.shape[2]
    sums = wp.vec3f()
    flat = wp.vec3f()
    for v in range(scale):
        row = wp.min(y * scale + v, height - 1)
        for u in range(scale):
            column = wp.min(x * scale + u, width - 1)
            sums += wp.vec3f(
                colours[k, 0, row, column], colours[k, 1, row, column], colours[k, 2, row, column]
            )
            flat += wp.vec3f(
                coverage[k, row, column], visibilities[k, row, column], alphas[k, row, column]
            )
    count = wp.float32(scale * scale)
    for c in range(3):
        out[k, c, y, x] = sums[c] / count
        out[k, 3 + c, y, x] = flat[c] / count
    rows = (height - top + scale - 1) // scale
    columns = (width - left + scale - 1) // scale
    row = top + wp.min(y, rows - 1) * scale
    column = left + wp.min(x, columns - 1) * scale
    picked[k, y, x] = depths[k, row, column]
    if k == 0:
        picked[coverage.shape[0], y, x] = fused[row, column]


@wp.func
def surface_point(
    fused: wp.array2d[wp.float32],
    pinhole: wp.array[wp.float64],
    far: wp.float32,
    y: wp.int32,
    x: wp.int32,
) -> wp.vec3f:
    """Point of the surface in the target's frame; on the far plane where it is unknown."""
    z = fused[y, x]
    if not (z > 0.0):
        z = far
    across = wp.float32((wp.float64(x) + wp.float64(0.5) - pinhole[2]) / pinhole[0])
    down = wp.float32((wp.float64(y) + wp.float64(0.5) - pinhole[3]) / pinhole[1])
    return wp.vec3f(z * across, z * down, z)


@wp.func
def unit(v: wp.vec3f) -> wp.vec3f:
    """Vector of length 1."""
    return v / wp.max(wp.sqrt(v[0] * v[0] + v[1] * v[1] + v[2] * v[2]), _LEAST_LENGTH)


@wp.func
def inverse(depth: wp.float32, length: wp.float32) -> wp.float32:
    """Return a length over a depth, 0 if that is unknown."""
    value = wp.float32(0.0)
    if depth > 0.0:
        value = length / depth
    return value


@wp.kernel
def network_channels(
    maps: wp.array4d[wp.float32],
    depths: wp.array3d[wp.float32],
    pinhole: wp.array[wp.float64],
    numbers: wp.array[wp.float32],
    median: wp.array[wp.float32],
    centres: wp.array2d[wp.float32],
    distances: wp.array[wp.float32],
    axes: wp.array[wp.float32],
    places: wp.array[wp.int32],
    most: wp.int32,
    registered: wp.bool,
    out: wp.array3d[wp.float32],
):
    """The groups of `input_channels` of every view.

    `maps` and `depths` are those of `reduced_maps`.
    """
    y, x = wp.tid()
    views = maps.shape[0]
    height = depths.shape[1]
    width = depths.shape[2]
    fused = depths[views]
    length = median[0]
    if not (length > 0.0):
        length = numbers[FAR]
    upper = wp.max(y - 1, 0)
    lower = wp.min(y + 1, height - 1)
    left = wp.max(x - 1, 0)
    right = wp.min(x + 1, width - 1)
    far = numbers[FAR]
    # A power of two rounds nothing, and scales lengths to about 1. Its bits are those of an
    # exponent.
    per = wp.cast((254 - (wp.cast(length, wp.int32) >> 23)) << 23, wp.float32)
    point = per * surface_point(fused, pinhole, far, y, x)
    along_column = per * surface_point(fused, pinhole, far, lower, x) - per * surface_point(
        fused, pinhole, far, upper, x
    )
    along_row = per * surface_point(fused, pinhole, far, y, right) - per * surface_point(
        fused, pinhole, far, y, left
    )
    normal = unit(wp.cross(along_column, along_row))
    away = wp.dot(normal, point)
    facing = wp.float32(0.0)
    around = (
        fused[y, left] > 0.0
        and fused[y, right] > 0.0
        and fused[upper, x] > 0.0
        and fused[lower, x] > 0.0
    )
    if fused[y, x] > 0.0 and around:
        if away < 0.0:
            facing = wp.float32(1.0)
        elif away > 0.0:
            facing = wp.float32(-1.0)
    back = unit(-point)
    out[5 * most, y, x] = inverse(fused[y, x], length)
    for k in range(views):
        n = places[k]
        if n >= 0:
            direction = unit(per * wp.vec3f(centres[k, 0], centres[k, 1], centres[k, 2]) - point)
            for c in range(3):
                out[3 * n + c, y, x] = maps[k, c, y, x]
            out[3 * most + n, y, x] = inverse(depths[k, y, x], length)
            out[4 * most + n, y, x] = maps[k, 5, y, x]
            out[5 * most + 1 + n, y, x] = wp.dot(direction, normal) * facing
            out[6 * most + 1 + n, y, x] = wp.dot(direction, back)
            out[7 * most + 1 + n, y, x] = distances[k] / length
            out[8 * most + 1 + n, y, x] = axes[k]
            if registered:
                out[9 * most + 1 + n, y, x] = maps[k, 4, y, x]


@wp.kernel
def give_places(
    coverage: wp.array[wp.float32], places: wp.array[wp.int32], order: wp.array[wp.int32]
):
    """Places of the views at the network, and the view of each.

    One that covers no pixel has none, unless none does.
    """
    wp.tid()
    views = coverage.shape[0]
    largest = wp.float32(0.0)
    for k in range(views):
        largest = wp.max(largest, coverage[k])
        order[k] = -1
    n_places = wp.int32(0)
    for k in range(views):
        places[k] = -1
        if coverage[k] >= _COVERED or largest < _COVERED:
            places[k] = n_places
            order[n_places] = k
            n_places += 1


@wp.kernel
def share_out(
    small: wp.array3d[wp.float32],
    maps: wp.array4d[wp.float32],
    places: wp.array[wp.int32],
    out: wp.array3d[wp.float32],
):
    """Share of each view in the picture, see `view_shares` of the network blender."""
    y, x = wp.tid()
    views = maps.shape[0]
    total = wp.float32(0.0)
    visible = wp.float32(0.0)
    for k in range(views):
        if places[k] >= 0:
            total += small[y, x, places[k]] * maps[k, 3, y, x]
            visible += maps[k, 4, y, x]
    unseen = wp.clamp(1.0 - wp.min(visible, 1.0), _SURE, 1.0 - _SURE)
    behind = 1.0 / (1.0 + wp.exp(-small[y, x, views]) * (1.0 - unseen) / unseen)
    for k in range(views):
        out[k, y, x] = 0.0
        if places[k] >= 0:
            out[k, y, x] = (
                small[y, x, places[k]]
                * maps[k, 3, y, x]
                * ((1.0 - behind) / wp.max(total, _LEAST_WEIGHT))
            )


@wp.kernel
def average_known(
    colours: wp.array3d[wp.float32],
    certainty: wp.array2d[wp.float32],
    rows: wp.array3d[wp.int32],
    row_shares: wp.array3d[wp.float32],
    columns: wp.array3d[wp.int32],
    column_shares: wp.array3d[wp.float32],
    coarse: wp.array3d[wp.float32],
    coarse_known: wp.array2d[wp.float32],
):
    """Push: mean of what is known in a cell, and four times its share; colours are (3, H, W)."""
    y, x = wp.tid()
    total = wp.vec3f()
    weight = wp.float32(0.0)
    for row in range(rows[0, y, 0], rows[0, y, 1]):
        for column in range(columns[0, x, 0], columns[0, x, 1]):
            if certainty[row, column] > 0.0:
                share = (
                    row_shares[0, y, row - rows[0, y, 0]]
                    * column_shares[0, x, column - columns[0, x, 0]]
                    * certainty[row, column]
                )
                weight += share
                total += share * wp.vec3f(
                    colours[0, row, column], colours[1, row, column], colours[2, row, column]
                )
    for c in range(3):
        coarse[c, y, x] = total[c] / wp.max(weight, 1e-6)
    coarse_known[y, x] = wp.min(4.0 * weight, 1.0)


@wp.kernel
def fill_unknown(
    colours: wp.array3d[wp.float32],
    certainties: wp.array2d[wp.float32],
    is_complete: wp.array[wp.bool],
    coarse: wp.array3d[wp.float32],
    rows: wp.array2d[wp.int32],
    row_shares: wp.array[wp.float32],
    columns: wp.array2d[wp.int32],
    column_shares: wp.array[wp.float32],
    out: wp.array3d[wp.float32],
):
    """Pull: unknown pixels take the interpolated coarse colour as far as they are unknown.

    None if all are known.
    """
    y, x = wp.tid()
    certainty = certainties[y, x]
    fx = column_shares[x]
    fy = row_shares[y]
    for c in range(3):
        colour = colours[c, y, x]
        if is_complete[0] or certainty >= 1.0:
            out[c, y, x] = colour
        else:
            upper = coarse[c, rows[y, 0], columns[x, 0]]
            upper += fx * (coarse[c, rows[y, 0], columns[x, 1]] - upper)
            lower = coarse[c, rows[y, 1], columns[x, 0]]
            lower += fx * (coarse[c, rows[y, 1], columns[x, 1]] - lower)
            filled = upper + fy * (lower - upper)
            if certainty > 0.0:
                filled += certainty * (colour - filled)
            out[c, y, x] = filled


@wp.kernel
def mean_of_views(
    colours: wp.array4d[wp.float32],
    coverage: wp.array3d[wp.float32],
    alphas: wp.array3d[wp.float32],
    weights: wp.array[wp.float32],
    places: wp.array[wp.int32],
    out: wp.array3d[wp.float32],
    covered: wp.array2d[wp.float32],
):
    """Source of the background: the geometric mean of the views, and their coverage."""
    y, x = wp.tid()
    total = wp.float32(0.0)
    sums = wp.vec3f()
    covers = wp.float32(0.0)
    for k in range(coverage.shape[0]):
        w = wp.where(places[k] >= 0, weights[k], 0.0) * coverage[k, y, x]
        total += w
        sums += w * wp.vec3f(colours[k, 0, y, x], colours[k, 1, y, x], colours[k, 2, y, x])
        if alphas[k, y, x] > _COVERED:
            covers = wp.float32(1.0)
    for c in range(3):
        out[c, y, x] = sums[c] / wp.max(total, _LEAST_WEIGHT)
    covered[y, x] = covers


@wp.func
def blended(small: wp.array3d[wp.float32], q: Corners, channel: wp.int32):
    """A channel of a small map (h, w, C) between the four corners."""
    upper = (1.0 - q.fy) * (1.0 - q.fx) * small[q.y0, q.x0, channel] + (1.0 - q.fy) * q.fx * small[
        q.y0, q.x1, channel
    ]
    return (
        upper
        + q.fy * (1.0 - q.fx) * small[q.y1, q.x0, channel]
        + q.fy * q.fx * small[q.y1, q.x1, channel]
    )


@wp.kernel
def compose(
    colours: wp.array4d[wp.float32],
    coverage: wp.array3d[wp.float32],
    visibilities: wp.array3d[wp.float32],
    background: wp.array3d[wp.float32],
    depth: wp.array2d[wp.float32],
    small: wp.array3d[wp.float32],
    places: wp.array[wp.int32],
    scale: wp.int32,
    image: wp.array3d[wp.float32],
    spread: wp.array2d[wp.float32],
    coverages: wp.array2d[wp.float32],
    logarithm: wp.array2d[wp.float32],
):
    """Views over the background (Eqs. 4-5), their spread, how many show the pixel, and the depth's
    logarithm.
    """
    y, x = wp.tid()
    views = coverage.shape[0]
    per = 1.0 / wp.float32(scale)
    q = corners_around(
        enlarged_place(y, per), enlarged_place(x, per), small.shape[0], small.shape[1]
    )
    total = wp.float32(0.0)
    visible = wp.float32(0.0)
    coverage_sum = wp.float32(0.0)
    sums = wp.vec3f()
    for k in range(views):
        n = places[k]
        if n >= 0:
            w = blended(small, q, n)
            w *= coverage[k, y, x]
            total += w
            coverage_sum += coverage[k, y, x]
            visible += visibilities[k, y, x]
            sums += w * wp.vec3f(colours[k, 0, y, x], colours[k, 1, y, x], colours[k, 2, y, x])
    bounded = wp.max(total, _LEAST_WEIGHT)
    unseen = wp.clamp(1.0 - wp.min(visible, 1.0), _SURE, 1.0 - _SURE)
    sure = blended(small, q, views)
    behind = 1.0 / (1.0 + wp.exp(-(sure + wp.log(unseen / (1.0 - unseen)))))
    colour = wp.vec3f()
    for i in range(3):
        s = views + 1 + i
        change = blended(small, q, s)
        behind_colour = wp.clamp(background[i, y, x] + change, 0.0, 1.0)
        front = sums[i] / bounded
        colour[i] = front + behind * (behind_colour - front)
        image[i, y, x] = colour[i]
    squares = wp.float32(0.0)
    for k in range(views):
        n = places[k]
        if n >= 0:
            w = blended(small, q, n)
            off = wp.vec3f(colours[k, 0, y, x], colours[k, 1, y, x], colours[k, 2, y, x]) - colour
            squares += w * coverage[k, y, x] * (wp.dot(off, off) / 3.0)
    spread[y, x] = _COLOUR_GAIN * wp.sqrt(squares / bounded)
    coverages[y, x] = coverage_sum
    value = wp.float32(0.0)
    if depth[y, x] > 0.0:
        value = wp.log(depth[y, x])
    logarithm[y, x] = value


def fill_holes(colours: Tensor, certainty: Tensor, t: Tables) -> Tensor:
    """Fill what is not known, (H, W), of a picture (3, H, W) from ever coarser averages, as the
    compiled `push_pull`.
    """
    height, width = certainty.shape
    if min(height, width) < 2:
        return colours
    small, device = ((height + 1) // 2, (width + 1) // 2), certainty.device
    coarse, coarse_known = (
        torch.empty((3, *small), device=device),
        torch.empty(small, device=device),
    )
    cells = (*t.area_cells((height,), small[:1]), *t.area_cells((width,), small[1:]))
    launch(average_known, small, colours, certainty, *cells, coarse, coarse_known)
    between = (*t.between_cells(height, small[0]), *t.between_cells(width, small[1]))
    out = torch.empty_like(colours)
    # stays on the device: what is not needed is computed, and not looked at
    is_complete = (certainty > 0).all()[None]
    launch(
        fill_unknown,
        certainty.shape,
        colours,
        certainty,
        is_complete,
        fill_holes(coarse, coarse_known, t),
        *between,
        out,
    )
    return out


def reduced_maps(maps: DeviceMaps, t: Tables) -> tuple[Tensor, Tensor]:
    """Colours, coverages, visibilities and alphas at the network's size, (K, 6, h, w), and depths,
    the fused one last.
    """
    (width, height), scale, views = t.sizes.network, t.sizes.scale, len(maps.colours)
    means, picked = (
        torch.empty(size, device=maps.fused.device)
        for size in ((views, 6, height, width), (views + 1, height, width))
    )
    corner = (min(scale // 2, length - 1) for length in maps.fused.shape)
    stacks = (
        maps.colours,
        maps.coverage,
        maps.visibilities,
        maps.splats.alphas,
        maps.splats.depths,
        maps.fused,
    )
    launch(reduce_maps, (views, height, width), *stacks, scale, *corner, means, picked)
    return means, picked


def input_channels(
    means: Tensor, depths: Tensor, places: Tensor, registered: bool, most: int, c: StepConstants
) -> Tensor:
    """Return the input channels of the network, (channels, h, w), see `input_channels` of the
    compiled path.

    Args:
        means, depths: by `reduced_maps`.
        places: of the views at the network, (K,), int32, see `give_places`.
        registered: with group 9, ``registered`` guidance; else ``channels``.
        most: how many views the network is made for.
    """
    fused = depths[-1]
    channels = channel_count(most, "registered" if registered else "channels")
    out = torch.zeros((channels, *fused.shape), device=fused.device)
    maps = (
        means,
        depths,
        c.small_target,
        c.numbers,
        masked_median(fused, fused > 0),
        c.centres,
        c.distances,
        c.axes,
        places,
    )
    launch(network_channels, fused.shape, *maps, most, registered, out)
    return out


def blend_views(
    network: DeviceNetwork, maps: DeviceMaps, registered: bool, c: StepConstants, t: Tables
) -> tuple[Tensor, Tensor]:
    """Blend the views by the network: the picture (3, H, W) in [0, 1], and the share of each view,
    (K, h, w).
    """
    size, device = maps.fused.shape, maps.fused.device
    means, depths = reduced_maps(maps, t)
    places, order = (torch.empty(len(means), dtype=torch.int32, device=device) for _ in range(2))
    launch(give_places, 1, maps.splats.alphas.amax(dim=(1, 2)), places, order)
    small = network.small(
        input_channels(means, depths, places, registered, network.config.views, c), c.weights, order
    )
    mean, image = (torch.empty((3, *size), device=device) for _ in range(2))
    covered, spread, coverages, logarithm = (torch.empty(size, device=device) for _ in range(4))
    launch(
        mean_of_views,
        size,
        maps.colours,
        maps.coverage,
        maps.splats.alphas,
        c.weights,
        places,
        mean,
        covered,
    )
    stacks = (
        maps.colours,
        maps.coverage,
        maps.visibilities,
        fill_holes(mean, covered, t),
        maps.fused,
        small,
        places,
        t.sizes.scale,
    )
    launch(compose, size, *stacks, image, spread, coverages, logarithm)
    shares = torch.empty_like(depths[:-1])
    launch(share_out, shares.shape[1:], small, means, places, shares)
    return network.refined(image, spread, coverages, logarithm, maps.fused, small), shares


@wp.kernel
def write_pixels(
    picture: wp.array3d[wp.float32], image: wp.array3d[wp.float32], levels: wp.array3d[wp.uint8]
):
    """A picture (3, H, W) pixel by pixel, and in 8 bit."""
    y, x = wp.tid()
    for c in range(3):
        value = picture[c, y, x]
        image[y, x, c] = value
        levels[y, x, c] = wp.uint8(wp.int32(wp.rint(wp.clamp(value, 0.0, 1.0) * 255.0)))


def show_picture(picture: Tensor, image: Tensor, levels: Tensor) -> None:
    """Write a picture (3, H, W) in [0, 1] as the host takes it, (H, W, 3), float32 and uint8."""
    launch(write_pixels, picture.shape[1:], picture, image, levels)
