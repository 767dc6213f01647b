"""Launch of this room's kernels: on the device and the stream of the tensors that they are given."""

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import torch
import warp as wp

wp.config.log_level = wp.LOG_WARNING  # it tells of its devices otherwise, into whatever a command prints
wp.init()

# No gradients pass, and products are rounded before they are added, as the compiled kernels do: ties are then decided alike.
MODULE_OPTIONS = {"enable_backward": False, "fuse_fp": False}


def launch(kernel: Any, size: int | Sequence[int], *arguments: Any) -> None:
    """Launch a kernel where its tensors lie; nothing is copied.

    Args:
        kernel: of Warp.
        size: of the grid of threads.
        arguments: tensors, whose layouts Warp checks, and numbers.
    """
    device = next(each.device for each in arguments if isinstance(each, torch.Tensor))
    values = [wp.from_torch(each, return_ctype=True) if isinstance(each, torch.Tensor) else each for each in arguments]
    wp.launch(kernel, dim=size, inputs=values, device=wp.device_from_torch(device), record_tape=False)


@contextmanager
def on_stream_of(device: torch.device) -> Iterator[None]:
    """Within, Warp works on torch's current stream of a GPU, so that neither waits for the other; nothing on the CPU."""
    if device.type == "cpu":
        yield
        return
    with wp.ScopedStream(wp.stream_from_torch(torch.cuda.current_stream(device)), sync_enter=False):
        yield


def sort_pairs(keys: torch.Tensor, values: torch.Tensor, count: int, bits: int) -> None:
    """Sort the first `count` keys by their lowest bits, and the values with them, in place; equal keys keep their order.

    Args:
        keys: (2 count,), int32, not negative; the second half is for the sort's own use.
        values: the same.
        count: so many.
        bits: that differ.
    """
    wp.utils.radix_sort_pairs(wp.from_torch(keys), wp.from_torch(values), count, 0, bits)


def exclusive_sum(counts: torch.Tensor, out: torch.Tensor) -> None:
    """Sum of the counts before each, (N,), int32."""
    wp.utils.array_scan(wp.from_torch(counts), wp.from_torch(out), inclusive=False)
