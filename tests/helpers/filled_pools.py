"""Samples of a given capture in place of the rooms of a pool."""

from collections.abc import Callable

from ggvs_eval.capture import Capture
from ggvs_eval.contrib.training.samples.samples import SamplePool, SampleSource, make_samples


def fill(pool: SamplePool, capture_of: Callable[[SampleSource], Capture]) -> SamplePool:
    """Make all samples of a pool of a capture per source, as if it had been rendered; return the
    pool.
    """
    for source in pool.sources:
        for numbers in source.groups():
            make_samples(
                source,
                pool.kind,
                capture_of(source),
                {number: pool.path(source, number) for number in numbers},
            )
    return pool
