"""Arrays in ``.npy`` files from untrusted sources."""

from pathlib import Path
from tokenize import TokenError

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.plain import check_plain

# What numpy raises on damaged headers, as flipping bytes in thousands of them has shown.
HEADER_ERRORS = (
    OSError,
    ValueError,
    TypeError,
    ArithmeticError,
    EOFError,
    SyntaxError,
    TokenError,
    RecursionError,
    MemoryError,
)


def map_array(path: Path) -> np.ndarray:
    """Return an array of numbers in a file, not read yet.

    A header that claims more than the file holds is refused. Pickles, archives and arrays of
    objects are refused unread.

    Raises:
        ValueError: absent or damaged; the message is one line.
    """
    try:
        check_plain(path)
        with np.errstate(over="ignore"):
            return np.lib.format.open_memmap(path, mode="r")
    except HEADER_ERRORS as error:
        reason = " ".join(str(error).split())[:120] or type(error).__name__
        if "Python objects" in reason:
            reason = "Object arrays cannot be loaded when allow_pickle=False"
        raise ValueError(
            "no such file" if isinstance(error, FileNotFoundError) else reason
        ) from error


def read_numbers(path: Path, shape: tuple[int | None, ...], described: str) -> Array:
    """Return the numbers of a file as floats; of this shape, any length where that has None.

    Raises:
        CaptureError: absent, damaged, or another array; `described` says what was wanted.
    """
    try:
        values = map_array(path)
    except ValueError as error:
        raise CaptureError(
            f"{path}: wanted {described}, got: {error}; write it by numpy.save"
        ) from error
    fits = len(shape) == values.ndim and all(
        side in (None, length) for side, length in zip(shape, values.shape, strict=True)
    )
    if not fits or values.dtype.kind not in "fiu":
        raise CaptureError(
            f"{path}: wanted {described}, got {values.shape} {values.dtype}; write it again"
        )
    return values.astype(np.float64)
