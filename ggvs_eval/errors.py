"""Errors that a user can fix, each with a one-line message that says how, and accidents of the
machine.

The command line prints these in one line and exits with 1. Anything else is a bug and keeps its
traceback.
"""

import errno
import os
import re
import traceback
from collections.abc import Iterable
from dataclasses import dataclass
from difflib import get_close_matches
from pathlib import Path

# of a message: longer than most paths, shorter than what a hostile file calls a name
LONGEST_WORD = 1000
LONGEST_NAME = 100  # for which another is suggested: likeness takes time
REMEDIES = {
    (errno.ENOSPC, errno.EDQUOT, errno.EFBIG): "make room",
    (errno.EROFS,): "choose a folder that can be written",
    (errno.EACCES, errno.EPERM): "ask for access or choose another place",
    (errno.EEXIST, errno.ENOTDIR, errno.EISDIR): "choose another path",
    (errno.EMFILE, errno.ENFILE): "raise the limit of open files (ulimit -n) or use fewer --jobs",
    (
        errno.ECONNREFUSED,
        errno.ECONNRESET,
        errno.EPIPE,
        errno.ETIMEDOUT,
    ): "check that the other side still runs",
}
GO_ON = "finished work is kept; run the same command to resume"


class GgvsError(Exception):
    """Base of every error that the user can fix."""

    def __str__(self) -> str:
        """Return the message as one line of printable text, also if a damaged file supplied
        names.
        """
        return one_line(super().__str__())


class GgvsWarning(UserWarning):
    """Suspicious input that is processed anyway."""


class CommandError(GgvsError):
    """The command line asks for something that there is not."""


class CaptureError(GgvsError):
    """A capture on disk is incomplete, unreadable or contradicts itself."""


class OutOfStepError(CaptureError):
    """Cameras of unequal lengths or rates; pairing their frames by time opens them."""


class CameraError(GgvsError):
    """Invalid camera: NaN, non-rotation or zero size."""


class ProtocolError(GgvsError):
    """A protocol file has an unknown key, a wrong type or a value that makes no sense."""


class DepthError(GgvsError):
    """Depth cannot be computed for a camera, or a depth store does not fit the request."""


class RenderError(GgvsError):
    """Frames cannot be synthesised, or a folder of renders does not fit the protocol."""


class ViewRefusedError(RenderError):
    """The source cameras cannot cover this view; its cells are marked and the run continues."""


class MetricError(GgvsError):
    """Inputs of a metric do not fit each other or the metric's definition."""


class WeightsError(GgvsError):
    """Network weights are absent, damaged or belong to another network."""


class DeviceError(GgvsError):
    """There is no such device to compute on, or its memory is out."""


class TrainingError(GgvsError):
    """A training cannot start or continue."""


class PluginError(GgvsError):
    """A plug-in that cannot be used."""


class AbsentPartError(GgvsError):
    """A part of the package that was asked for is not installed."""


class ResultsError(GgvsError):
    """Results are absent, or two results that do not belong in one table."""


def one_line(text: str) -> str:
    r"""Return a text without line breaks, signs that cannot be printed and words beyond all
    measure.

    Examples:
        >>> one_line("a\n  b" + 2000 * "x")[:12]
        'a   bxxxxxxx'
        >>> len(one_line(60_000 * "x"))
        1003
    """
    printable = "".join(sign if sign.isprintable() else " " for sign in text)
    words = (
        word if len(word) <= LONGEST_WORD else f"{word[:LONGEST_WORD]}..."
        for word in printable.split(" ")
    )
    return " ".join(words)


def mendable(error: BaseException) -> str | None:
    """Return the line by which a user can fix an error; None for a bug of the package.

    Args:
        error: one of this package, or what the operating system refused: a full disk, a folder that
            cannot be written, ...

    Examples:
        >>> print(mendable(OSError(errno.ENOSPC, "No space left on device", "run/a.png")))
        run/a.png: No space left on device; make room; finished work is kept; ...
        >>> print(mendable(MemoryError()))
        out of memory; raise the limit (ulimit -v) or lower --jobs; finished work is kept; ...
        >>> mendable(ZeroDivisionError()) is None
        True
    """
    if isinstance(error, GgvsError):
        return str(error)
    if isinstance(error, MemoryError):
        return one_line(
            f"out of memory{': ' * bool(str(error))}{error}; raise the limit (ulimit -v) or lower "
            f"--jobs; {GO_ON}"
        )
    if not isinstance(error, OSError):
        return None
    remedy = "".join(
        f"; {remedy}" for numbers, remedy in REMEDIES.items() if error.errno in numbers
    )
    files = [
        str(name)
        for name in (error.filename, error.filename2)
        if isinstance(name, str | os.PathLike)
    ]
    reason = error.strerror or str(error) or type(error).__name__
    return one_line(f"{' -> '.join(files)}{': ' * bool(files)}{reason}{remedy}; {GO_ON}")


def did_you_mean(name: str, names: Iterable[str], cutoff: float = 0.6, prefix: str = "") -> str:
    """Suggest the known name that a mistyped one was meant to be, as the tail of a message.

    A name with the same number, written with fewer or more zeros, comes before all others.

    Args:
        cutoff: likeness from 0 to 1 below which nothing is suggested.
        prefix: of the suggestion, such as the section of a file that the names belong to.

    Returns:
        ``; did you mean NAME?``, or the empty string where no known name comes close.

    Examples:
        >>> did_you_mean("dynref", ["dynerf", "d3dmv"])
        '; did you mean dynerf?'
        >>> did_you_mean("x", ["dynerf", "d3dmv"])
        ''
        >>> (
        ...     did_you_mean("cam3", ["cam03", "cam23"]),
        ...     did_you_mean("cam03,cam23", ["cam03", "cam23"]),
        ... )
        ('; did you mean cam03?', '; separate names by spaces: cam03 cam23')
    """
    candidates = list(names)
    if "," in name and set(parts := re.split(r"[,\s]+", name.strip(", "))) <= {*candidates}:
        return f"; separate names by spaces: {' '.join(parts)}"
    alike = [
        candidate for candidate in candidates if _plain_numbers(candidate) == _plain_numbers(name)
    ]
    nearest = alike or (
        get_close_matches(name, candidates, n=1, cutoff=cutoff) if len(name) <= LONGEST_NAME else []
    )
    return f"; did you mean {prefix}{nearest[0]}?" if nearest else ""


def no_such_path(path: Path, kind: str) -> str:
    """Return the message that there is nothing at a path, with the name next to it that was
    probably meant.
    """
    place = path.parent
    names = [neighbour.name for neighbour in place.iterdir()] if place.is_dir() else []
    suggestion = did_you_mean(path.name, names, prefix="" if str(place) == "." else f"{place}/")
    return f"{path}: wanted {kind}, got no such path{suggestion or '; check it'}"


def _plain_numbers(name: str) -> str:
    return re.sub(r"\d+", lambda number: number[0].lstrip("0") or "0", name).casefold()


@dataclass(frozen=True)
class Failure:
    """Reason why something was not done.

    Attributes:
        traceback: of bugs of the package; empty if the user can fix it.
    """

    name: str
    message: str
    traceback: str = ""

    def __str__(self) -> str:
        return f"{self.name}: {' '.join(self.message.split())}"

    @classmethod
    def of(cls, name: str, error: Exception) -> "Failure":
        """Make the failure of a task from an error; call it while the error is handled."""
        line = mendable(error)
        return (
            cls(name, line)
            if line
            else cls(name, f"{type(error).__name__}: {error}", traceback.format_exc())
        )
