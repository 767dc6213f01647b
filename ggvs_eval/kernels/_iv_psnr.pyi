from typing import Any

import numpy as np
from numpy.typing import NDArray

def matched_errors(
    rendered: NDArray[Any],
    truth: NDArray[Any],
    mask: NDArray[Any] | None,
    is_rgb: bool,
    threads: int,
    level: int,
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.int64], int]: ...
