"""Which instants a fit for the camera path may see."""

from types import SimpleNamespace

import pytest

from ggvs_eval.pipelines.run.fits import _path_instants


@pytest.mark.parametrize(
    ("look_ahead", "path_frame", "instants"),
    [
        ("none", 12, range(12, 13)),
        ("past", 12, range(10, 13)),
        ("past", 10, range(10, 11)),
        ("sequence", 12, range(10, 15)),
        ("sequence", 20, range(20, 21)),  # the instant of the path is none of the sequence
    ],
)
def test_a_fit_for_the_path_sees_its_instant(look_ahead, path_frame, instants):
    """The instant itself alone, with all before it, or the whole sequence."""
    assert (
        _path_instants(SimpleNamespace(look_ahead=look_ahead), range(10, 15), path_frame)
        == instants
    )
