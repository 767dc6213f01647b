"""A metric: the error that one pixel in a hundred exceeds."""

import numpy as np

from ggvs_eval.metrics.metric import QUALITY, ViewMetric


def p99(rendered, truth):
    """99th percentile of the absolute error of a frame, in levels of 255.

    Both images are (H, W, 3) uint8.
    """
    return float(np.percentile(np.abs(rendered.astype(int) - truth), 99))


P99 = ViewMetric(
    name="P99",
    # one value per frame; its number is their mean, and the interval follows from that
    kind="frame",
    function=p99,
    unit="levels",
    higher_is_better=False,
    group=QUALITY,  # the table that it belongs to
    decimals=1,
    describe="absolute error that one value in a hundred exceeds",
    reference="this example",
)
