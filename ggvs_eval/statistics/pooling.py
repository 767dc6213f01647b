"""Rules by which a metric's number comes from its parts, as functions of how much each view and
each frame counts.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import ResultsError

# weights of the views (R, V) or (1, V), of the frames (R, T) or (1, T) -> numbers (R,)
Pool = Callable[[Array, Array], Array]

OVER_FRAMES, OVER_VIEWS = "deviation over frames", "deviation over views"


@dataclass(frozen=True)
class Pooling:
    """Rule that makes a metric's number on a scene of values per view and frame: plain data that
    travels with the results.

    Attributes:
        rule: one of `RULES`.
        parts: names in the table of what the rule is applied to; empty if that is the metric
            itself.
        settings: further arguments of the rule.
    """

    rule: str
    parts: tuple[str, ...] = ()
    settings: Mapping[str, Any] = field(default_factory=dict)

    def __post_init__(self) -> None:
        if self.rule not in RULES:
            raise ResultsError(
                f"wanted a pooling rule of {', '.join(RULES)}, got {self.rule!r}; use the version "
                f"that scored it"
            )

    @property
    def no_interval(self) -> str:
        """Reason why numbers by this rule have no interval, though two of them can be compared.

        Empty if they have one.

        Reading:
            The deviation of a short correlated clip is too small on average and its square has a
            long tail: intervals of it cover 85 to 95 % for normal errors and 80 to 85 % for
            heavy-tailed ones at any length. In the difference of two methods both cancel: 3 to 7 %
            of false alarms (`benchmarks/interval_coverage.py`).
        """
        return (
            "a deviation of correlated frames, whose intervals have too low coverage"
            if self.squares
            else ""
        )

    @property
    def squares(self) -> bool:
        """True if what a frame moves is a square of its errors."""
        return self.rule == OVER_FRAMES

    @property
    def takes_views_as_given(self) -> bool:
        """True if its views are not a sample of others: the error of a deviation over few views is
        unknown.
        """
        return self.rule == OVER_VIEWS

    @classmethod
    def read(cls, record: Mapping[str, Any]) -> "Pooling":
        """Read a rule from its record."""
        return cls(record["rule"], tuple(record["parts"]), record["settings"])

    def record(self) -> dict[str, Any]:
        """Return the same as JSON values."""
        return {"rule": self.rule, "parts": list(self.parts), "settings": dict(self.settings)}

    def pool(self, *values: Array) -> Pool:
        """Return the number as a function of the weights, from the (V, T) values of each part."""
        return RULES[self.rule](*values, **self.settings)


def powers_of_means(powers: Mapping[str, float]) -> Pooling:
    """In each view the product of the means over frames of some parts, each to a power.

    Then the mean over views.

    Args:
        powers: name of the part in the table -> power: 1 and 1 for a product of means, 1 and -1 for
            a ratio of sums, 0.5 for the root of a mean.
    """
    return Pooling("powers of means", tuple(powers), {"powers": list(powers.values())})


def pool_mean(values: Array) -> Pool:
    """Return the mean over frames, then views, of (V, T)."""
    return lambda views, frames: (views * (frames @ values.T)).sum(axis=1)


def pool_powers(*parts: Array, powers: tuple[float, ...]) -> Pool:
    """Return the mean over views of the product of powers of means over frames, each part
    (V, T).
    """

    def pool(views: Array, frames: Array) -> Array:
        product = views
        # a number that is not finite is refused with its scene's name
        with np.errstate(divide="ignore", invalid="ignore"):
            for part, power in zip(parts, powers, strict=True):
                product = product * (frames @ part.T) ** power
        return np.asarray(product.sum(axis=1))

    return pool


def pool_products(*parts: Array) -> Pool:
    """Return the mean over frames, then views, of the product of some parts, each (V, T)."""
    return pool_mean(np.prod(parts, axis=0))


def pool_sdt(values: Array, ddof: int = 1) -> Pool:
    """Return the mean over views of the standard deviation over frames of (V, T)."""
    centred, factor = values - values.mean(axis=1, keepdims=True), _unbiased(values.shape[1], ddof)

    def pool(views: Array, frames: Array) -> Array:
        variance = frames @ np.square(centred).T - np.square(frames @ centred.T)
        return np.asarray((views * np.sqrt(np.maximum(variance, 0.0) * factor)).sum(axis=1))

    return pool


def pool_sdv(values: Array, ddof: int = 1) -> Pool:
    """Return the mean over frames of the standard deviation over views of (V, T)."""
    centred, factor = values - values.mean(axis=0, keepdims=True), _unbiased(values.shape[0], ddof)

    def pool(views: Array, frames: Array) -> Array:
        variance = views @ np.square(centred) - np.square(views @ centred)
        return np.asarray((frames * np.sqrt(np.maximum(variance, 0.0) * factor)).sum(axis=1))

    return pool


def _unbiased(count: int, ddof: int) -> float:
    """From the mean square to the variance with this ddof.

    Nothing to correct where one value has no variance anyway.
    """
    return count / (count - ddof) if count > ddof else 1.0


RULES: dict[str, Callable[..., Pool]] = {
    "mean": pool_mean,
    "powers of means": pool_powers,
    "mean of products": pool_products,
    OVER_FRAMES: pool_sdt,
    OVER_VIEWS: pool_sdv,
}
MEAN = Pooling("mean")
