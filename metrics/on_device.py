"""Frames on a device, for the metrics that compute there: uploads, means of windows, correlations.

Small computations stay on the host: the block entropies of ST-RRED's band, a sixty-fourth of the
pixels. PSNR, L1 and SDT take a tenth of a millisecond there.
"""

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor
from torch.nn import functional

from ggvs_eval.arrays import Array, Image8
from ggvs_eval.metrics.metric import TruthFrame, shared_by_parts

UPLOADED = "uploaded"


def upload_pair(rendered: Image8, truth: TruthFrame, device: str) -> tuple[Tensor, Tensor]:
    """Return a rendered and a captured frame on the device, (H, W, 3) uint8.

    Each is uploaded once for all metrics.
    """
    truth_tensor = truth.once((UPLOADED, device), lambda: upload(truth.image, device))
    return shared_by_parts(
        rendered, truth, (UPLOADED, device), lambda: upload(rendered, device)
    ), truth_tensor


def upload(image: Image8, device: str) -> Tensor:
    """Return a frame on the device."""
    return torch.from_numpy(np.ascontiguousarray(image)).to(device)


@torch.inference_mode()
def unit_range(image: Tensor, border: int = 0) -> Tensor:
    """Return a frame (H, W, 3) uint8 as doubles in [0, 1], with a black border of N pixels."""
    return functional.pad(image.double() / 255, (0, 0, border, border, border, border))


@torch.inference_mode()
def window_means(planes: Tensor, taps: Sequence[float]) -> Tensor:
    """Weighted mean of every window inside the planes (H, W, C).

    The window is the product of the taps along both axes.

    Sums of shifted planes: cuDNN would choose the order of its sums itself.
    """
    for axis in (0, 1):
        size = planes.shape[axis] - len(taps) + 1
        means = torch.zeros_like(planes.narrow(axis, 0, size))
        for first, weight in enumerate(taps):
            means.add_(planes.narrow(axis, first, size), alpha=weight)
        planes = means
    return planes


@torch.inference_mode()
def correlate(plane: Tensor, kernel: Array, stride: int = 1) -> Tensor:
    """Return the correlation of a plane (H, W) of doubles reflected at its border (the edge not
    repeated), with a stride.
    """
    border = kernel.shape[0] // 2
    padded = functional.pad(plane[None, None], (border, border, border, border), mode="reflect")
    with torch.backends.cudnn.flags(enabled=True, deterministic=True):
        return functional.conv2d(
            padded, torch.from_numpy(kernel).to(plane.device)[None, None], stride=stride
        )[0, 0]
