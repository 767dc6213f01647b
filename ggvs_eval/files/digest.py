"""Content digests of files that may be large: cheap enough to take at every run, true enough to notice a change."""

import hashlib
from collections.abc import Iterable
from pathlib import Path

from ggvs_eval.errors import CaptureError
from ggvs_eval.files.plain import check_plain, why_unread

EDGE_BYTES = 1 << 20
BLOCK_BYTES = 1 << 16
BLOCKS = 16


def digest_files(paths: Iterable[Path]) -> str:
    """SHA-256 over the name, size and content of files, in the given order.

    Of a file above 3 MiB only a sample is read: its first and last MiB and 16 evenly spaced blocks of 64 KiB, so that a change
    which keeps the size and touches none of them goes unnoticed. Re-encoding, cutting or replacing a video changes the digest.

    Args:
        paths: files; only their names enter, not their folders, so that a moved capture keeps its digest.

    Raises:
        CaptureError: no such file, or no regular one.

    Returns:
        64 hexadecimal digits.
    """
    total = hashlib.sha256()
    for path in paths:
        try:
            size = check_plain(path)
        except OSError as error:
            raise CaptureError(f"{path}: wanted a file, got {why_unread(error)}; restore it or remove it") from error
        total.update(f"{path.name}\0{size}\0".encode())
        with path.open("rb") as file:
            if size <= 2 * EDGE_BYTES + BLOCKS * BLOCK_BYTES:
                total.update(file.read())
                continue
            total.update(file.read(EDGE_BYTES))
            for block in range(BLOCKS):
                file.seek(block * (size - BLOCK_BYTES) // (BLOCKS - 1))
                total.update(file.read(BLOCK_BYTES))
            file.seek(-EDGE_BYTES, 2)
            total.update(file.read())
    return total.hexdigest()


def digest_values(*values: str) -> str:
    """SHA-256 over some texts, for content that is made of other content.

    Examples:
        >>> digest_values("a", "bc") == digest_values("ab", "c")
        False
    """
    return hashlib.sha256("\0".join(values).encode()).hexdigest()
