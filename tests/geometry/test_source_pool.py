"""The pool of cameras among which the best set of sources is looked for."""

import numpy as np

from ggvs_eval.geometry import source_views


def test_cameras_fade_as_they_near_the_edge_of_the_pool(monkeypatch):
    """Of five cameras the best three are tried; one at the edge keeps a thousandth, one well inside
    all that it is worth.
    """
    monkeypatch.setattr(source_views, "MOST_SETS", 3)
    worth = np.outer([4.0, 10.0, 0.5, 4.0, 4.2], [0.25, 0.75])

    pool, faded = source_views._pool(worth, 1)

    inside = (4.2 - 4.0) / (source_views.POOL_FADE * 4.2)
    assert pool.tolist() == [0, 1, 4]
    np.testing.assert_allclose(
        faded.sum(axis=1), [4.0 * source_views.LEAST_SHARE, 10.0, 4.2 * inside]
    )
