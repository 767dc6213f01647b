"""Depth of the sources of several target views: each ordered pair of cameras is matched once an
instant, with equal bits.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.depth_store import DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.depth import fill_store
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import plan_depth, prepare_depth
from ggvs_eval.pipelines.offline.stereo.pairwise import PairwiseEstimator
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher
from helpers.refusals import refused
from helpers.stereo_scenes import write_capture

FRAMES = range(1)
OPTIONS = DepthOptions(partners=3, matcher=SgbmMatcher(levels=1))


@pytest.fixture(scope="module")
def planned(tmp_path_factory):
    """Five cameras before a plane, and the depth that two of them want as target views."""
    capture = write_capture(tmp_path_factory.mktemp("plane"), n_frames=1).resized(96, 72, "area")
    plan = plan_depth(capture, capture.cameras[:2], 3, OPTIONS)
    return capture, [job for jobs in plan.values() for job in jobs.values()]


def filled(store, planned, monkeypatch, shares=True):
    """The maps of a store by job and frame, and the ordered pairs that were matched."""
    capture, jobs = planned
    pairs, match = [], SgbmMatcher.match

    def counted(self, left, right, *rest):
        pairs.append(None)
        return match(self, left, right, *rest)

    with monkeypatch.context() as patch:
        patch.setattr(SgbmMatcher, "match", counted)
        if not shares:
            patch.setattr(
                fill_store, "_by_camera", lambda needed, *_: [{job: needed[job]} for job in needed]
            )
        prepare_depth(capture, jobs, FRAMES, store, OPTIONS, 1)
    return {(job.key, frame): store.read(job.key, frame) for job in jobs for frame in FRAMES}, len(
        pairs
    )


@pytest.mark.slow
def test_a_pair_is_matched_once(planned, tmp_path, monkeypatch):
    """As many matchings as there are ordered pairs, fewer than job by job, and the same maps; later
    what is lost alone.
    """
    _, jobs = planned
    found = {each for job in jobs for each in (job.unchecked, *job.checked_with)}
    ordered = {(job.camera_name, name) for job in found for name in job.partner_names}
    matchings = sum(len(job.partner_names) for job in found)
    assert len(ordered) < matchings
    together, once = filled(DepthStore(tmp_path / "together"), planned, monkeypatch)
    apart, often = filled(DepthStore(tmp_path / "apart"), planned, monkeypatch, shares=False)
    assert (once, often) == (len(ordered) * len(FRAMES), matchings * len(FRAMES))
    for key, one in together.items():
        np.testing.assert_array_equal(one.depth, apart[key].depth)
        np.testing.assert_array_equal(one.confidence, apart[key].confidence)
    assert filled(DepthStore(tmp_path / "together"), planned, monkeypatch)[1] == 0
    for job in (jobs[0], jobs[0].unchecked):
        DepthStore(tmp_path / "together").path(job.key, 0).unlink()
    again, count = filled(DepthStore(tmp_path / "together"), planned, monkeypatch)
    assert count == len(jobs[0].partner_names)
    np.testing.assert_array_equal(again[jobs[0].key, 0].depth, together[jobs[0].key, 0].depth)


def test_instants_that_depend_on_each_other_share_nothing(planned):
    """Matches that start from the instant before are their estimator's own."""
    capture, jobs = planned
    unchecked = dict.fromkeys((job.unchecked for job in jobs), FRAMES)
    assert all(
        len(group) == 1
        for group in fill_store._by_camera(unchecked, replace(OPTIONS, keyframe_every=4), 1)
    )
    assert max(map(len, fill_store._by_camera(unchecked, OPTIONS, 1))) > 1
    assert max(map(len, fill_store._by_camera(unchecked, OPTIONS, 64))) == 1
    with refused(DepthError, "wanted warm=False"):
        PairwiseEstimator(
            capture.cameras[0], capture.cameras[1:], SgbmMatcher(), 0.5, warm=True, shared={}
        )
