"""Numbers in the names of frames: which of them count, and in which order."""

from ggvs_eval.files.names import numbers_in


def test_fields_of_different_widths_keep_their_rank():
    """The tenth picture of part 2 comes before the ninth of part 10; each field is as wide as its
    widest number.
    """
    names = ["part10_9", "part2_10", "part2_9"]

    assert numbers_in(names) == [1009, 210, 209]
