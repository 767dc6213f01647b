"""What a user can mend: one family, each with a one-line message that says how.

The command line prints these in one line and exits with 1. Anything else is our bug and keeps its traceback.
"""

from collections.abc import Iterable
from difflib import get_close_matches


class GgvsError(Exception):
    """Base of every error that the user can mend."""

    def __str__(self) -> str:
        """The message in one line of printable text, whatever names a damaged file has put into it."""
        return "".join(sign if sign.isprintable() else " " for sign in super().__str__())


class CommandError(GgvsError):
    """The command line asks for something that there is not."""


class CaptureError(GgvsError):
    """A capture on disk is incomplete, unreadable or contradicts itself."""


class CameraError(GgvsError):
    """A camera is not a camera: NaN, not a rotation, no size."""


class ProtocolError(GgvsError):
    """A protocol file has an unknown key, a wrong type or a value that makes no sense."""


class DepthError(GgvsError):
    """Depth cannot be computed for a camera, or a depth store does not fit the request."""


class RenderError(GgvsError):
    """Frames cannot be synthesised, or a folder of renders does not fit the protocol."""


class MetricError(GgvsError):
    """Inputs of a metric do not fit each other or the metric's definition."""


class WeightsError(GgvsError):
    """Network weights are absent, damaged or belong to another network."""


class DeviceError(GgvsError):
    """There is no such device to compute on, or its memory is out."""


class TrainingError(GgvsError):
    """A training cannot start or go on."""


class ResultsError(GgvsError):
    """Results are absent, or two results must not stand in one table."""


def did_you_mean(name: str, known: Iterable[str], cutoff: float = 0.6, prefix: str = "") -> str:
    """Suggest the known name that a mistyped one was meant to be, as the tail of a message.

    Args:
        name: as the user wrote it.
        known: the names that there are.
        cutoff: likeness from 0 to 1 below which nothing is suggested.
        prefix: of the suggestion, such as the section of a file that the names belong to.

    Returns:
        ``; did you mean NAME?``, or the empty string where no known name comes close.

    Examples:
        >>> did_you_mean("dynref", ["dynerf", "d3dmv"])
        '; did you mean dynerf?'
        >>> did_you_mean("x", ["dynerf", "d3dmv"])
        ''
    """
    nearest = get_close_matches(name, known, n=1, cutoff=cutoff)
    return f"; did you mean {prefix}{nearest[0]}?" if nearest else ""
