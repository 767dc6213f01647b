"""Plain files: anything but a regular file of a plausible size is refused before it is read."""

import codecs
import errno
import os
import re
import stat
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

KINDS = ((stat.S_ISDIR, "a folder"), (stat.S_ISFIFO, "a pipe"), (stat.S_ISSOCK, "a socket"))
LARGEST_TEXT = 32 << 20
LARGEST_TOML = 4 << 20  # its parser takes a second per MB
LARGEST_PICTURE = 256 << 20
# What was never written reads as zeros: a file that is nothing else takes minutes to read and holds
# no frame.
SPARSE_FROM, SPARSE_SHARE, BLOCK_BYTES = 1 << 30, 0.01, 512
# Byte order marks: Notepad and PowerShell begin their texts with one, PowerShell 5 writes UTF-16.
MARKS = {codecs.BOM_UTF8: "utf-8-sig", codecs.BOM_UTF16_LE: "utf-16", codecs.BOM_UTF16_BE: "utf-16"}
DECIMAL_COMMA = re.compile(r"[-+]?\d+,\d+([eE][-+]?\d+)?")


_watched: list[set[str]] = []


@contextmanager
def watch_reads() -> Iterator[set[str]]:
    """Collect the absolute paths of the files that are looked at inside."""
    paths: set[str] = set()
    _watched.append(paths)
    try:
        yield paths
    finally:
        _watched.remove(paths)


class NotPlainError(OSError):
    """A pipe, a device, a folder, or more bytes than were asked for."""

    def __str__(self) -> str:
        """State what was found; the caller adds the file."""
        return str(self.strerror)


def check_plain(path: Path, most_bytes: int | None = None) -> int:
    """Refuse files that reading would wait for, or never end with.

    Args:
        most_bytes: that it may have; None if nothing of it is read at once.

    Raises:
        NotPlainError: no regular file, or a larger one.
        OSError: no such file, or no permission.
    """
    for paths in _watched:
        paths.add(os.path.abspath(path))
    status = path.stat()
    if not stat.S_ISREG(status.st_mode):
        kind = next((kind for is_kind, kind in KINDS if is_kind(status.st_mode)), "a device")
        raise _refused(path, f"{kind} instead of a regular file")
    if most_bytes is not None and status.st_size > most_bytes:
        raise _refused(
            path, f"{status.st_size / 1e6:.0f} MB, above the limit of {most_bytes / 1e6:.0f} MB"
        )
    on_disk = status.st_blocks * BLOCK_BYTES
    if status.st_size > SPARSE_FROM and on_disk < SPARSE_SHARE * status.st_size:
        raise _refused(
            path,
            f"{status.st_size / 1e6:.0f} MB, of which {on_disk / 1e6:.0f} MB are on the disk: a "
            f"sparse file",
        )
    return status.st_size


def read_plain(path: Path, most_bytes: int) -> bytes:
    """Return the content of a regular file; arguments and errors as of `check_plain`."""
    check_plain(path, most_bytes)
    # Not blocking, should it have become a pipe meanwhile.
    with os.fdopen(os.open(path, os.O_RDONLY | os.O_NONBLOCK), "rb") as file:
        content = file.read(most_bytes + 1)
    if len(content) > most_bytes:  # files below /proc have no size
        raise _refused(path, f"more than the limit of {most_bytes / 1e6:.0f} MB")
    return content


def read_plain_text(path: Path, most_bytes: int = LARGEST_TEXT) -> str:
    """Return the text (UTF-8, or what its byte order mark says) of a regular file.

    Line ends become those of Unix.

    Raises:
        OSError: as of `check_plain`.
        UnicodeDecodeError: no text.
    """
    content = read_plain(path, most_bytes)
    return content.decode(coding_of(content)).replace("\r\n", "\n").replace("\r", "\n")


def coding_of(content: bytes) -> str:
    """Return the coding of a text by its first bytes; UTF-8 where they are no byte order mark."""
    return next((coding for mark, coding in MARKS.items() if content.startswith(mark)), "utf-8")


def comma_hint(word: str) -> str:
    """Hint that a message adds to a word that is no number because of its decimal comma.

    Empty for others.

    Examples:
        >>> comma_hint("86,88")
        ', which has a decimal comma: write 86.88'
    """
    return (
        f", which has a decimal comma: write {word.replace(',', '.')}"
        if DECIMAL_COMMA.fullmatch(word)
        else ""
    )


def parse_numbers(text: str, first_line: int = 1) -> list[list[float]]:
    """Return the numbers in each line of a text.

    Raises:
        ValueError: a word that is no number; the message has its line, counted from `first_line`.
    """
    rows = []
    for line, words in enumerate(map(str.split, text.splitlines()), first_line):
        try:
            rows.append([float(word) for word in words])
        except ValueError:
            wrong = next(word for word in words if not _is_number(word))
            raise ValueError(
                f"line {line}: no number in {wrong!r:.60}{comma_hint(wrong)}"
            ) from None
    return rows


def _is_number(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return False
    return True


def why_unread(error: OSError) -> str:
    """State in a few words why a file could not be read."""
    if isinstance(error, FileNotFoundError) and error.filename:
        return "a link to nothing" if os.path.islink(error.filename) else "no such file"
    return "no such file" if isinstance(error, FileNotFoundError) else str(error.strerror or error)


def _refused(path: Path, reason: str) -> NotPlainError:
    return NotPlainError(errno.EINVAL, reason, str(path))


def ffmpeg_name(path: Path) -> str:
    """Return a path as FFmpeg takes it: what precedes a colon in a relative one would be a
    protocol.
    """
    return os.path.abspath(path)
