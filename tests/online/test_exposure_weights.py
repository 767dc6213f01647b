"""How much two sources' common look-ups weigh against "no gain"."""

from types import SimpleNamespace

import numpy as np

from ggvs_eval.pipelines.online import exposure_compensation
from ggvs_eval.pipelines.online.exposure_compensation import PRIOR, ExposureCompensation


def test_a_pair_weighs_its_share_of_the_samples_of_both(monkeypatch):
    """Eight of 100 + 300 look-ups are a share of .02; the log ratio is split between the two
    against the prior.
    """
    looks = np.zeros((8, 4), np.float32)
    looks[:, :3] = 0.4
    shared = {(0, 1): looks}, np.array([100, 300]), np.ones((2, 2))
    monkeypatch.setattr(exposure_compensation, "shared_looks", lambda _sources, _tolerance: shared)
    sources = [SimpleNamespace(camera=SimpleNamespace(name=name)) for name in ("left", "right")]
    share = 8 / 400
    half = share * 0.4 / (PRIOR + 2 * share)

    log_gains = ExposureCompensation()._solve(sources, 0.1)

    np.testing.assert_allclose(log_gains, [[half] * 3, [-half] * 3], rtol=1e-6)
