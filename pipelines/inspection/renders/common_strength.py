"""Strength of a fault, judged over all views together.

A script that writes frames wrongly does so in every view alike; honest methods and cameras differ
from view to view. So the estimates of the views are pooled, with an error that has three parts: the
scatter of the views, how far honest views scatter as a rule (a few views say little about that),
and what the parts of a picture disagree by, of which more views lower only some.
"""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import stdtrit

# Number of views that the known scatter of honest views is worth.
PRIOR_VIEWS = 4
# Two-sided levels: of a strength that is reported, and of its interval.
FAULT_LEVEL, INTERVAL_LEVEL = 0.99, 0.95
# Of what the parts of a picture disagree by: error of each view for itself, and of all alike. Wrong
# depth moved the pictures of an honest method by up to 0.9 of it in the mean of nine views.
ERROR_OF_VIEW, ERROR_OF_ALL = 0.6, 0.3
Vector = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Strength:
    """Parameters of a change that some views share.

    Attributes:
        value: (parameters,), zero where nothing is changed.
        half_width: of their intervals, (parameters,).
        evidence: in units of what a fault needs, (parameters,).
    """

    value: Vector
    half_width: Vector
    evidence: Vector


def pool_strengths(values: Vector, honest: float | Vector, uneven: Vector) -> Strength:
    """Pool the estimates of some views, (views, parameters).

    Args:
        values: (views, parameters).
        honest: standard deviation over honest views, of all parameters or each.
        uneven: what the parts of a picture disagree by, (parameters,).
    """
    freedom = PRIOR_VIEWS + len(values) - 1
    value = values.mean(axis=0)
    prior = honest**2 + (ERROR_OF_VIEW * uneven) ** 2
    variance = (PRIOR_VIEWS * prior + np.square(values - value).sum(axis=0)) / freedom
    error = np.sqrt(variance / len(values) + (ERROR_OF_ALL * uneven) ** 2)
    needed, width = stdtrit(freedom, (1 + np.array([FAULT_LEVEL, INTERVAL_LEVEL])) / 2)
    return Strength(value, width * error, np.abs(value) / error / needed)


def find_strengths(values: Vector, honest: float, uneven: Vector) -> list[Strength | None]:
    """Return the strength that all views share if it explains each of them better than none does.

    Else each view's own.

    Args:
        values: (views, parameters).
        honest: standard deviation of each parameter over honest views.
        uneven: what the parts of each picture disagree by, (views, parameters).

    Returns:
        One for each view; None where a fault is not evident.

    Examples:
        >>> alike, single = (np.array([[0.0], [x], [x + 0.01]]) + 0.5 for x in (0, 0.5))
        >>> honest, even = 0.03, np.zeros((3, 1))
        >>> [strength.value.round(1).tolist() for strength in find_strengths(alike, honest, even)]
        [[0.5], [0.5], [0.5]]
    """
    shared = pool_strengths(values, honest, np.median(uneven, axis=0))
    left, total = (np.linalg.norm(residual, axis=1) for residual in (values - shared.value, values))
    if shared.evidence.max() >= 1 and (left < total).all():
        return [shared] * len(values)
    if len(values) == 1:
        return [None]
    return [
        find_strengths(values[i : i + 1], honest, uneven[i : i + 1])[0] for i in range(len(values))
    ]
