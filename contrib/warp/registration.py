"""Source views looked up where the target's surface projects into them: contested depth,
registration, warping.
"""

import torch
import warp as wp
from torch import Tensor

from ggvs_eval.contrib.warp.constants import SAME_SURFACE, TAU, StepConstants
from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch
from ggvs_eval.contrib.warp.splat import DeviceSplats
from ggvs_eval.contrib.warp.tables import Tables
from ggvs_eval.geometry.contested_depth import LEAST_ALPHA, LEAST_SHARE, RATIO
from ggvs_eval.pipelines.online import network_inputs

wp.set_module_options(MODULE_OPTIONS)

FAR_TIMES = wp.constant(wp.float32(1000.0))  # kFarTimes of the compiled path
FAINT = wp.constant(wp.float32(network_inputs.FAINT))


@wp.func
def image_point(m: wp.array[wp.float32], pixel: wp.vec2f, depth: wp.float32) -> wp.vec3f:
    """Image coordinates and depth in another view of a target pixel at a depth.

    The depth is not positive behind it.
    """
    z = depth * (m[6] * pixel[0] + m[7] * pixel[1] + m[8]) + m[11]
    u = (depth * (m[0] * pixel[0] + m[1] * pixel[1] + m[2]) + m[9]) / z
    v = (depth * (m[3] * pixel[0] + m[4] * pixel[1] + m[5]) + m[10]) / z
    return wp.vec3f(u, v, z)


@wp.func
def colour(image: wp.array3d[wp.uint8], y: wp.int32, x: wp.int32) -> wp.vec3f:
    """Return the levels of a pixel."""
    return wp.vec3f(
        wp.float32(image[y, x, 0]), wp.float32(image[y, x, 1]), wp.float32(image[y, x, 2])
    )


@wp.func
def spread(
    images: wp.array4d[wp.uint8],
    maps: wp.array2d[wp.float32],
    sizes: wp.array2d[wp.int32],
    pixel: wp.vec2f,
    depth: wp.float32,
) -> wp.float32:
    """Variance of the views' colours at a point of the ray, summed over channels.

    Negative where fewer than two see it.
    """
    sums = wp.vec3f()
    squares = wp.float32(0.0)
    count = wp.int32(0)
    for k in range(images.shape[0]):
        at = image_point(maps[k], pixel, depth)
        x = at[0] - 0.5
        y = at[1] - 0.5
        width = sizes[k, 0]
        height = sizes[k, 1]
        inside = (
            x >= 0.0 and y >= 0.0 and x <= wp.float32(width - 1) and y <= wp.float32(height - 1)
        )
        if at[2] > 0.0 and inside:
            left = wp.min(wp.int32(x), width - 2)
            top = wp.min(wp.int32(y), height - 2)
            across = x - wp.float32(left)
            upper = colour(images[k], top, left)
            upper += across * (colour(images[k], top, left + 1) - upper)
            lower = colour(images[k], top + 1, left)
            lower += across * (colour(images[k], top + 1, left + 1) - lower)
            value = upper + (y - wp.float32(top)) * (lower - upper)
            count += 1
            sums += value
            for c in range(3):
                # one by one: a small variance is the difference of large sums
                squares += value[c] * value[c]
    if count < 2:
        return -1.0
    square_of_sums = sums[0] * sums[0] + sums[1] * sums[1] + sums[2] * sums[2]
    return wp.max(squares - square_of_sums / wp.float32(count), 0.0) / wp.float32(count)


@wp.kernel
def settle_rays(
    fused: wp.array2d[wp.float32],
    images: wp.array4d[wp.uint8],
    maps: wp.array2d[wp.float32],
    sizes: wp.array2d[wp.int32],
    alphas: wp.array3d[wp.float32],
    depths: wp.array3d[wp.float32],
    weights: wp.array[wp.float32],
    numbers: wp.array[wp.float32],
    least_alpha: wp.float32,
    least_share: wp.float32,
    ratio: wp.float32,
    out: wp.array2d[wp.float32],
):
    """Fused depth, or that of a splat where most views contradict it and the colours agree far
    better there.
    """
    y, x = wp.tid()
    tolerance = numbers[SAME_SURFACE]
    depth = fused[y, x]
    out[y, x] = depth
    if not (depth > 0.0):
        return
    agreeing = wp.float32(0.0)
    voting = wp.float32(0.0)
    count = wp.int32(0)
    for k in range(images.shape[0]):
        if alphas[k, y, x] > least_alpha and depths[k, y, x] > 0.0:
            voting += weights[k]
            if wp.abs(depths[k, y, x] - depth) <= tolerance:
                agreeing += weights[k]
            else:
                count += 1
    if count == 0 or agreeing >= least_share * voting:
        return
    pixel = wp.vec2f(wp.float32(x) + 0.5, wp.float32(y) + 0.5)
    least = ratio * spread(images, maps, sizes, pixel, depth)
    best = depth
    for k in range(images.shape[0]):
        proposal = depths[k, y, x]
        if (
            alphas[k, y, x] > least_alpha
            and proposal > 0.0
            and wp.abs(proposal - depth) > tolerance
        ):
            value = spread(images, maps, sizes, pixel, proposal)
            if value >= 0.0 and value < least:
                least = value
                best = proposal
    out[y, x] = best


@wp.func
def depth_at(
    depth: wp.array2d[wp.float32],
    width: wp.int32,
    height: wp.int32,
    u: wp.float32,
    v: wp.float32,
    tolerance: wp.float32,
):
    """Bilinear where the four neighbours belong to one surface, else the nearest pixel's."""
    x = wp.min(wp.max(u - 0.5, 0.0), wp.float32(width - 1))
    y = wp.min(wp.max(v - 0.5, 0.0), wp.float32(height - 1))
    x0 = wp.int32(x)
    y0 = wp.int32(y)
    x1 = wp.min(x0 + 1, width - 1)
    y1 = wp.min(y0 + 1, height - 1)
    fx = x - wp.float32(x0)
    fy = y - wp.float32(y0)
    d0 = depth[y0, x0]
    d1 = depth[y0, x1]
    d2 = depth[y1, x0]
    d3 = depth[y1, x1]
    low = wp.min(wp.min(d0, d1), wp.min(d2, d3))
    high = wp.max(wp.max(d0, d1), wp.max(d2, d3))
    if low > 0.0 and high - low < tolerance:
        return (
            (1.0 - fy) * (1.0 - fx) * d0
            + (1.0 - fy) * fx * d1
            + fy * (1.0 - fx) * d2
            + fy * fx * d3
        )
    return depth[wp.int32(v), wp.int32(u)]


@wp.func
def cubic_shares(f: wp.float32) -> wp.vec4f:
    """Return the Catmull-Rom weights of four neighbours, `f` behind the second."""
    return wp.vec4f(
        f * (f * (1.0 - 0.5 * f) - 0.5),
        1.0 + f * f * (1.5 * f - 2.5),
        f * (0.5 + f * (2.0 - 1.5 * f)),
        f * f * (0.5 * f - 0.5),
    )


@wp.func
def cubic_colour(
    image: wp.array3d[wp.uint8], width: wp.int32, height: wp.int32, u: wp.float32, v: wp.float32
) -> wp.vec3f:
    """Return the Catmull-Rom sample, limited to 0 .. 255; the border is repeated."""
    first_x = wp.int32(u + 0.5) - 1
    first_y = wp.int32(v + 0.5) - 1
    across = cubic_shares(u - 0.5 - wp.float32(first_x))
    down = cubic_shares(v - 0.5 - wp.float32(first_y))
    total = wp.vec3f()
    for n in range(4):
        y = wp.min(wp.max(first_y + n - 1, 0), height - 1)
        for i in range(4):
            x = wp.min(wp.max(first_x + i - 1, 0), width - 1)
            total += (down[n] * across[i]) * colour(image, y, x)
    limited = wp.vec3f()
    for c in range(3):
        limited[c] = wp.min(wp.max(total[c], 0.0), 255.0)
    return limited


@wp.func
def surface_in_view(
    fused: wp.array2d[wp.float32],
    m: wp.array[wp.float32],
    y: wp.int32,
    x: wp.int32,
    far: wp.float32,
) -> wp.vec3f:
    """Image coordinates and depth in a view of what the target sees at a pixel, at `far` if
    unknown; no depth if that is 0.
    """
    depth = fused[y, x]
    if not (depth > 0.0):
        depth = far
    at = wp.vec3f()
    if depth > 0.0:
        at = image_point(m, wp.vec2f(wp.float32(x) + 0.5, wp.float32(y) + 0.5), depth)
    return at


@wp.func
def is_inside(at: wp.vec3f, width: wp.int32, height: wp.int32) -> wp.bool:
    """Return whether a point is in front of a camera and inside its image."""
    return (
        at[2] > 0.0
        and at[0] >= 0.0
        and at[0] < wp.float32(width)
        and at[1] >= 0.0
        and at[1] < wp.float32(height)
    )


@wp.func
def visibility_of(
    depth: wp.array2d[wp.float32],
    width: wp.int32,
    height: wp.int32,
    at: wp.vec3f,
    tolerance: wp.float32,
    slack: wp.float32,
) -> wp.float32:
    """Degree to which a view's own depth agrees that it sees a point in its image, or is forgiven:
    unknown depth is far away.
    """
    view_depth = depth_at(depth, width, height, at[0], at[1], tolerance)
    visibility = wp.float32(0.0)
    if slack > 0.0 and not (view_depth > 0.0):
        view_depth = FAR_TIMES * at[2]
    if view_depth > 0.0:
        allowed = wp.max(tolerance, slack * view_depth * at[2])
        visibility = wp.min(wp.max(2.0 - wp.abs(view_depth - at[2]) / allowed, 0.0), 1.0)
    return visibility


@wp.kernel
def warp_pixels(
    fused: wp.array2d[wp.float32],
    images: wp.array4d[wp.uint8],
    source_depths: wp.array3d[wp.float32],
    maps: wp.array2d[wp.float32],
    sizes: wp.array2d[wp.int32],
    forgiven: wp.array2d[wp.float32],
    numbers: wp.array[wp.float32],
    colours: wp.array4d[wp.float32],
    visibilities: wp.array3d[wp.float32],
):
    """Each view's image at the fused surface, 0 outside of it, and whether the view sees that.

    Colours are (K, 3, H, W).
    """
    k, y, x = wp.tid()
    tolerance = numbers[TAU]
    colour_there = wp.vec3f()
    visibility = wp.float32(0.0)
    at = surface_in_view(fused, maps[k], y, x, forgiven[k, 1])
    if is_inside(at, sizes[k, 0], sizes[k, 1]):
        visibility = visibility_of(
            source_depths[k], sizes[k, 0], sizes[k, 1], at, tolerance, forgiven[k, 0]
        )
        colour_there = cubic_colour(images[k], sizes[k, 0], sizes[k, 1], at[0], at[1]) * (
            1.0 / 255.0
        )
    for c in range(3):
        colours[k, c, y, x] = colour_there[c]
    visibilities[k, y, x] = visibility


@wp.kernel
def register_pixels(
    fused: wp.array2d[wp.float32],
    images: wp.array4d[wp.uint8],
    source_depths: wp.array3d[wp.float32],
    maps: wp.array2d[wp.float32],
    sizes: wp.array2d[wp.int32],
    forgiven: wp.array2d[wp.float32],
    splats: wp.array4d[wp.float32],
    alphas: wp.array3d[wp.float32],
    numbers: wp.array[wp.float32],
    colours: wp.array4d[wp.float32],
    coverage: wp.array3d[wp.float32],
    visibilities: wp.array3d[wp.float32],
):
    """Each view at the fused surface, mixed with its splat by visibility.

    Colours are (K, 3, H, W).
    """
    k, y, x = wp.tid()
    tolerance = numbers[TAU]
    colour = wp.vec3f(splats[k, y, x, 0], splats[k, y, x, 1], splats[k, y, x, 2])
    visibility = wp.float32(0.0)
    at = surface_in_view(fused, maps[k], y, x, forgiven[k, 1])
    if is_inside(at, sizes[k, 0], sizes[k, 1]):
        visibility = visibility_of(
            source_depths[k], sizes[k, 0], sizes[k, 1], at, tolerance, forgiven[k, 0]
        )
        if visibility > 0.0:
            captured = cubic_colour(images[k], sizes[k, 0], sizes[k, 1], at[0], at[1]) * (
                1.0 / 255.0
            )
            # where nothing was splatted there is nothing to mix with
            share = wp.where(alphas[k, y, x] > 0.0, visibility, 1.0)
            colour += share * (captured - colour)
    for c in range(3):
        colours[k, c, y, x] = colour[c]
    coverage[k, y, x] = wp.max(visibility, FAINT * alphas[k, y, x])
    visibilities[k, y, x] = visibility


def settle_depth(
    fused: Tensor,
    images: Tensor,
    splats: DeviceSplats,
    c: StepConstants,
    t: Tables,
    odd: Tensor | None = None,
) -> Tensor:
    """Return the fused depth, (H, W), replaced where most views and the colours of all except odd
    ones support a splat's.
    """
    if min(min(size) for size in t.sizes.views) < 2:  # colours cannot be interpolated
        return fused
    settled = torch.empty_like(fused)
    # in no picture of size 0 is anything seen
    sizes = t.view_sizes if odd is None else t.view_sizes * (1 - odd)[:, None]
    arguments = (
        fused,
        images,
        c.to_views,
        sizes,
        splats.alphas,
        splats.depths,
        c.weights,
        c.numbers,
    )
    launch(settle_rays, fused.shape, *arguments, LEAST_ALPHA, LEAST_SHARE, RATIO, settled)
    return settled


def register_views(
    depth: Tensor, images: Tensor, depths: Tensor, splats: DeviceSplats, c: StepConstants, t: Tables
) -> tuple[Tensor, Tensor, Tensor]:
    """Register every view by the fused depth, as `register_views` of the compiled path.

    Args:
        depth: fused, (H, W).
        images: of the sources, brought to one colour, (K, H, W, 3), uint8.
        depths: of the sources, filtered, (K, H, W).
        splats: of the same views.

    Returns:
        Colours, (K, 3, H, W), coverages and visibilities, (K, H, W).
    """
    colours = torch.empty((len(images), 3, *depth.shape), device=depth.device)
    coverage, visibilities = torch.empty_like(splats.alphas), torch.empty_like(splats.alphas)
    arguments = (
        depth,
        images,
        depths,
        c.to_views,
        t.view_sizes,
        c.forgiven,
        splats.features,
        splats.alphas,
        c.numbers,
    )
    launch(register_pixels, splats.alphas.shape, *arguments, colours, coverage, visibilities)
    return colours, coverage, visibilities


def warp_views(
    depth: Tensor, images: Tensor, depths: Tensor, c: StepConstants, t: Tables
) -> tuple[Tensor, Tensor]:
    """Sample every view where the target's surface, (H, W), projects into it, as `warp` of the
    compiled path, bicubically.

    Returns:
        Colours, (K, 3, H, W), 0 outside the images, and visibilities, (K, H, W).
    """
    colours = torch.empty((len(images), 3, *depth.shape), device=depth.device)
    visibilities = torch.empty((len(images), *depth.shape), device=depth.device)
    arguments = (depth, images, depths, c.to_views, t.view_sizes, c.forgiven, c.numbers)
    launch(warp_pixels, visibilities.shape, *arguments, colours, visibilities)
    return colours, visibilities
