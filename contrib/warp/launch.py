"""Launch of this package's kernels on the device and the stream of their tensors, and accesses of
16 bytes within kernels.
"""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from functools import lru_cache
from typing import Any

import torch
import warp as wp
from torch import Tensor

# otherwise it lists its devices in the output of every command
wp.config.log_level = wp.LOG_WARNING
wp.init()

# No gradients pass, and products are rounded before they are added, as the compiled kernels do:
# ties are then decided alike.
MODULE_OPTIONS = {"enable_backward": False, "fuse_fp": False}


def launch(kernel: Any, size: int | Sequence[int], *arguments: Any, block: int = 0) -> None:
    """Launch a kernel on the device of its tensors; nothing is copied.

    Args:
        kernel: of Warp.
        size: of the grid of threads; of the grid of blocks where `block` is given.
        arguments: tensors, whose layouts Warp checks, and numbers.
        block: threads that work on one item together; at most 512, since more have too few
            registers.
    """
    device = next(argument.device for argument in arguments if isinstance(argument, Tensor))
    values = [
        wp.from_torch(argument, return_ctype=True) if isinstance(argument, Tensor) else argument
        for argument in arguments
    ]
    place = wp.device_from_torch(device)
    if block:
        wp.launch_tiled(
            kernel, dim=size, inputs=values, block_dim=block, device=place, record_tape=False
        )
    else:
        wp.launch(kernel, dim=size, inputs=values, device=place, record_tape=False)


@contextmanager
def on_current_stream(device: torch.device) -> Iterator[None]:
    """Within, Warp launches on torch's current stream of a GPU, which may be recorded.

    Nothing on the CPU.
    """
    if device.type == "cpu":
        yield
        return
    with wp.ScopedStream(
        _of_warp(device, torch.cuda.current_stream(device).cuda_stream), sync_enter=False
    ):
        yield


@lru_cache(maxsize=64)
def _of_warp(device: torch.device, handle: int) -> Any:
    """Warp's name of a stream, made before anything is recorded there."""
    return wp.Stream(wp.device_from_torch(device), cuda_stream=handle)


def sort_pairs(keys: Tensor, values: Tensor, count: int, bits: int) -> None:
    """Sort the first `count` keys by their lowest bits, and the values with them, in place.

    Equal keys keep their order.

    Args:
        keys: (2 count,), int32, not negative; the second half is for the sort's own use.
        values: the same.
        count: number of them.
        bits: that differ.
    """
    wp.utils.radix_sort_pairs(wp.from_torch(keys), wp.from_torch(values), count, 0, bits)


class WorkStream:
    """A stream of a GPU that torch and Warp work on, or nothing on the CPU.

    It is made once: Warp keeps the memory of its sorts by stream, and frees it with the stream.
    """

    def __init__(self, device: torch.device) -> None:
        self.device = device
        self.stream = torch.cuda.Stream(device) if device.type == "cuda" else None
        self._of_warp = wp.stream_from_torch(self.stream) if self.stream else None

    @contextmanager
    def working(self) -> Iterator[None]:
        """Within, torch and Warp launch on this stream."""
        if self.stream is None:
            yield
            return
        with torch.cuda.stream(self.stream), wp.ScopedStream(self._of_warp, sync_enter=False):
            yield

    @contextmanager
    def recording(self, graph: torch.cuda.CUDAGraph, pool: Any) -> Iterator[None]:
        """Within, what is launched is recorded and not run.

        Warp knows it, so that its sorts allocate within the graph.
        """
        with torch.cuda.graph(
            graph, pool=pool, stream=self.stream, capture_error_mode="thread_local"
        ):
            wp.capture_begin(stream=self._of_warp, external=True)
            try:
                yield
            finally:
                wp.capture_end(stream=self._of_warp)


# Warp's vectors have the alignment of a float, so that a compiler makes four accesses of what can
# be one.
_LOAD4 = """
#if defined(__CUDA_ARCH__)
    const float4 v = __ldg(reinterpret_cast<const float4*>(values.data) + index);
    return wp::vec_t<4, wp::float32>(v.x, v.y, v.z, v.w);
#else
    const float* v = values.data + 4 * (size_t)index;
    return wp::vec_t<4, wp::float32>(v[0], v[1], v[2], v[3]);
#endif
"""
_STORE4 = """
#if defined(__CUDA_ARCH__)
    float4* stored = reinterpret_cast<float4*>(values.data);
    stored[index] = make_float4(value[0], value[1], value[2], value[3]);
#else
    float* v = values.data + 4 * (size_t)index;
    for (int i = 0; i < 4; ++i) v[i] = value[i];
#endif
"""
_LOAD_HALF = """
    wp::vec_t<8, wp::float32> out;
#if defined(__CUDA_ARCH__)
    const uint4 v = __ldg(reinterpret_cast<const uint4*>(values.data) + index);
    const unsigned int w[4] = {v.x, v.y, v.z, v.w};
    for (int i = 0; i < 4; ++i) {
        wp::half low, high;
        low.u = (unsigned short)(w[i] & 65535u);
        high.u = (unsigned short)(w[i] >> 16);
        out[2 * i] = wp::half_to_float(low);
        out[2 * i + 1] = wp::half_to_float(high);
    }
#else
    for (int i = 0; i < 8; ++i) out[i] = wp::half_to_float(values.data[8 * (size_t)index + i]);
#endif
    return out;
"""
_STORE_HALF = """
#if defined(__CUDA_ARCH__)
    unsigned int w[4];
    for (int i = 0; i < 4; ++i)
        w[i] = (unsigned int)wp::float_to_half(value[2 * i]).u
             | ((unsigned int)wp::float_to_half(value[2 * i + 1]).u << 16);
    reinterpret_cast<uint4*>(values.data)[index] = make_uint4(w[0], w[1], w[2], w[3]);
#else
    for (int i = 0; i < 8; ++i) values.data[8 * (size_t)index + i] = wp::float_to_half(value[i]);
#endif
"""
_LOAD_SINGLE = """
    wp::vec_t<8, wp::float32> out;
    for (int i = 0; i < 8; ++i) out[i] = values.data[8 * (size_t)index + i];
    return out;
"""
_STORE_SINGLE = "    for (int i = 0; i < 8; ++i) values.data[8 * (size_t)index + i] = value[i];\n"

vec8 = wp.types.vector(length=8, dtype=wp.float32)


@wp.func_native(_LOAD4)
def load4(values: wp.array(dtype=wp.float32), index: wp.int32) -> wp.vec4f:
    """Return four numbers at once."""


@wp.func_native(_STORE4)
def store4(values: wp.array(dtype=wp.float32), index: wp.int32, value: wp.vec4f):
    """Write four numbers at once."""


def wide_access(kind: Any) -> tuple[Any, Any]:
    """Functions of kernels that read and write eight activations of type `kind`, float16 or
    float32, at once.
    """
    half = kind is wp.float16

    @wp.func_native(_LOAD_HALF if half else _LOAD_SINGLE)
    def load8(values: wp.array(dtype=kind), index: wp.int32) -> vec8:
        """Eight activations at once."""

    @wp.func_native(_STORE_HALF if half else _STORE_SINGLE)
    def store8(values: wp.array(dtype=kind), index: wp.int32, value: vec8):
        """Write eight activations at once."""

    return load8, store8
