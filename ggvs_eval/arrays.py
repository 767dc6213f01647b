"""Array types by element and meaning."""

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]  # any shape; said where it is used
Array32 = NDArray[np.float32]
Vector = NDArray[np.float64]  # one dimension
Indices = NDArray[np.intp]
Map = NDArray[np.float32]  # one value per pixel, (H, W)
Mask = NDArray[np.bool_]  # which pixels, (H, W), or which of something else
Image8 = NDArray[np.uint8]  # (H, W, 3) RGB, 0..255
