"""Certainty that nothing moves, and the memories of the target that it guards: the recurrent output
and the background.
"""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor
from torch.nn import functional

from ggvs_eval.contrib.warp.constants import SAME_SURFACE, SHOWN, StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch
from ggvs_eval.contrib.warp.registration import is_inside, surface_in_view, visibility_of
from ggvs_eval.contrib.warp.splat import DeviceSplats
from ggvs_eval.contrib.warp.tables import (
    Corners,
    Tables,
    corners_around,
    enlarged,
    falling,
    masked_median,
)
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online import geometry_guided, temporal_filters
from ggvs_eval.pipelines.online import temporal_filters as rules
from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions

wp.set_module_options(MODULE_OPTIONS)

_COVERED = wp.constant(wp.float32(COVERED_ALPHA))
_NEVER = wp.constant(wp.float32(rules.NEVER))
_LEAST_LOOKS = wp.constant(wp.float32(rules.LEAST_LOOKS))
_LEAST_NOISE, _MOST_NOISE = (
    wp.constant(wp.float32(rules.LEAST_NOISE)),
    wp.constant(wp.float32(rules.MOST_NOISE)),
)
_SHARED0, _SHARED1 = (wp.constant(wp.float32(value)) for value in rules.SHARED)
_LARGEST0, _LARGEST1 = (wp.constant(wp.float32(value)) for value in rules.LARGEST)
_DRAGGED0, _DRAGGED1 = (wp.constant(wp.float32(value)) for value in temporal_filters.DRAGGED)
_BEHIND, _FORGETTING = (
    wp.constant(wp.float32(getattr(geometry_guided, name))) for name in ("BEHIND", "FORGETTING")
)
_RENEWAL, _SURE_STILL = (
    wp.constant(wp.float32(getattr(geometry_guided, name))) for name in ("RENEWAL", "SURE_STILL")
)
_HOLE = wp.constant(wp.float32(COVERED_ALPHA * (1 - geometry_guided.FEATHER)))


@dataclass(frozen=True, eq=False)
class Cells:
    """Target view in the middle of each cell, maps (h, w).

    Attributes:
        depth: fused, world units, 0 where unknown.
        coverage: the largest of the views'.
        still: how sure it is that nothing moves.
    """

    depth: Tensor
    coverage: Tensor
    still: Tensor


@wp.kernel
def take_cells(
    surface: wp.array2d[wp.float32],
    features: wp.array4d[wp.float32],
    alphas: wp.array3d[wp.float32],
    previous: wp.array[wp.int32],
    rows: wp.array2d[wp.int32],
    columns: wp.array2d[wp.int32],
    depth: wp.array2d[wp.float32],
    coverage: wp.array2d[wp.float32],
    masks: wp.array2d[wp.float32],
):
    """Of each cell's middle pixel: depth, coverage, and the largest mask of a view that covers it
    and is not new.
    """
    y, x = wp.tid()
    row = rows[0, y]
    column = columns[0, x]
    depth[y, x] = surface[row, column]
    covers = wp.float32(0.0)
    mask = wp.float32(0.0)
    for k in range(alphas.shape[0]):
        alpha = alphas[k, row, column]
        covers = wp.max(covers, alpha)
        if previous[k] >= 0 and alpha >= _COVERED:
            mask = wp.max(mask, features[k, row, column, 3])
    coverage[y, x] = covers
    masks[y, x] = mask


@wp.kernel
def take_depths(
    depths: wp.array3d[wp.float32],
    rows: wp.array2d[wp.int32],
    columns: wp.array2d[wp.int32],
    out: wp.array3d[wp.float32],
):
    """Depth of each source in the middle of the cells of its mask."""
    k, y, x = wp.tid()
    out[k, y, x] = depths[k, rows[k, y], columns[k, x]]


@wp.func
def corners_of(at: wp.vec3f, width: wp.int32, height: wp.int32) -> Corners:
    """Return the corners for a bilinear look-up; the border is repeated."""
    column = wp.min(wp.max(at[0] - 0.5, 0.0), wp.float32(width - 1))
    row = wp.min(wp.max(at[1] - 0.5, 0.0), wp.float32(height - 1))
    return corners_around(row, column, height, width)


@wp.func
def between(
    a: wp.float32, b: wp.float32, c: wp.float32, d: wp.float32, fx: wp.float32, fy: wp.float32
) -> wp.float32:
    """Return the bilinear value of two upper and two lower neighbours."""
    return (1.0 - fy) * ((1.0 - fx) * a + fx * b) + fy * ((1.0 - fx) * c + fx * d)


@wp.func
def pixel_change(
    after: wp.array4d[wp.uint8],
    before: wp.array4d[wp.uint8],
    k: wp.int32,
    p: wp.int32,
    y: wp.int32,
    x: wp.int32,
    c: wp.int32,
):
    """Change of a channel of a view's pixel."""
    return (wp.float32(after[k, y, x, c]) - wp.float32(before[p, y, x, c])) / 255.0


@wp.kernel
def look_at_pixels(
    surface: wp.array2d[wp.float32],
    after: wp.array4d[wp.uint8],
    before: wp.array4d[wp.uint8],
    previous: wp.array[wp.int32],
    sizes: wp.array2d[wp.int32],
    depths: wp.array3d[wp.float32],
    maps: wp.array2d[wp.float32],
    numbers: wp.array[wp.float32],
    out: wp.array4d[wp.float32],
):
    """Each view's change of pixels at a surface times its visibility, and that, (K, 4, h, w).

    0 of a view that is new.
    """
    k, y, x = wp.tid()
    at = surface_in_view(surface, maps[k], y, x, 0.0)
    visibility = wp.float32(0.0)
    p = previous[k]
    value = wp.vec3f()
    if p >= 0 and is_inside(at, sizes[k, 0], sizes[k, 1]):
        visibility = visibility_of(
            depths[k], sizes[k, 0], sizes[k, 1], at, numbers[SAME_SURFACE], 0.0
        )
        n = corners_of(at, sizes[k, 0], sizes[k, 1])
        for c in range(3):
            a = pixel_change(after, before, k, p, n.y0, n.x0, c)
            b = pixel_change(after, before, k, p, n.y0, n.x1, c)
            d = pixel_change(after, before, k, p, n.y1, n.x0, c)
            e = pixel_change(after, before, k, p, n.y1, n.x1, c)
            value[c] = between(a, b, d, e, n.fx, n.fy)
    for c in range(3):
        out[k, c, y, x] = value[c] * visibility
    out[k, 3, y, x] = visibility


@wp.kernel
def look_at_cells(
    surface: wp.array2d[wp.float32],
    colours: wp.array4d[wp.float32],
    previous: wp.array[wp.int32],
    sizes: wp.array2d[wp.int32],
    depths: wp.array3d[wp.float32],
    maps: wp.array2d[wp.float32],
    numbers: wp.array[wp.float32],
    out: wp.array4d[wp.float32],
):
    """The same of the change of mean colours of cells."""
    k, y, x = wp.tid()
    at = surface_in_view(surface, maps[k], y, x, 0.0)
    visibility = wp.float32(0.0)
    value = wp.vec3f()
    if previous[k] >= 0 and is_inside(at, sizes[k, 0], sizes[k, 1]):
        visibility = visibility_of(
            depths[k], sizes[k, 0], sizes[k, 1], at, numbers[SAME_SURFACE], 0.0
        )
        n = corners_of(at, sizes[k, 0], sizes[k, 1])
        for c in range(3):
            above = (1.0 - n.fx) * colours[k, n.y0, n.x0, c] + n.fx * colours[k, n.y0, n.x1, c]
            below = (1.0 - n.fx) * colours[k, n.y1, n.x0, c] + n.fx * colours[k, n.y1, n.x1, c]
            value[c] = (1.0 - n.fy) * above + n.fy * below
    for c in range(3):
        out[k, c, y, x] = value[c] * visibility
    out[k, 3, y, x] = visibility


@wp.func
def light_at(
    sums: wp.array3d[wp.float32],
    c: wp.int32,
    y: wp.int32,
    x: wp.int32,
    height: wp.int32,
    width: wp.int32,
) -> wp.float32:
    """Return the mean change of light at a cell, of sums over wide areas: three colours and their
    weight.
    """
    h = sums.shape[1]
    w = sums.shape[2]
    v = wp.max((wp.float32(y) + 0.5) * (wp.float32(h) / wp.float32(height)) - 0.5, 0.0)
    u = wp.max((wp.float32(x) + 0.5) * (wp.float32(w) / wp.float32(width)) - 0.5, 0.0)
    y0 = wp.min(wp.int32(v), h - 1)
    x0 = wp.min(wp.int32(u), w - 1)
    y1 = wp.min(y0 + 1, h - 1)
    x1 = wp.min(x0 + 1, w - 1)
    a = sums[c, y0, x0] / (sums[3, y0, x0] + 1e-3)
    b = sums[c, y0, x1] / (sums[3, y0, x1] + 1e-3)
    d = sums[c, y1, x0] / (sums[3, y1, x0] + 1e-3)
    e = sums[c, y1, x1] / (sums[3, y1, x1] + 1e-3)
    return between(a, b, d, e, u - wp.float32(x0), v - wp.float32(y0))


@wp.kernel
def sum_looks(
    looks: wp.array4d[wp.float32],
    light: wp.array4d[wp.float32],
    views: wp.int32,
    out: wp.array4d[wp.float32],
):
    """Of each scale: what the views' changes share, in how many pairs, their energy, and how many
    see the surface.
    """
    scale, y, x = wp.tid()
    height = looks.shape[2]
    width = looks.shape[3]
    total = wp.vec3f()
    energy = wp.float32(0.0)
    visibility_sum = wp.float32(0.0)
    squares = wp.float32(0.0)
    for k in range(views):
        n = scale * views + k
        visibility = looks[n, 3, y, x]
        weighted = wp.vec3f()
        for c in range(3):
            weighted[c] = looks[n, c, y, x] - visibility * light_at(
                light[n], c, y, x, height, width
            )
        total += weighted
        energy += wp.dot(weighted, weighted) / 3.0
        visibility_sum += visibility
        squares += visibility * visibility
    out[scale, 0, y, x] = wp.dot(total, total) / 3.0 - energy
    out[scale, 1, y, x] = visibility_sum * visibility_sum - squares
    out[scale, 2, y, x] = energy
    out[scale, 3, y, x] = squares


@wp.kernel
def judge(
    pooled: wp.array4d[wp.float32],
    still: wp.array2d[wp.float32],
    noise: wp.array2d[wp.float32],
    is_known: wp.array2d[wp.bool],
):
    """Certainty by both scales, the noise energy of the coarser one, and its validity."""
    y, x = wp.tid()
    sure = wp.float32(1.0)
    apart = wp.float32(0.0)
    knows = wp.bool(False)
    for scale in range(2):
        shared = pooled[scale, 0, y, x] / wp.max(pooled[scale, 1, y, x], _NEVER)
        apart = pooled[scale, 2, y, x] / wp.max(pooled[scale, 3, y, x], _NEVER) - shared
        knows = pooled[scale, 1, y, x] > 2.0 * _LEAST_LOOKS
        factor = falling(shared / wp.max(apart, _LEAST_NOISE * _LEAST_NOISE), _SHARED0, _SHARED1)
        if not knows:
            factor = wp.float32(0.0)
        sure *= factor
    still[y, x] = sure
    noise[y, x] = apart
    is_known[y, x] = knows


@wp.kernel
def conclude(
    still: wp.array2d[wp.float32],
    masks: wp.array2d[wp.float32],
    median: wp.array[wp.float32],
    beta: wp.float32,
    lambda_t: wp.float32,
    out: wp.array2d[wp.float32],
):
    """The same checked against the largest change that a source sees nearby.

    A noise below nothing, by rounding, is none.
    """
    y, x = wp.tid()
    noise = wp.clamp(wp.sqrt(wp.max(median[0], 0.0)), _LEAST_NOISE, _MOST_NOISE)
    largest = wp.max(masks[y, x] - beta, 0.0) * lambda_t
    out[y, x] = still[y, x] * falling(largest / noise, _LARGEST0, _LARGEST1)


def rate_stillness(
    surface: Tensor,
    splats: DeviceSplats,
    images: tuple[Tensor, Tensor],
    depths: Tensor,
    colours: Tensor,
    c: StepConstants,
    t: Tables,
    options: OnlineOptions,
) -> Cells:
    """Rate how sure it is that nothing moves, by the rules of the compiled path's `stillness`.

    Args:
        surface: fused depth, (H, W).
        images: of the sources now and at the instant before, (K, H, W, 3), uint8.
        depths: of the sources, filtered, (K, H, W).
        colours: change of the mean colours of their masks' cells, (K, h, w, 3).
    """
    device, views, (w, h) = surface.device, len(depths), t.sizes.cells
    rows, columns = (t.middles((t.sizes.target[axis],), (t.sizes.cells[axis],)) for axis in (1, 0))
    depth, coverage, masks, still, apart = (torch.empty((h, w), device=device) for _ in range(5))
    launch(
        take_cells,
        (h, w),
        surface,
        splats.features,
        splats.alphas,
        c.previous,
        rows,
        columns,
        depth,
        coverage,
        masks,
    )
    lines = tuple(zip(*t.sizes.views, strict=True)), tuple(zip(*t.sizes.mask_cells, strict=True))
    cell_depths = torch.empty(colours.shape[:3], device=device)
    launch(
        take_depths,
        cell_depths.shape,
        depths,
        *(t.middles(lines[0][axis], lines[1][axis]) for axis in (1, 0)),
        cell_depths,
    )
    looks = torch.empty((2 * views, 4, h, w), device=device)
    pixel_arguments = (depth, *images, c.previous, t.view_sizes, depths, c.to_pixels, c.numbers)
    launch(look_at_pixels, (views, h, w), *pixel_arguments, looks[:views])
    cells = (depth, colours, c.previous, t.mask_cells, cell_depths, c.to_cells, c.numbers)
    launch(look_at_cells, (views, h, w), *cells, looks[views:])
    sums, is_known = (
        torch.empty((2, 4, h, w), device=device),
        torch.empty((h, w), dtype=torch.bool, device=device),
    )
    launch(sum_looks, (2, h, w), looks, t.wide(looks), views, sums)
    launch(judge, (h, w), t.pooled(sums), still, apart, is_known)
    widest = functional.max_pool2d(masks[None, None], 2 * rules.REACH + 1, 1, rules.REACH)[0, 0]
    sure = torch.empty_like(still)
    launch(
        conclude,
        (h, w),
        still,
        widest,
        masked_median(apart, is_known),
        options.beta_mask,
        options.lambda_t,
        sure,
    )
    return Cells(depth, coverage, sure)


@dataclass(frozen=True, eq=False)
class Output:
    """An instant: what was shown (3, H, W), the new image at each cell, (3, h, w), and for how long
    that stood still, (h, w).
    """

    picture: Tensor
    new: Tensor
    age: Tensor


@wp.func
def is_finite(picture: wp.array3d[wp.float32], y: wp.int32, x: wp.int32) -> wp.bool:
    """Return whether all channels of a pixel are numbers."""
    return (
        wp.isfinite(picture[0, y, x])
        and wp.isfinite(picture[1, y, x])
        and wp.isfinite(picture[2, y, x])
    )


@wp.kernel
def compare_past(
    image: wp.array3d[wp.float32],
    past: wp.array3d[wp.float32],
    last: wp.array3d[wp.float32],
    flags: wp.array[wp.int32],
    rows: wp.array2d[wp.int32],
    columns: wp.array2d[wp.int32],
    fresh: wp.array3d[wp.float32],
    out: wp.array4d[wp.float32],
    has_past: wp.array2d[wp.float32],
):
    """The new image at each cell, its change to the mean of the past and to the last, (2, 4, h, w),
    and if there is a past.
    """
    y, x = wp.tid()
    row = rows[0, y]
    column = columns[0, x]
    counts = (
        flags[SHOWN] != 0
        and is_finite(past, row, column)
        and is_finite(last, y, x)
        and is_finite(image, row, column)
    )
    for c in range(3):
        value = image[c, row, column]
        fresh[c, y, x] = value
        out[0, c, y, x] = 0.0
        out[1, c, y, x] = 0.0
        if counts:
            out[0, c, y, x] = value - past[c, row, column]
            out[1, c, y, x] = value - last[c, y, x]
    out[0, 3, y, x] = 1.0
    out[1, 3, y, x] = 1.0
    has_past[y, x] = wp.where(counts, 1.0, 0.0)


@wp.kernel
def dragged_energy(
    changes: wp.array4d[wp.float32], light: wp.array4d[wp.float32], out: wp.array3d[wp.float32]
):
    """Energy of each change beyond that of light."""
    n, y, x = wp.tid()
    total = wp.float32(0.0)
    for c in range(3):
        value = changes[n, c, y, x] - light_at(
            light[n], c, y, x, changes.shape[2], changes.shape[3]
        )
        total += value * value
    out[n, y, x] = total / 3.0


@wp.kernel
def weigh_past(
    pooled: wp.array3d[wp.float32],
    changes: wp.array4d[wp.float32],
    still: wp.array2d[wp.float32],
    before: wp.array2d[wp.float32],
    has_past: wp.array2d[wp.float32],
    most: wp.float32,
    limit: wp.float32,
    age: wp.array2d[wp.float32],
    weighted: wp.array3d[wp.float32],
):
    """Weight of the past, its age, and what changed times the weight, (4, h, w)."""
    y, x = wp.tid()
    older = wp.float32(1.0)
    weight = wp.float32(0.0)
    if has_past[y, x] > 0.0:
        count = wp.min(before[y, x], most)
        excess = 2.0 * pooled[0, y, x] / wp.max(
            pooled[1, y, x], 2.0 * _LEAST_NOISE * _LEAST_NOISE
        ) - (1.0 + 1.0 / count)
        sure = still[y, x] * falling(excess, _DRAGGED0, _DRAGGED1)
        older = 1.0 + sure * before[y, x]
        weight = sure * wp.min(1.0 - 1.0 / older, limit)
    age[y, x] = older
    for c in range(3):
        weighted[c, y, x] = -changes[0, c, y, x] * weight
    weighted[3, y, x] = weight


@wp.kernel
def weigh_light(
    weighted: wp.array3d[wp.float32], light: wp.array3d[wp.float32], out: wp.array3d[wp.float32]
):
    """Weight of the past, and what is light of its change."""
    y, x = wp.tid()
    weight = weighted[3, y, x]
    for c in range(3):
        out[c, y, x] = weight * light_at(light, c, y, x, weighted.shape[1], weighted.shape[2])
    out[3, y, x] = weight


@wp.kernel
def mix_past(
    image: wp.array3d[wp.float32],
    past: wp.array3d[wp.float32],
    by: wp.array3d[wp.float32],
    out: wp.array3d[wp.float32],
):
    """The past mixed in where it has weight, except for what changed over wide areas.

    One that is not finite has none.
    """
    y, x = wp.tid()
    height = image.shape[1]
    width = image.shape[2]
    h = by.shape[1]
    w = by.shape[2]
    fine = enlarged(by[3], h, w, y, x, height, width)
    mixes = fine > 0.0 and is_finite(past, y, x)
    for c in range(3):
        value = image[c, y, x]
        if mixes:
            value = (
                past[c, y, x] * fine
                + image[c, y, x] * (1.0 - fine)
                - enlarged(by[c], h, w, y, x, height, width)
            )
        out[c, y, x] = wp.clamp(value, 0.0, 1.0)


def recur(
    image: Tensor,
    still: Tensor,
    before: Output,
    limit: float,
    c: StepConstants,
    t: Tables,
    out: Output,
) -> None:
    """The output of an instant, (3, H, W), see `RecurrentOutput.step`."""
    device, (w, h) = image.device, t.sizes.cells
    rows, columns = (t.middles((t.sizes.target[axis],), (t.sizes.cells[axis],)) for axis in (1, 0))
    changes, energy, has_past = (
        torch.empty(size, device=device) for size in ((2, 4, h, w), (2, h, w), (h, w))
    )
    launch(
        compare_past,
        (h, w),
        image,
        before.picture,
        before.new,
        c.flags,
        rows,
        columns,
        out.new,
        changes,
        has_past,
    )
    launch(dragged_energy, (2, h, w), changes, t.wide(changes), energy)
    weighted, by = torch.empty((4, h, w), device=device), torch.empty((4, h, w), device=device)
    # of instants that a mean of such weights is worth, and of the weight
    limits = (1 + limit) / (1 - limit), limit
    launch(
        weigh_past,
        (h, w),
        t.pooled(energy),
        changes,
        still,
        before.age,
        has_past,
        *limits,
        out.age,
        weighted,
    )
    launch(weigh_light, (h, w), weighted, t.wide(weighted), by)
    launch(mix_past, image.shape[1:], image, before.picture, by, out.picture)


@wp.kernel
def remember(
    image: wp.array3d[wp.float32],
    depth: wp.array2d[wp.float32],
    alphas: wp.array3d[wp.float32],
    still: wp.array2d[wp.float32],
    flags: wp.array[wp.int32],
    past: wp.array3d[wp.float32],
    past_depth: wp.array2d[wp.float32],
    out: wp.array3d[wp.float32],
    out_depth: wp.array2d[wp.float32],
    filled: wp.array3d[wp.float32],
):
    """The farthest that the target saw, its depth (0 of a filling, -1 of what moved), and the
    picture with its holes filled.
    """
    y, x = wp.tid()
    alpha = wp.float32(0.0)
    for k in range(alphas.shape[0]):
        alpha = wp.max(alpha, alphas[k, y, x])
    hole = alpha < _COVERED
    current = depth[y, x]
    keeps = flags[SHOWN] != 0 and is_finite(past, y, x) and wp.isfinite(past_depth[y, x])
    faded = past_depth[y, x] * _FORGETTING
    fresh = current >= faded * _BEHIND and current > 0.0 and not hole
    stored = faded
    if fresh:
        stored = current
        cell_y = wp.min(
            wp.int32(wp.float32(y) * (wp.float32(still.shape[0]) / wp.float32(depth.shape[0]))),
            still.shape[0] - 1,
        )
        cell_x = wp.min(
            wp.int32(wp.float32(x) * (wp.float32(still.shape[1]) / wp.float32(depth.shape[1]))),
            still.shape[1] - 1,
        )
        if still[cell_y, cell_x] < _SURE_STILL:
            stored = wp.float32(-1.0)
    begins = hole and stored < 0.0
    if begins:
        stored = wp.float32(0.0)
    if not keeps:
        stored = wp.where(hole, 0.0, current)
    out_depth[y, x] = stored
    weight = wp.clamp((_COVERED - alpha) / _HOLE, 0.0, 1.0)
    for c in range(3):
        new = image[c, y, x]
        colour = new
        if keeps and not fresh and not begins:
            colour = past[c, y, x]
        if keeps and hole and stored <= 0.0:
            colour += _RENEWAL * (new - colour)
        out[c, y, x] = colour
        filled[c, y, x] = new
        if keeps and hole:
            filled[c, y, x] = new + weight * (colour - new)


def remember_background(
    image: Tensor,
    depth: Tensor,
    splats: DeviceSplats,
    still: Tensor,
    before: tuple[Tensor, Tensor],
    c: StepConstants,
    out: tuple[Tensor, Tensor],
) -> Tensor:
    """Return the picture (3, H, W) with its holes filled from memory, see
    `RememberedBackground.step`; `out` is the memory.
    """
    filled = torch.empty_like(image)
    launch(
        remember, depth.shape, image, depth, splats.alphas, still, c.flags, *before, *out, filled
    )
    return filled
