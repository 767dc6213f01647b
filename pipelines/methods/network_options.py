"""Options of `--weights`, `--splats` and `--device`."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path


@dataclass(frozen=True)
class NetworkOptions:
    """Options of the methods' networks that differ from user to user.

    Attributes:
        checkpoints: method -> file of weights that the user gave, of methods whose weights do not
            ship.
        splats: label -> files of fitted 3D Gaussians, which become a method of that label.
        device: ``cpu``, where equal inputs give equal bits, ``cuda`` or ``cuda:N``.
    """

    checkpoints: Mapping[str, Path] = field(default_factory=dict)
    splats: Mapping[str, Path] = field(default_factory=dict)
    device: str = "cpu"


AS_SHIPPED = NetworkOptions()


def checked_device(name: str) -> str:
    """Return the device of a name, ``auto`` included."""
    if name == "cpu":  # needs no torch
        return name
    from ggvs_eval.compute_device import compute_device

    return str(compute_device(name))
