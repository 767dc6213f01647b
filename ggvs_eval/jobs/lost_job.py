"""What comes of a job whose process died under it."""

from dataclasses import dataclass


@dataclass(frozen=True)
class LostJob:
    """A job that took its process with it as often as it was tried.

    Attributes:
        reason: how often, and what to do; one line.
    """

    reason: str
