"""The blending network and its refiner on a device: one kernel gathers each layer's input,
convolutions are cuDNN's.

Activations are (row, column, channel), as tensor cores want them. A convolution's output is kept as
it comes; its mean and deviation are summed by two launches, and anyone who reads it normalises:
pooling, enlarging, joining and padding cost no pass of their own.
"""

from functools import lru_cache
from types import SimpleNamespace
from typing import Any

import torch
import warp as wp
from torch import Tensor, nn
from torch.nn import functional

from ggvs_eval.contrib.warp.launch import MODULE_OPTIONS, launch, vec8, wide_access
from ggvs_eval.contrib.warp.tables import corners_around, enlarged_place
from ggvs_eval.pipelines.online import refiner as rules
from ggvs_eval.pipelines.online.blend_network import LEVELS, BlendNetwork, margins

wp.set_module_options({**MODULE_OPTIONS, "fuse_fp": True})

BLOCK, MOST_BLOCKS = 256, 264
CHANNELS = 8  # that are read and written at once: every layer has a multiple
OF_WARP = {torch.float16: wp.float16, torch.float32: wp.float32}
_LEAST_WEIGHT = wp.constant(wp.float32(rules.NO_WEIGHT))
_CONTRAST_GAIN = wp.constant(wp.float32(rules.CONTRAST_GAIN))
_DEPTH_GAIN = wp.constant(wp.float32(rules.DEPTH_GAIN))
_ENOUGH = wp.constant(wp.float32(rules.ENOUGH_VIEWS))

_TAPS = """
    wp::vec_t<12, wp::float32> out;
    float v[16];
    for (int i = 0; i < 8; ++i) { v[i] = low[i]; v[8 + i] = high[i]; }
    for (int i = 0; i < 16; ++i) {
        const float value = v[i] + shift.data[i];
        v[i] = (value < 0.0f ? 0.1f * value : value) * (1.0f + gain.data[i]);
    }
    for (int t = 0; t < 12; ++t) {
        float tap = bias.data[t];
        for (int i = 0; i < 16; ++i) tap += weights.data[16 * t + i] * v[i];
        out[t] = tap;
    }
    return out;
"""
vec12 = wp.types.vector(length=12, dtype=wp.float32)


@wp.func_native(_TAPS)
def taps_of(
    low: vec8,
    high: vec8,
    shift: wp.array(dtype=wp.float32),
    gain: wp.array(dtype=wp.float32),
    weights: wp.array(dtype=wp.float32),
    bias: wp.array(dtype=wp.float32),
) -> vec12:
    """Return the filter of a pixel: leaky limit, condition, and the last layer."""


@wp.func
def reflected(at: wp.int32, size: wp.int32) -> wp.int32:
    """Return the row of an image that a row of it with a border of one shows."""
    n = at - 1
    if n < 0:
        n = -n
    if n >= size:
        n = 2 * size - 2 - n
    return n


@wp.func
def normal(
    raw: wp.float32, stats: wp.array[wp.float32], gains: wp.array2d[wp.float32], c: wp.int32
) -> wp.float32:
    """Return the normalised, limited below."""
    return wp.max((raw + gains[2, c] - stats[0]) * stats[1] * gains[0, c] + gains[1, c], 0.0)


@wp.kernel
def final_moments(
    partial: wp.array2d[wp.float64],
    count: wp.float64,
    epsilon: wp.float64,
    stats: wp.array[wp.float32],
):
    """Mean, and one over the deviation, of what the threads of `moments` summed; one block."""
    _, lane = wp.tid()
    first = wp.float64(0.0)
    second = wp.float64(0.0)
    for n in range(lane, partial.shape[0], wp.block_dim()):
        first += partial[n, 0]
        second += partial[n, 1]
    total = wp.tile_sum(wp.tile(first))
    squares = wp.tile_sum(wp.tile(second))
    mean = total[0] / count
    variance = squares[0] / count - mean * mean
    if lane == 0:
        stats[0] = wp.float32(mean)
        stats[1] = wp.float32(wp.float64(1.0) / wp.sqrt(variance + epsilon))


@lru_cache(maxsize=4)
def kernels_of(kind: Any) -> SimpleNamespace:
    """Return the kernels that read or write activations of a type of Warp."""
    load8, store8 = wide_access(kind)

    @wp.kernel(module="unique")
    def moments(
        raw: wp.array(dtype=kind),
        channels: wp.int32,
        gains: wp.array2d[wp.float32],
        partial: wp.array2d[wp.float64],
    ):
        """Sums of a block's share of a layer's output and of its squares.

        Channels is a multiple of 8.
        """
        block, lane = wp.tid()
        first = wp.float32(0.0)
        second = wp.float32(0.0)
        for n in range(
            block * wp.block_dim() + lane, raw.shape[0] // 8, partial.shape[0] * wp.block_dim()
        ):
            values = load8(raw, n)
            c = (8 * n) % channels
            for i in range(8):
                value = values[i] + gains[2, c + i]
                first += value
                second += value * value
        total = wp.tile_sum(wp.tile(wp.float64(first)))
        squares = wp.tile_sum(wp.tile(wp.float64(second)))
        if lane == 0:
            partial[block, 0] = total[0]
            partial[block, 1] = squares[0]

    @wp.kernel(module="unique")
    def first_input(
        channels: wp.array3d[wp.float32], top: wp.int32, left: wp.int32, out: wp.array3d(dtype=kind)
    ):
        """The first layer's input: a size that the levels divide, by repetition, and a border by
        reflection.
        """
        y, x, c = wp.tid()
        value = wp.float32(0.0)
        if c < channels.shape[0]:
            row = wp.clamp(reflected(y, out.shape[0] - 2) - top, 0, channels.shape[1] - 1)
            column = wp.clamp(reflected(x, out.shape[1] - 2) - left, 0, channels.shape[2] - 1)
            value = channels[c, row, column]
        out[y, x, c] = kind(value)

    @wp.kernel(module="unique")
    def again(
        raw: wp.array3d(dtype=kind),
        stats: wp.array[wp.float32],
        gains: wp.array2d[wp.float32],
        out: wp.array3d(dtype=kind),
    ):
        y, x, c = wp.tid()
        value = wp.float32(raw[reflected(y, raw.shape[0]), reflected(x, raw.shape[1]), c])
        out[y, x, c] = kind(normal(value, stats, gains, c))

    @wp.kernel(module="unique")
    def pooled(
        raw: wp.array3d(dtype=kind),
        stats: wp.array[wp.float32],
        gains: wp.array2d[wp.float32],
        out: wp.array3d(dtype=kind),
    ):
        y, x, c = wp.tid()
        row = 2 * reflected(y, out.shape[0] - 2)
        column = 2 * reflected(x, out.shape[1] - 2)
        largest = wp.float32(0.0)
        for v in range(wp.max(row - 1, 0), wp.min(row + 2, raw.shape[0])):
            for u in range(wp.max(column - 1, 0), wp.min(column + 2, raw.shape[1])):
                largest = wp.max(largest, normal(wp.float32(raw[v, u, c]), stats, gains, c))
        out[y, x, c] = kind(largest)

    @wp.kernel(module="unique")
    def joined(
        skip: wp.array3d(dtype=kind),
        skip_stats: wp.array[wp.float32],
        skip_gains: wp.array2d[wp.float32],
        below: wp.array3d(dtype=kind),
        below_stats: wp.array[wp.float32],
        below_gains: wp.array2d[wp.float32],
        out: wp.array3d(dtype=kind),
    ):
        y, x, c = wp.tid()
        row = reflected(y, skip.shape[0])
        column = reflected(x, skip.shape[1])
        if c < skip.shape[2]:
            out[y, x, c] = kind(normal(wp.float32(skip[row, column, c]), skip_stats, skip_gains, c))
        else:
            d = c - skip.shape[2]
            n = corners_around(
                enlarged_place(row, 0.5),
                enlarged_place(column, 0.5),
                below.shape[0],
                below.shape[1],
            )
            a = normal(wp.float32(below[n.y0, n.x0, d]), below_stats, below_gains, d)
            b = normal(wp.float32(below[n.y0, n.x1, d]), below_stats, below_gains, d)
            e = normal(wp.float32(below[n.y1, n.x0, d]), below_stats, below_gains, d)
            f = normal(wp.float32(below[n.y1, n.x1, d]), below_stats, below_gains, d)
            upper = (1.0 - n.fx) * a + n.fx * b
            lower = (1.0 - n.fx) * e + n.fx * f
            out[y, x, c] = kind((1.0 - n.fy) * upper + n.fy * lower)

    @wp.kernel(module="unique")
    def small_outputs(
        raw: wp.array3d(dtype=kind),
        stats: wp.array[wp.float32],
        gains: wp.array2d[wp.float32],
        weights: wp.array2d[wp.float32],
        bias: wp.array[wp.float32],
        start: wp.array[wp.float32],
        order: wp.array[wp.int32],
        most: wp.int32,
        top: wp.int32,
        left: wp.int32,
        out: wp.array3d[wp.float32],
    ):
        """The last layer, softmax over the views, tanh of colours: `blend_network.small_outputs`,
        channel last.
        """
        y, x = wp.tid()
        views = start.shape[0]
        row = y + top
        column = x + left
        largest = wp.float32(-1e30)
        for o in range(weights.shape[0]):
            if o < views or o >= most:
                total = bias[o]
                for c in range(weights.shape[1]):
                    total += weights[o, c] * normal(
                        wp.float32(raw[row, column, c]), stats, gains, c
                    )
                if o < views:
                    if order[o] >= 0:
                        total += wp.log(wp.max(start[order[o]], _LEAST_WEIGHT))
                        largest = wp.max(largest, total)
                    out[y, x, o] = total
                else:
                    at = o - most + views
                    if at > views and at < views + 4:
                        total = wp.tanh(total)
                    out[y, x, at] = total
        sum_of_shares = wp.float32(0.0)
        for o in range(views):
            share = wp.float32(0.0)
            if order[o] >= 0:
                share = wp.exp(out[y, x, o] - largest)
            sum_of_shares += share
            out[y, x, o] = share
        for o in range(views):
            out[y, x, o] = out[y, x, o] / sum_of_shares

    @wp.kernel(module="unique")
    def look_input(
        depth: wp.array2d[wp.float32],
        logarithm: wp.array2d[wp.float32],
        image: wp.array3d[wp.float32],
        spread: wp.array2d[wp.float32],
        coverage: wp.array2d[wp.float32],
        small: wp.array3d[wp.float32],
        scale: wp.int32,
        first: wp.int32,
        out: wp.array(dtype=kind),
    ):
        """Evidence and features of a pixel, with a border that repeats: `refiner.evidence` and what
        the U-Net hands over.
        """
        py, px = wp.tid()
        height = depth.shape[0]
        width = depth.shape[1]
        y = wp.clamp(py - 1, 0, height - 1)
        x = wp.clamp(px - 1, 0, width - 1)
        centre = logarithm[y, x]
        total = wp.float32(0.0)
        n_known = wp.float32(0.0)
        low5 = centre
        high5 = centre
        low3 = centre
        high3 = centre
        grey = (image[0, y, x] + image[1, y, x] + image[2, y, x]) / 3.0
        low = grey
        high = grey
        for v in range(wp.max(y - 2, 0), wp.min(y + 3, height)):
            for u in range(wp.max(x - 2, 0), wp.min(x + 3, width)):
                value = logarithm[v, u]
                if depth[v, u] > 0.0:
                    total += value
                    n_known += 1.0
                low5 = wp.min(low5, value)
                high5 = wp.max(high5, value)
                if wp.abs(v - y) <= 1 and wp.abs(u - x) <= 1:
                    low3 = wp.min(low3, value)
                    high3 = wp.max(high3, value)
                    grey = (image[0, v, u] + image[1, v, u] + image[2, v, u]) / 3.0
                    low = wp.min(low, grey)
                    high = wp.max(high, grey)
        relief = wp.float32(0.0)
        if depth[y, x] > 0.0:
            relief = centre - total / n_known
        front = vec8()
        front[0] = wp.clamp(spread[y, x], -1.0, 1.0)
        front[1] = wp.clamp(coverage[y, x] / _ENOUGH, -1.0, 1.0)
        front[2] = wp.clamp(_DEPTH_GAIN * relief, -1.0, 1.0)
        front[3] = wp.clamp(_DEPTH_GAIN * (high3 - low3), -1.0, 1.0)
        front[4] = wp.clamp(_DEPTH_GAIN / 2.0 * (high5 - low5), -1.0, 1.0)
        front[5] = wp.clamp(_CONTRAST_GAIN * (high - low), -1.0, 1.0)
        per = 1.0 / wp.float32(scale)
        n = corners_around(
            enlarged_place(y, per), enlarged_place(x, per), small.shape[0], small.shape[1]
        )
        back = vec8()
        for c in range(8):
            s = first + c
            upper = (1.0 - n.fx) * small[n.y0, n.x0, s] + n.fx * small[n.y0, n.x1, s]
            lower = (1.0 - n.fx) * small[n.y1, n.x0, s] + n.fx * small[n.y1, n.x1, s]
            value = (1.0 - n.fy) * upper + n.fy * lower
            if c < 2:
                front[6 + c] = value
            else:
                back[c - 2] = value
        at = 2 * (py * (width + 2) + px)
        store8(out, at, front)
        store8(out, at + 1, back)

    @wp.kernel(module="unique")
    def between(
        raw: wp.array(dtype=kind),
        height: wp.int32,
        width: wp.int32,
        shift: wp.array[wp.float32],
        out: wp.array(dtype=kind),
    ):
        """Leaky limit of a convolution's output and the picture's shift, with a border that
        repeats.
        """
        py, px, part = wp.tid()
        y = wp.clamp(py - 1, 0, height - 1)
        x = wp.clamp(px - 1, 0, width - 1)
        values = load8(raw, 2 * (y * width + x) + part)
        for i in range(8):
            value = values[i] + shift[8 * part + i]
            if value < 0.0:
                value = 0.1 * value
            values[i] = value
        store8(out, 2 * (py * (width + 2) + px) + part, values)

    @wp.kernel(module="unique")
    def finish(
        raw: wp.array(dtype=kind),
        shift: wp.array[wp.float32],
        gain: wp.array[wp.float32],
        weights: wp.array[wp.float32],
        bias: wp.array[wp.float32],
        image: wp.array3d[wp.float32],
        out: wp.array3d[wp.float32],
    ):
        """Each pixel's filter and the filtered picture: `refiner.filtered`."""
        y, x = wp.tid()
        height = image.shape[1]
        width = image.shape[2]
        at = 2 * (y * width + x)
        taps = taps_of(load8(raw, at), load8(raw, at + 1), shift, gain, weights, bias)
        sum_of_taps = wp.float32(0.0)
        for t in range(12):
            sum_of_taps += taps[t]
        ym2 = wp.max(y - 2, 0)
        ym1 = wp.max(y - 1, 0)
        yp1 = wp.min(y + 1, height - 1)
        yp2 = wp.min(y + 2, height - 1)
        xm2 = wp.max(x - 2, 0)
        xm1 = wp.max(x - 1, 0)
        xp1 = wp.min(x + 1, width - 1)
        xp2 = wp.min(x + 2, width - 1)
        for c in range(3):
            total = image[c, y, x] * (1.0 - sum_of_taps)
            total += taps[0] * image[c, ym2, x]
            total += taps[1] * image[c, ym1, xm1]
            total += taps[2] * image[c, ym1, x]
            total += taps[3] * image[c, ym1, xp1]
            total += taps[4] * image[c, y, xm2]
            total += taps[5] * image[c, y, xm1]
            total += taps[6] * image[c, y, xp1]
            total += taps[7] * image[c, y, xp2]
            total += taps[8] * image[c, yp1, xm1]
            total += taps[9] * image[c, yp1, x]
            total += taps[10] * image[c, yp1, xp1]
            total += taps[11] * image[c, yp2, x]
            out[c, y, x] = wp.clamp(total, 0.0, 1.0)

    return SimpleNamespace(
        moments=moments,
        first_input=first_input,
        again=again,
        pooled=pooled,
        joined=joined,
        small_outputs=small_outputs,
        look_input=look_input,
        between=between,
        finish=finish,
    )


Layer = tuple[
    Tensor, Tensor, Tensor
]  # raw output, (h, w, channels), its mean and deviation, gain, bias and shift of its channels


class DeviceNetwork:
    """A `BlendNetwork` laid out for a device.

    Args:
        network: with a refiner, on that device.
        dtype: of activations and of the factors of convolutions; sums are float32.

    Reading:
        Half precision moves a pixel of the picture by 0.005 levels of 255 at most on a benchmark's
        frames, and by 0.04 in a room with stereo depth: a hundredth of what rounding to 8 bit does.
    """

    def __init__(self, network: BlendNetwork, dtype: torch.dtype) -> None:
        self.config, self.dtype, self._refiner = network.config, dtype, network.refiner
        self._kernels, self._device = kernels_of(OF_WARP[dtype]), network.scale.device
        assert self._refiner is not None  # `covers` asks for it
        unet = network.unet
        # detached: Warp allocates a gradient for every tensor that requires one, at every launch
        with torch.no_grad():
            modules = [module for block in (*unet.down, *unet.up) for module in block.modules()]
            convolutions = [module for module in modules if isinstance(module, nn.Conv2d)]
            norms = [module for module in modules if isinstance(module, nn.GroupNorm)]
            self._epsilon = norms[0].eps
            self._layers = [self._filters(convolution) for convolution in convolutions]
            pairs = zip(norms, convolutions, strict=True)
            self._gains = [
                torch.stack([norm.weight, norm.bias, convolution.bias]).detach().contiguous()
                for norm, convolution in pairs
            ]
            self._last = _matrix(unet.last)
            self._looks = [
                (self._filters(look), look.bias.detach()) for look in self._refiner.looks
            ]
            taps, bias = _matrix(self._refiner.taps)
            self._taps = taps.view(-1), bias

    def small(self, channels: Tensor, weights: Tensor, order: Tensor) -> Tensor:
        """Evaluate the U-Net.

        Args:
            channels: of its input, (inputs, h, w).
            weights: geometric ones of the views, (K,).
            order: the view at each of the network's places, -1 for none, (K,), int32.

        Returns:
            `small_outputs`, (h, w, K + 4 + F), by the network's places.
        """
        height, width = channels.shape[1:]
        (left, right), (top, bottom) = margins(width), margins(height)
        padded = self._padded(height + top + bottom, width + left + right, self._layers[0].shape[1])
        launch(self._kernels.first_input, padded.shape, channels, top, left, padded)
        layers = iter(zip(self._layers, self._gains, strict=True))
        levels = [self._block(padded, layers)]
        for _ in range(LEVELS):
            raw, *statistics = levels[-1]
            padded = self._padded(raw.shape[0] // 2, raw.shape[1] // 2, raw.shape[2])
            launch(self._kernels.pooled, padded.shape, raw, *statistics, padded)
            levels.append(self._block(padded, layers))
        below = levels.pop()
        for skip in reversed(levels):
            padded = self._padded(*skip[0].shape[:2], skip[0].shape[2] + below[0].shape[2])
            launch(self._kernels.joined, padded.shape, *skip, *below, padded)
            below = self._block(padded, layers)
        most, outputs = self.config.views, self._last[0].shape[0]
        out = torch.empty((height, width, outputs - most + len(weights)), device=self._device)
        launch(
            self._kernels.small_outputs,
            (height, width),
            *below,
            *self._last,
            weights,
            order,
            most,
            top,
            left,
            out,
        )
        return out

    def refined(
        self,
        image: Tensor,
        spread: Tensor,
        coverage: Tensor,
        logarithm: Tensor,
        depth: Tensor,
        small: Tensor,
    ) -> Tensor:
        """Return the composed picture, (3, H, W), with every pixel's filter applied, in [0, 1].

        Args:
            spread: of the views, (H, W).
            coverage: how many views show a pixel, (H, W).
            logarithm: of the depth, (H, W).
            depth: fused, (H, W), 0 where unknown.
            small: by `small`.
        """
        height, width = depth.shape
        statistics = rules.picture_statistics(image[None], spread.clamp(max=1)[None]).float()
        shifts = [shift.contiguous() for shift in self._refiner.condition(statistics)[0].chunk(3)]
        features = small.shape[2] - self.config.features
        padded = self._padded(height, width, 2 * CHANNELS)
        seen_maps = (depth, logarithm, image, spread, coverage, small, self.config.scale, features)
        launch(self._kernels.look_input, padded.shape[:2], *seen_maps, padded.view(-1))
        (first, first_bias), (second, second_bias) = self._looks
        raw, inner = self._convolved(padded, first), self._padded(height, width, 2 * CHANNELS)
        launch(
            self._kernels.between,
            (*inner.shape[:2], 2),
            raw.view(-1),
            height,
            width,
            shifts[0] + first_bias,
            inner.view(-1),
        )
        raw, out = self._convolved(inner, second), torch.empty_like(image)
        conditions = shifts[1] + second_bias, shifts[2]
        launch(
            self._kernels.finish,
            (height, width),
            raw.view(-1),
            *conditions,
            *self._taps,
            image,
            out,
        )
        return out

    def _filters(self, convolution: nn.Module) -> Tensor:
        weight = convolution.weight.detach()
        weight = functional.pad(weight, (0, 0, 0, 0, 0, -weight.shape[1] % CHANNELS))
        return weight.to(self.dtype).contiguous(memory_format=torch.channels_last)

    def _padded(self, height: int, width: int, channels: int) -> Tensor:
        return torch.empty((height + 2, width + 2, channels), dtype=self.dtype, device=self._device)

    def _block(self, padded: Tensor, layers: Any) -> Layer:
        """Return two convolutions, each normalised by anyone who reads it."""
        filters, gains = next(layers)
        raw = self._convolved(padded, filters)
        inner = self._padded(*raw.shape)
        launch(self._kernels.again, inner.shape, raw, self._moments(raw, gains), gains, inner)
        filters, gains = next(layers)
        raw = self._convolved(inner, filters)
        return raw, self._moments(raw, gains), gains

    @staticmethod
    def _convolved(padded: Tensor, filters: Tensor) -> Tensor:
        """(H + 2, W + 2, C) to (H, W, C'); anyone who reads it adds the bias."""
        return (
            functional.conv2d(padded.permute(2, 0, 1)[None], filters)[0]
            .permute(1, 2, 0)
            .contiguous()
        )

    def _moments(self, raw: Tensor, gains: Tensor) -> Tensor:
        """Return the mean of a layer's output and one over its deviation, (2,)."""
        blocks = max(1, min(MOST_BLOCKS, raw.numel() // (CHANNELS * BLOCK)))
        partial = torch.empty((blocks, 2), dtype=torch.float64, device=raw.device)
        stats = torch.empty(2, device=raw.device)
        launch(
            self._kernels.moments, [blocks], raw.view(-1), raw.shape[2], gains, partial, block=BLOCK
        )
        launch(final_moments, [1], partial, float(raw.numel()), self._epsilon, stats, block=BLOCK)
        return stats


def _matrix(convolution: nn.Conv2d) -> tuple[Tensor, Tensor]:
    """Filters of one pixel, (outputs, inputs), and biases."""
    assert convolution.bias is not None
    return convolution.weight[:, :, 0, 0].detach().contiguous(), convolution.bias.detach()
