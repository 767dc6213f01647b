"""Instants whose depth is computed together."""

from ggvs_eval.pipelines.play.playback import blocks_of


def test_a_block_holds_as_many_cameras_as_allowed_and_no_more():
    """Of at most two cameras: the third begins a block, and one instant that needs three
    has them.
    """
    needed = {3: {"a"}, 4: {"a", "b"}, 5: {"b"}, 6: {"c"}, 7: {"a", "b", "c"}}

    assert list(blocks_of(needed, 2)) == [
        (range(3, 6), {"a", "b"}),
        (range(6, 7), {"c"}),
        (range(7, 8), {"a", "b", "c"}),
    ]
