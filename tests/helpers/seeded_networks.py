"""Networks with weights that are drawn by name, so that a test here and a run of another project
elsewhere fill them alike.
"""

import zlib

import numpy as np
import torch


def seeded_state(shapes: dict[str, tuple[int, ...]]) -> dict[str, torch.Tensor]:
    """Tensors by name, each from a generator seeded with its name; one module under two names is
    drawn once.
    """
    state = {}
    for name, shape in shapes.items():
        drawn = name.replace("downsample.1.", "norm3.")  # one module under two names
        rng = np.random.default_rng(zlib.crc32(drawn.encode()))
        if name.endswith("num_batches_tracked"):
            values = np.array(1)
        elif name.endswith("running_var"):
            values = rng.uniform(0.5, 2.0, shape)
        elif len(shape) == 1:
            values = rng.normal(
                1.0 if ".norm" in drawn and drawn.endswith("weight") else 0.0, 0.1, shape
            )
        else:
            values = rng.normal(0.0, 1.2 / np.sqrt(np.prod(shape[1:])), shape)
        state[name] = torch.from_numpy(np.asarray(values)).to(
            torch.int64 if values.dtype.kind == "i" else torch.float32
        )
    return state


def seeded_pair(height: int, width: int) -> tuple[torch.Tensor, torch.Tensor]:
    """Two images (1, 3, H, W) in 0..255: smooth noise, the right one moved by a few pixels."""
    rng = np.random.default_rng(7)
    coarse = torch.from_numpy(rng.uniform(0, 255, (1, 3, height // 8, width // 8 + 2))).float()
    wide = torch.nn.functional.interpolate(
        coarse, (height, width + 16), mode="bicubic", align_corners=False
    ).clamp(0, 255)
    return wide[..., 8 : 8 + width].contiguous(), wide[..., 12 : 12 + width].contiguous()
