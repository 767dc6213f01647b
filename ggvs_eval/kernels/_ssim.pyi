from typing import Any

import numpy as np
from numpy.typing import NDArray

def channel_means(
    rendered: NDArray[Any], truth: NDArray[Any], threads: int, level: int
) -> NDArray[np.float64]: ...
