"""Difference masks (Eq. 1), the temporal depth filter (Eq. 2), fusion weights (Eqs. 11-12) and
trust in the past (Eqs. 13-14).
"""

import torch
import warp as wp
from torch import Tensor
from torch.nn import functional

from ggvs_eval.contrib.warp.constants import NOISE, PAST, TAU, StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch
from ggvs_eval.contrib.warp.tables import Tables, enlarged
from ggvs_eval.geometry.splat import COVERED_ALPHA
from ggvs_eval.pipelines.online.geometry_guided import OnlineOptions

wp.set_module_options(MODULE_OPTIONS)

REACH = wp.constant(3)  # of the 7 x 7 window of Eq. 12
# represents an invalid depth: any difference to it exceeds tau
FAR_AWAY = wp.constant(wp.float32(1e18))
_COVERED = wp.constant(wp.float32(COVERED_ALPHA))


@wp.kernel
def change_of_views(
    after: wp.array4d[wp.uint8],
    before: wp.array4d[wp.uint8],
    previous: wp.array[wp.int32],
    cells: wp.array2d[wp.int32],
    rows: wp.array3d[wp.int32],
    row_shares: wp.array3d[wp.float32],
    columns: wp.array3d[wp.int32],
    column_shares: wp.array3d[wp.float32],
    lambda_t: wp.float32,
    beta: wp.float32,
    mean: wp.bool,
    colours: wp.array4d[wp.float32],
    mask: wp.array3d[wp.float32],
):
    """By how much each cell's mean colour has changed, see `kernels/filter.hpp`, and the weight of
    new depth there.
    """
    k, y, x = wp.tid()
    p = previous[k]
    inside = x < cells[k, 0] and y < cells[k, 1]
    mask[k, y, x] = 0.0
    for c in range(3):
        colours[k, y, x, c] = 0.0
    if not inside:
        return
    if p < 0:
        mask[k, y, x] = 1.0
        return
    largest = wp.float32(0.0)
    total = wp.float32(0.0)
    for c in range(3):
        value = wp.float32(0.0)
        for column in range(columns[k, x, 0], columns[k, x, 1]):
            line = wp.float32(0.0)
            for row in range(rows[k, y, 0], rows[k, y, 1]):
                difference = wp.float32(after[k, row, column, c]) - wp.float32(
                    before[p, row, column, c]
                )
                line += row_shares[k, y, row - rows[k, y, 0]] * difference
            value += column_shares[k, x, column - columns[k, x, 0]] * line
        value = value / 255.0
        colours[k, y, x, c] = value
        largest = wp.max(largest, wp.abs(value))
        total += wp.abs(value)
    if mean:
        largest = total / 3.0
    mask[k, y, x] = wp.min(largest / lambda_t + beta, 1.0)


@wp.kernel
def mix_views(
    depth: wp.array3d[wp.float32],
    history: wp.array3d[wp.float32],
    previous: wp.array[wp.int32],
    sizes: wp.array2d[wp.int32],
    cells: wp.array2d[wp.int32],
    small: wp.array3d[wp.float32],
    tolerance: wp.float32,
    masks: wp.array3d[wp.float32],
    out: wp.array3d[wp.float32],
):
    """The masks at full size.

    Depth and history mixed where they are one surface, else the one that is known.
    """
    k, y, x = wp.tid()
    masks[k, y, x] = 1.0
    out[k, y, x] = 0.0
    if x >= sizes[k, 0] or y >= sizes[k, 1]:
        return
    new = depth[k, y, x]
    result = new
    p = previous[k]
    if p >= 0:
        share = enlarged(small[k], cells[k, 1], cells[k, 0], y, x, sizes[k, 1], sizes[k, 0])
        masks[k, y, x] = share
        old = history[p, y, x]
        if new > 0.0:
            if old > 0.0 and wp.abs(new - old) <= tolerance * new:
                result = share * new + (1.0 - share) * old
        elif share < 1.0:
            result = old
        else:
            result = 0.0
    out[k, y, x] = result


@wp.func
def unlike(centre: wp.float32, value: wp.float32, most: wp.float32) -> wp.float32:
    """Return the squared difference of two depths, at most `most`, which it is where the second is
    unknown.
    """
    difference = centre - value
    square = wp.min(difference * difference, most)
    if not (value > 0.0):
        square = most
    return square


@wp.kernel
def fusion_weights(
    depths: wp.array3d[wp.float32],
    sizes: wp.array2d[wp.int32],
    numbers: wp.array[wp.float32],
    out: wp.array3d[wp.float32],
):
    """Eqs. 11-12 of every view."""
    k, y, x = wp.tid()
    width = sizes[k, 0]
    height = sizes[k, 1]
    out[k, y, x] = 0.0
    if x >= width or y >= height:
        return
    centre = depths[k, y, x]
    if not (centre > 0.0 and centre < FAR_AWAY):
        return
    most = numbers[TAU] * numbers[TAU]
    nu = wp.float32(0.0)
    if y >= REACH and x >= REACH and y < height - REACH and x < width - REACH:
        for down in range(-REACH, REACH + 1):
            line = wp.float32(0.0)
            for right in range(-REACH, REACH + 1):
                line += unlike(centre, depths[k, y + down, x + right], most)
            nu += line
    else:
        for down in range(-REACH, REACH + 1):
            line = wp.float32(0.0)
            for right in range(-REACH, REACH + 1):
                v = y + down
                u = x + right
                value = wp.float32(0.0)
                if v >= 0 and u >= 0 and v < height and u < width:
                    value = depths[k, v, u]
                line += unlike(centre, value, most)
            nu += line
    weight = wp.float32(1.0)
    if nu > 0.0:
        weight = wp.min(numbers[NOISE] / wp.sqrt(nu), 1.0)
    out[k, y, x] = weight


@wp.kernel
def gain_of_past(
    features: wp.array4d[wp.float32],
    alphas: wp.array3d[wp.float32],
    previous: wp.array[wp.int32],
    flags: wp.array[wp.int32],
    beta: wp.float32,
    gain: wp.array2d[wp.float32],
):
    """Trust in the fused depth of the instant before, none if a view that covers a pixel has
    changed; -1 without a past.
    """
    y, x = wp.tid()
    largest = wp.float32(-1.0)
    for k in range(alphas.shape[0]):
        if previous[k] >= 0 and alphas[k, y, x] >= _COVERED:
            largest = wp.max(largest, features[k, y, x, 3])
    if largest < 0.0:
        largest = wp.float32(1.0)
    value = wp.max(1.0 - largest, 0.0) * beta
    if flags[PAST] == 0:
        value = wp.float32(-1.0)
    gain[y, x] = value


def filter_views(
    images: Tensor,
    depths: Tensor,
    before: tuple[Tensor, Tensor],
    c: StepConstants,
    t: Tables,
    options: OnlineOptions,
    out: Tensor,
) -> tuple[Tensor, Tensor]:
    """Filter the depth of every view.

    Args:
        images: of now, (K, H, W, 3), uint8.
        depths: of now, (K, H, W), 0 where unknown.
        before: images and filtered depths of the instant before, in its own order and size.
        out: filtered depths, (K, H, W).

    Returns:
        The masks, (K, H, W), and the change of the cells' colours, (K, h, w, 3); of a view that is
        new 1 and 0.
    """
    cells = t.sizes.mask_cells
    lines = tuple(zip(*t.sizes.views, strict=True)), tuple(zip(*cells, strict=True))
    rows, columns = (t.area_cells(lines[0][axis], lines[1][axis]) for axis in (1, 0))
    size = len(cells), max(lines[1][1]), max(lines[1][0])
    colours, small = (
        torch.empty((*size, 3), device=depths.device),
        torch.empty(size, device=depths.device),
    )
    limits = options.lambda_t, options.beta_mask, options.mask_channels == "mean"
    launch(
        change_of_views,
        size,
        images,
        before[0],
        c.previous,
        t.mask_cells,
        *rows,
        *columns,
        *limits,
        colours,
        small,
    )
    widest = functional.max_pool2d(small[None], 3, 1, 1)[0]
    masks = torch.empty_like(depths)
    mix_arguments = (depths, before[1], c.previous, t.view_sizes, t.mask_cells, widest)
    launch(mix_views, depths.shape, *mix_arguments, options.history_tolerance, masks, out)
    return masks, colours


def weigh_depths(depths: Tensor, c: StepConstants, t: Tables) -> Tensor:
    """Weigh depth pixels by trust, (K, H, W)."""
    weights = torch.empty_like(depths)
    launch(fusion_weights, depths.shape, depths, t.view_sizes, c.numbers, weights)
    return weights


def trust_past(
    features: Tensor, alphas: Tensor, c: StepConstants, options: OnlineOptions
) -> Tensor:
    """Return the gain of the past's evidence for each ray, (H, W); -1 if there is no past."""
    gain = torch.empty(alphas.shape[1:], device=alphas.device)
    launch(
        gain_of_past, gain.shape, features, alphas, c.previous, c.flags, options.beta_temporal, gain
    )
    return gain
