"""The frames at which motion is compared."""

from types import SimpleNamespace

import pytest

from ggvs_eval.pipelines.inspection.capture.timing import LARGEST_LAG, timed_frames


@pytest.mark.parametrize(("gap", "marks"), [(0, 0), (2, 2), (LARGEST_LAG + 5, LARGEST_LAG)])
def test_a_gap_is_as_long_as_it_is_up_to_the_largest_lag(gap, marks):
    """Each frame that no camera knows is a -1, but no more than a lag can reach over; of two
    cameras any frame counts.
    """
    records = [
        SimpleNamespace(energy={4: 0.1, 5: 0.2}),
        SimpleNamespace(energy={5: 0.1, 6 + gap: 0.3}),
    ]

    assert timed_frames(records) == [4, 5, *[-1] * marks, 6 + gap]
