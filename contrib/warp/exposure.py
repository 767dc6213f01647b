"""Gains and lens fall-off of the sources, as `ExposureCompensation`: medians by bisection of a
float's bits, a block each.
"""

from dataclasses import dataclass

import torch
import warp as wp
from torch import Tensor

from ggvs_eval.contrib.warp.constants import GAINS, TAU, StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch
from ggvs_eval.contrib.warp.tables import Tables
from ggvs_eval.pipelines.online import exposure_compensation
from ggvs_eval.pipelines.online import exposure_compensation as compensation

wp.set_module_options(MODULE_OPTIONS)

BLOCK = 512
_REDUCTION = wp.constant(compensation.REDUCTION)
_DARK, _BRIGHT = (
    wp.constant(wp.float32(compensation.DARK)),
    wp.constant(wp.float32(compensation.BRIGHT)),
)
_FEWEST = wp.constant(wp.float64(compensation.FEWEST))
_LIKE = wp.constant(wp.float32(compensation.LIKE))
_ODD, _COMMON = (
    wp.constant(wp.float64(compensation.ODD)),
    wp.constant(wp.float64(compensation.COMMON)),
)
_LIMIT = wp.constant(wp.float64(compensation.LARGEST_LOG_GAIN))
_PRIOR = wp.constant(wp.float64(compensation.PRIOR))
_ROUNDS = wp.constant(exposure_compensation.FALL_OFF_ROUNDS)
_NOISE = wp.constant(wp.float64(exposure_compensation.FALL_OFF_NOISE))
_SLOPE_PRIOR = wp.constant(wp.float64(exposure_compensation.FALL_OFF_PRIOR))
_LEAST = wp.constant(wp.float64(exposure_compensation.LEAST_FALL_OFF))


@dataclass(frozen=True, eq=False)
class ExposureState:
    """Memory of the sources' colours.

    Attributes:
        lens: instants that the slope of the fall-off is the mean of, and the slope, (2,), float64.
        ratios: of pairs of cameras, how often their ratio was measured, its mean logarithm, and its
            weight, (R, 5), float64.
    """

    lens: Tensor
    ratios: Tensor


@dataclass(frozen=True, eq=False)
class Exposure:
    """Colour statistics of the sources.

    Attributes:
        gains: of each source and channel, (K, 3).
        factors: brightness of the sources and the target by row and column, (K + 1, 2, n).
        odd: 1 of a source whose colours are like no other's, black for an instant, though others
            agree, (K,), int32.
    """

    gains: Tensor
    factors: Tensor
    odd: Tensor


@wp.func
def is_linear(c: wp.vec3f) -> wp.bool:
    """Return whether a sensor is linear at these levels."""
    return wp.min(wp.min(c[0], c[1]), c[2]) >= _DARK and wp.max(wp.max(c[0], c[1]), c[2]) <= _BRIGHT


@wp.kernel
def reduce_images(
    images: wp.array4d[wp.uint8], sizes: wp.array2d[wp.int32], out: wp.array4d[wp.float32]
):
    """Means of whole blocks, rounded."""
    k, y, x = wp.tid()
    if y >= wp.max(sizes[k, 1] // _REDUCTION, 1) or x >= wp.max(sizes[k, 0] // _REDUCTION, 1):
        return
    for c in range(3):
        total = wp.int32(0)
        for v in range(_REDUCTION):
            row = wp.min(y * _REDUCTION + v, sizes[k, 1] - 1)
            for u in range(_REDUCTION):
                column = wp.min(x * _REDUCTION + u, sizes[k, 0] - 1)
                total += wp.int32(images[k, row, column, c])
        out[k, y, x, c] = wp.rint(wp.float32(total) / wp.float32(_REDUCTION * _REDUCTION))


@wp.func
def pixel_of(pictures: wp.array4d[wp.float32], k: wp.int32, y: wp.int32, x: wp.int32) -> wp.vec3f:
    """Return the colour of a reduced picture."""
    return wp.vec3f(pictures[k, y, x, 0], pictures[k, y, x, 1], pictures[k, y, x, 2])


@wp.kernel
def look_up(
    pictures: wp.array4d[wp.float32],
    depths: wp.array3d[wp.float32],
    pinholes: wp.array2d[wp.float64],
    sizes: wp.array2d[wp.int32],
    lattices: wp.array2d[wp.int32],
    directed: wp.array2d[wp.int32],
    transforms: wp.array2d[wp.float32],
    numbers: wp.array[wp.float32],
    points: wp.int32,
    looks: wp.array3d[wp.float32],
    flags: wp.array2d[wp.int32],
):
    """Of a lattice point of one view, its log ratio to another view and the span.

    Flags: 0 no point, 1 unseen there, 2 counts, 3 out of the other's linear range, 4 so, but hardly
    another colour.
    """
    q, n = wp.tid()
    pair = q // 2
    place = (q % 2) * points + n
    flags[pair, place] = 0
    for c in range(4):
        looks[pair, c, place] = 0.0
    first = directed[q, 0]
    second = directed[q, 1]
    across = lattices[first, 1]
    if n >= across * lattices[first, 2]:
        return
    step = lattices[first, 0]
    row = (n // across) * step + step // 2
    column = (n % across) * step + step // 2
    colour = pixel_of(pictures, first, row, column)
    v = wp.min(_REDUCTION * row + _REDUCTION // 2, sizes[first, 1] - 1)
    u = wp.min(_REDUCTION * column + _REDUCTION // 2, sizes[first, 0] - 1)
    z = depths[first, v, u]
    if not (z > 0.0) or not is_linear(colour):
        return
    flags[pair, place] = 1
    x = wp.float32(wp.float64(z) * ((wp.float64(u) - pinholes[first, 2]) / pinholes[first, 0]))
    y = wp.float32(wp.float64(z) * ((wp.float64(v) - pinholes[first, 3]) / pinholes[first, 1]))
    t = transforms[q]
    tx = t[0] * x + t[1] * y + t[2] * z + t[3]
    ty = t[4] * x + t[5] * y + t[6] * z + t[7]
    tz = t[8] * x + t[9] * y + t[10] * z + t[11]
    if not (tz > 0.0):
        return
    width = sizes[second, 0]
    height = sizes[second, 1]
    tu = wp.float32(pinholes[second, 0]) * tx / tz + wp.float32(pinholes[second, 2])
    tv = wp.float32(pinholes[second, 1]) * ty / tz + wp.float32(pinholes[second, 3])
    if not (tu >= 0.0 and tu < wp.float32(width) and tv >= 0.0 and tv < wp.float32(height)):
        return
    if not (wp.abs(depths[second, wp.int32(tv), wp.int32(tu)] - tz) < numbers[TAU]):
        return
    small_width = wp.max(width // _REDUCTION, 1)
    small_height = wp.max(height // _REDUCTION, 1)
    sx = wp.min(wp.max(tu / wp.float32(_REDUCTION) - 0.5, 0.0), wp.float32(small_width - 1))
    sy = wp.min(wp.max(tv / wp.float32(_REDUCTION) - 0.5, 0.0), wp.float32(small_height - 1))
    left = wp.min(wp.int32(sx), wp.max(small_width - 2, 0))
    top = wp.min(wp.int32(sy), wp.max(small_height - 2, 0))
    right = wp.min(left + 1, small_width - 1)
    bottom = wp.min(top + 1, small_height - 1)
    fx = sx - wp.float32(left)
    fy = sy - wp.float32(top)
    upper = pixel_of(pictures, second, top, left)
    upper += fx * (pixel_of(pictures, second, top, right) - upper)
    lower = pixel_of(pictures, second, bottom, left)
    lower += fx * (pixel_of(pictures, second, bottom, right) - lower)
    colour_there = upper + fy * (lower - upper)
    if not is_linear(colour_there):
        off = wp.vec3f(
            wp.abs(colour[0] - colour_there[0]),
            wp.abs(colour[1] - colour_there[1]),
            wp.abs(colour[2] - colour_there[2]),
        )
        flags[pair, place] = wp.where(wp.max(wp.max(off[0], off[1]), off[2]) <= _DARK, 4, 3)
        return
    flags[pair, place] = 2
    sign = 1.0 - 2.0 * wp.float32(q % 2)
    for c in range(3):
        looks[pair, c, place] = sign * (
            wp.log(wp.max(colour[c], 1.0)) - wp.log(wp.max(colour_there[c], 1.0))
        )
    looks[pair, 3, place] = sign * ((x * x + y * y) / (z * z) - (tx * tx + ty * ty) / (tz * tz))


@wp.func
def ordered(value: wp.float32) -> wp.uint32:
    """Return the bits of a float that sort as the floats do."""
    bits = wp.cast(value, wp.uint32)
    if (bits >> wp.uint32(31)) > wp.uint32(0):
        return ~bits
    return bits | (wp.uint32(1) << wp.uint32(31))


@wp.func
def value_of(key: wp.uint32) -> wp.float32:
    """Return the float of `ordered` bits."""
    if (key >> wp.uint32(31)) > wp.uint32(0):
        return wp.cast(key & wp.uint32(0x7FFFFFFF), wp.float32)
    return wp.cast(~key, wp.float32)


@wp.func
def combined(
    looks: wp.array3d[wp.float32], pair: wp.int32, channel: wp.int32, slope: wp.float32, n: wp.int32
) -> wp.float32:
    """Input of a median: a channel less the fall-off, or for channel 3 the mean of all."""
    if channel == 3:
        return (looks[pair, 0, n] + looks[pair, 1, n] + looks[pair, 2, n]) / 3.0
    return looks[pair, channel, n] - slope * looks[pair, 3, n]


@wp.func
def third(packed: wp.int64, n: wp.int32) -> wp.int32:
    """Return one of three counts that are summed as one number."""
    return wp.int32((packed >> wp.int64(20 * n)) & wp.int64(1048575))


@wp.func
def block_median(
    looks: wp.array3d[wp.float32],
    flags: wp.array2d[wp.int32],
    pair: wp.int32,
    channel: wp.int32,
    slope: wp.float32,
    count: wp.int32,
    lane: wp.int32,
) -> wp.float64:
    """Mean of the two middle values of what counts, by all threads of a block together, two bits a
    round; 0 of none.
    """
    low = wp.uint32(0)
    high = wp.uint32(0)
    low_rank = wp.max(count - 1, 0) // 2
    high_rank = count // 2
    shift = wp.uint32(32)
    # a loop that is not unrolled, or registers would not do for a block
    while shift > wp.uint32(0):
        shift -= wp.uint32(2)
        low_below = wp.int64(0)
        high_below = wp.int64(0)
        for i in range(lane, flags.shape[1], wp.block_dim()):
            if flags[pair, i] == 2:
                key = ordered(combined(looks, pair, channel, slope, i))
                for step in range(1, 4):
                    count_one = wp.int64(1) << wp.int64(20 * (step - 1))
                    if key < (low | (wp.uint32(step) << shift)):
                        low_below += count_one
                    if key < (high | (wp.uint32(step) << shift)):
                        high_below += count_one
        lows = wp.tile_sum(wp.tile(low_below))
        highs = wp.tile_sum(wp.tile(high_below))
        low_step = wp.int32(0)
        high_step = wp.int32(0)
        for step in range(3):
            if third(lows[0], step) <= low_rank:
                low_step = step + 1
            if third(highs[0], step) <= high_rank:
                high_step = step + 1
        low = low | (wp.uint32(low_step) << shift)
        high = high | (wp.uint32(high_step) << shift)
    median = wp.float64(0.0)
    if count > 0:
        median = wp.float64(0.5) * (wp.float64(value_of(low)) + wp.float64(value_of(high)))
    return median


@wp.func
def weight_in_round(r: wp.int32, residual: wp.float64):
    """A look's weight in a round of robust least squares: all alike first, then Huber's up to four
    times the noise.
    """
    weight = wp.float64(1.0)
    if r > 0:
        size = wp.abs(residual)
        weight = wp.float64(1e-9)
        if size < wp.float64(4.0) * _NOISE:
            weight = _NOISE / wp.max(size, _NOISE)
    return weight


@wp.kernel
def pair_slopes(
    looks: wp.array3d[wp.float32],
    flags: wp.array2d[wp.int32],
    lens: wp.array[wp.float64],
    out: wp.array2d[wp.float64],
):
    """Of each pair: slope and evidence by robust least squares, how many looks count, how many
    points there are; a block each.
    """
    pair, lane = wp.tid()
    counting = wp.int32(0)
    usable = wp.int32(0)
    for i in range(lane, flags.shape[1], wp.block_dim()):
        if flags[pair, i] == 2:
            counting += 1
        if flags[pair, i] > 0:
            usable += 1
    counts = wp.tile_sum(wp.tile(counting))
    points = wp.tile_sum(wp.tile(usable))
    count = counts[0]
    median = block_median(looks, flags, pair, 3, 0.0, count, lane)
    slope = wp.float64(0.0)
    evidence = wp.float64(0.0)
    mean_x = wp.float64(0.0)
    mean_y = wp.float64(0.0)
    r = wp.int32(0)
    while r < _ROUNDS:
        s0 = wp.float64(0.0)
        sx = wp.float64(0.0)
        sy = wp.float64(0.0)
        for i in range(lane, flags.shape[1], wp.block_dim()):
            if flags[pair, i] == 2:
                x = wp.float64(looks[pair, 3, i]) / lens[0]
                y = wp.float64(combined(looks, pair, 3, 0.0, i)) - median
                w = weight_in_round(r, (y - mean_y) - slope * (x - mean_x))
                s0 += w
                sx += w * x
                sy += w * y
        t0 = wp.tile_sum(wp.tile(s0))
        tx = wp.tile_sum(wp.tile(sx))
        ty = wp.tile_sum(wp.tile(sy))
        weight_sum = wp.max(t0[0], wp.float64(1e-30))
        new_x = tx[0] / weight_sum
        new_y = ty[0] / weight_sum
        sxx = wp.float64(0.0)
        sxy = wp.float64(0.0)
        for i in range(lane, flags.shape[1], wp.block_dim()):
            if flags[pair, i] == 2:
                x = wp.float64(looks[pair, 3, i]) / lens[0]
                y = wp.float64(combined(looks, pair, 3, 0.0, i)) - median
                w = weight_in_round(r, (y - mean_y) - slope * (x - mean_x))
                sxx += w * (x - new_x) * (x - new_x)
                sxy += w * (x - new_x) * (y - new_y)
        txx = wp.tile_sum(wp.tile(sxx))
        txy = wp.tile_sum(wp.tile(sxy))
        evidence = txx[0]
        slope = txy[0] / wp.max(evidence, wp.float64(1e-12))
        mean_x = new_x
        mean_y = new_y
        r += 1
    if lane == 0:
        out[pair, 0] = slope
        out[pair, 1] = evidence
        out[pair, 2] = wp.float64(count)
        out[pair, 3] = wp.float64(points[0])


@wp.kernel
def common_slope(
    pairs: wp.array2d[wp.float64],
    lens: wp.array[wp.float64],
    flags: wp.array[wp.int32],
    before: wp.array[wp.float64],
    after: wp.array[wp.float64],
):
    """The fall-off that the pairs share, and its running mean.

    State is (how many instants, slope).
    """
    wp.tid()
    total = wp.float64(0.0)
    squares = wp.float64(0.0)
    weighted = wp.float64(0.0)
    shared = wp.int32(0)
    for p in range(pairs.shape[0]):
        if pairs[p, 2] >= _FEWEST:
            shared += 1
            total += pairs[p, 1]
            squares += pairs[p, 1] * pairs[p, 1]
            weighted += pairs[p, 1] * pairs[p, 0]
    mean = weighted / (total + _SLOPE_PRIOR)
    spread = wp.float64(0.0)
    for p in range(pairs.shape[0]):
        if pairs[p, 2] >= _FEWEST:
            spread += pairs[p, 1] * (pairs[p, 0] - mean) * (pairs[p, 0] - mean)
    alike = total * total / wp.max(squares, wp.float64(1e-12))
    variance = spread / (total + _SLOPE_PRIOR) / wp.max(alike - wp.float64(1.0), wp.float64(0.5))
    doubt = _LEAST * _LEAST + wp.float64(4.0) * variance
    current = wp.float64(0.0)
    if mean * mean > doubt:
        current = mean * (wp.float64(1.0) - doubt / (mean * mean)) / lens[0]
    has_gains = wp.float64(flags[GAINS])
    after[0] = has_gains * before[0]
    after[1] = has_gains * before[1]
    if shared >= 2:  # fewer say nothing
        after[0] = wp.min(has_gains * before[0] + wp.float64(1.0), lens[1])
        after[1] = has_gains * before[1] + (current - has_gains * before[1]) / after[0]


@wp.kernel
def ratio_medians(
    looks: wp.array3d[wp.float32],
    flags: wp.array2d[wp.int32],
    pairs: wp.array2d[wp.float64],
    slope: wp.array[wp.float64],
    out: wp.array2d[wp.float64],
):
    """Median log ratio of each pair and channel, less the fall-off and, from the fourth on, as it
    is; a block each.
    """
    pair, n, lane = wp.tid()
    fall_off = wp.where(n < 3, wp.float32(slope[1]), 0.0)
    median = block_median(looks, flags, pair, n % 3, fall_off, wp.int32(pairs[pair, 2]), lane)
    if lane == 0:
        out[pair, n] = median


@wp.kernel
def compare_colours(
    looks: wp.array3d[wp.float32],
    flags: wp.array2d[wp.int32],
    medians: wp.array2d[wp.float64],
    out: wp.array[wp.float64],
):
    """Share of the looks of each pair whose colours are alike, -1 if it shares too little.

    A block each.
    """
    pair, lane = wp.tid()
    n_seen = wp.int32(0)
    alike = wp.int32(0)
    for i in range(lane, flags.shape[1], wp.block_dim()):
        flag = flags[pair, i]
        if flag >= 2:
            n_seen += 1
        if flag == 4:
            alike += 1
        if flag == 2:
            apart = wp.float32(0.0)
            for c in range(3):
                apart = wp.max(apart, wp.abs(looks[pair, c, i] - wp.float32(medians[pair, 3 + c])))
            if apart < _LIKE:
                alike += 1
    all_seen = wp.tile_sum(wp.tile(n_seen))
    all_alike = wp.tile_sum(wp.tile(alike))
    if lane == 0:
        likeness = wp.float64(-1.0)
        if wp.float64(all_seen[0]) >= _FEWEST:
            likeness = wp.float64(all_alike[0]) / wp.float64(all_seen[0])
        out[pair] = likeness


@wp.kernel
def carry_ratios(
    before: wp.array2d[wp.float64],
    flags: wp.array[wp.int32],
    lens: wp.array[wp.float64],
    after: wp.array2d[wp.float64],
):
    """Memory of all pairs, those that are no sources now too, whose weight fades.

    Nothing after a gap.
    """
    p, i = wp.tid()
    value = wp.float64(0.0)
    if flags[GAINS] != 0 and p < before.shape[0]:
        value = before[p, i]
        if i == 4:
            value = value * (wp.float64(1.0) - wp.float64(1.0) / lens[1])
    after[p, i] = value


@wp.kernel
def gains_of(
    ratios: wp.array2d[wp.float64],
    pairs: wp.array2d[wp.float64],
    likeness: wp.array[wp.float64],
    members: wp.array2d[wp.int32],
    signs: wp.array[wp.float64],
    gauge: wp.array[wp.float64],
    lens: wp.array[wp.float64],
    rows: wp.array[wp.int32],
    table: wp.array2d[wp.float64],
    system: wp.array2d[wp.float64],
    right: wp.array2d[wp.float64],
    gains: wp.array2d[wp.float32],
    odd: wp.array[wp.int32],
):
    """Mean ratios of the pairs of now, gains by least squares over them (Cholesky), and sources
    like no other; one thread.
    """
    wp.tid()
    views = gains.shape[0]
    for i in range(views):
        for j in range(views):
            system[i, j] = wp.float64(0.0)
        system[i, i] = _PRIOR
        for c in range(3):
            right[i, c] = wp.float64(0.0)
    for p in range(ratios.shape[0]):
        j = members[p, 0]
        k = members[p, 1]
        shared = pairs[p, 2] >= _FEWEST
        row = rows[p]
        count = table[row, 0]
        w = table[row, 4]
        if shared:
            count = wp.min(count + wp.float64(1.0), lens[1])
            w = pairs[p, 2] / wp.max(pairs[p, 3], wp.float64(1.0))
        table[row, 0] = count
        table[row, 4] = w
        for c in range(3):
            mean = table[row, 1 + c]
            if shared:
                mean += (signs[p] * ratios[p, c] - mean) / wp.max(count, wp.float64(1.0))
            table[row, 1 + c] = mean
            right[j, c] = right[j, c] + w * signs[p] * mean
            right[k, c] = right[k, c] - w * signs[p] * mean
        system[j, j] = system[j, j] + w
        system[k, k] = system[k, k] + w
        system[j, k] = system[j, k] - w
        system[k, j] = system[k, j] - w
    for i in range(views):
        for j in range(i + 1):
            total = system[i, j]
            for k in range(j):
                total -= system[i, k] * system[j, k]
            if i == j:
                system[i, i] = wp.sqrt(total)
            else:
                system[i, j] = total / system[j, j]
    for c in range(3):
        for i in range(views):
            total = right[i, c]
            for k in range(i):
                total -= system[i, k] * right[k, c]
            right[i, c] = total / system[i, i]
        for n in range(views):
            i = views - 1 - n
            total = right[i, c]
            for k in range(i + 1, views):
                total -= system[k, i] * right[k, c]
            right[i, c] = total / system[i, i]
        mean = wp.float64(0.0)
        for i in range(views):
            mean += gauge[i] * right[i, c]
        for i in range(views):
            gains[i, c] = wp.float32(wp.exp(-wp.clamp(right[i, c] - mean, -_LIMIT, _LIMIT)))
    closest = wp.float64(0.0)
    for p in range(likeness.shape[0]):
        closest = wp.max(closest, likeness[p])
    for i in range(views):
        best = wp.float64(-1.0)
        for p in range(likeness.shape[0]):
            if members[p, 0] == i or members[p, 1] == i:
                best = wp.max(best, likeness[p])
        odd[i] = wp.where(best >= wp.float64(0.0) and best < _ODD and closest > _COMMON, 1, 0)


@wp.kernel
def brightness(
    pinholes: wp.array2d[wp.float64],
    lens: wp.array[wp.float64],
    slope: wp.array[wp.float64],
    out: wp.array3d[wp.float32],
):
    """Brightness by row and by column.

    The sources' fall-off is taken away, and the target's, the last, put on again.
    """
    k, axis, n = wp.tid()
    at = (wp.float64(n) + wp.float64(0.5) - pinholes[k, 3 - axis]) / pinholes[k, 1 - axis]
    exponent = -slope[1] * (at * at)
    if k == pinholes.shape[0] - 1:
        exponent = -exponent
        if axis == 0:
            exponent += wp.max(-slope[1] * lens[0], wp.float64(0.0))
    elif axis == 0:
        exponent -= wp.max(-slope[1] * lens[0], wp.float64(0.0))
    out[k, axis, n] = wp.float32(wp.exp(exponent))


@wp.kernel
def shade_views(
    images: wp.array4d[wp.uint8],
    gains: wp.array2d[wp.float32],
    factors: wp.array3d[wp.float32],
    out: wp.array4d[wp.uint8],
):
    """Images times their gains and the factors of row and column, rounded and limited, see
    `kernels/shade.cpp`.
    """
    k, y, x = wp.tid()
    for c in range(3):
        level = wp.float32(images[k, y, x, c]) * (factors[k, 1, x] * gains[k, c] * factors[k, 0, y])
        out[k, y, x, c] = wp.uint8(wp.int32(wp.min(wp.max(level, 0.0), 255.0) + 0.5))


@wp.kernel
def keep_depths(
    depths: wp.array3d[wp.float32], odd: wp.array[wp.int32], out: wp.array3d[wp.float32]
):
    """Depths of the sources that are not left out, 0 of the others."""
    k, y, x = wp.tid()
    value = depths[k, y, x]
    if odd[k] != 0:
        value = wp.float32(0.0)
    out[k, y, x] = value


@wp.kernel
def darken(
    picture: wp.array3d[wp.float32], factors: wp.array3d[wp.float32], out: wp.array3d[wp.float32]
):
    """A picture (3, H, W) as the target's lens shows it."""
    y, x = wp.tid()
    k = factors.shape[0] - 1
    for c in range(3):
        out[c, y, x] = wp.min(picture[c, y, x] * factors[k, 0, y] * factors[k, 1, x], 1.0)


def estimate_exposure(
    images: Tensor,
    depths: Tensor,
    before: ExposureState,
    c: StepConstants,
    t: Tables,
    out: ExposureState,
) -> Exposure:
    """Return the gains and fall-off that make the sources agree, as `ExposureCompensation.gains`.

    Args:
        images: of the sources, (K, H, W, 3), uint8.
        depths: of the sources, filtered, (K, H, W), world units.
        before: after the instant before.
        out: after this one.
    """
    device, views, pairs = depths.device, len(images), t.sizes.pairs
    members, directed = t.pairs()
    lattices = t.lattices(compensation.REDUCTION, compensation.LATTICE_ROWS)
    points = max(
        across * down
        for _, across, down in t.sizes.lattice(compensation.REDUCTION, compensation.LATTICE_ROWS)
    )
    width, height = (side // compensation.REDUCTION + 1 for side in t.sizes.largest)
    pictures = torch.empty((views, height, width, 3), device=device)
    launch(reduce_images, (views, height, width), images, t.view_sizes, pictures)
    looks = torch.empty((pairs, 4, 2 * points), device=device)
    flags = torch.zeros((pairs, 2 * points), dtype=torch.int32, device=device)
    if views > 1:
        look_arguments = (
            pictures,
            depths,
            c.pinholes,
            t.view_sizes,
            lattices,
            directed,
            c.transforms,
            c.numbers,
            points,
        )
        launch(look_up, (2 * pairs, points), *look_arguments, looks, flags)
    of_pairs = torch.empty((pairs, 4), dtype=torch.float64, device=device)
    launch(pair_slopes, [pairs], looks, flags, c.lens, of_pairs, block=BLOCK)
    launch(common_slope, 1, of_pairs, c.lens, c.flags, before.lens, out.lens)
    ratios, likeness = (
        torch.empty(size, dtype=torch.float64, device=device) for size in ((pairs, 6), (pairs,))
    )
    launch(ratio_medians, [pairs, 6], looks, flags, of_pairs, out.lens, ratios, block=BLOCK)
    launch(compare_colours, [pairs], looks, flags, ratios, likeness, block=BLOCK)
    launch(carry_ratios, out.ratios.shape, before.ratios, c.flags, c.lens, out.ratios)
    gains, odd = (
        torch.empty((views, 3), device=device),
        torch.empty(views, dtype=torch.int32, device=device),
    )
    system, right = (
        torch.empty((views, n), dtype=torch.float64, device=device) for n in (views, 3)
    )
    gain_arguments = (ratios, of_pairs, likeness, members, c.signs, c.gauge, c.lens, c.rows)
    launch(gains_of, 1, *gain_arguments, out.ratios, system, right, gains, odd)
    factors = torch.empty((views + 1, 2, max(*t.sizes.largest, *t.sizes.target)), device=device)
    launch(brightness, factors.shape, c.pinholes, c.lens, out.lens, factors)
    return Exposure(gains, factors, odd)


def compensate(images: Tensor, exposure: Exposure) -> Tensor:
    """Return the images times their gains and without fall-off, (K, H, W, 3), uint8, as
    `flattened`.
    """
    out = torch.empty_like(images)
    launch(shade_views, images.shape[:3], images, exposure.gains, exposure.factors, out)
    return out


def leave_out(depths: Tensor, exposure: Exposure) -> Tensor:
    """Depths of the sources, (K, H, W), 0 of those whose colours are like no other's: what has no
    depth shows nothing.
    """
    out = torch.empty_like(depths)
    launch(keep_depths, depths.shape, depths, exposure.odd, out)
    return out


def show_fall_off(picture: Tensor, exposure: Exposure) -> Tensor:
    """Return a picture (3, H, W) of compensated sources as the target's lens would show it, as
    `fallen_off`.
    """
    out = torch.empty_like(picture)
    launch(darken, picture.shape[1:], picture, exposure.factors, out)
    return out
