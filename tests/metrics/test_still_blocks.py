"""Which blocks of a capture without noise count as still."""

import numpy as np
import pytest

from ggvs_eval.metrics.time.flicker import flicker


@pytest.mark.parametrize(("changed_rows", "still_blocks"), [(3, 24), (5, 15)])
def test_a_block_is_still_up_to_half_a_squared_level_of_change(changed_rows, still_blocks):
    """Noise of a variance of .25 changes two frames by .5: 3 of 8 rows by a level are less, 5 move,
    with all neighbours.
    """
    before = np.full((32, 48, 3), 100, np.uint8)
    after = before.copy()
    after[8 : 8 + changed_rows, 8:16] += 1

    measured = flicker([(before, before), (after, after)])

    assert measured.static_share == still_blocks / 24
    assert measured.on_static == pytest.approx(np.sqrt(3 / 8 / 24) if still_blocks == 24 else 0)
