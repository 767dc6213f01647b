"""Every way to find depth by the name that the command line uses."""

import difflib
from pathlib import Path

from ggvs_eval.errors import DepthError
from ggvs_eval.pipelines.offline.plane_sweep.sweep_options import PlaneSweep
from ggvs_eval.pipelines.offline.stereo.matcher import StereoMatcher
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher

DEFAULT_MATCHER = "sgbm"
MATCHERS = {
    "sgbm": "OpenCV's semi-global matching over an image pyramid, each partner on its own",
    "sweep": "planes swept through all partners at once, then semi-global matching over the planes",
    "raft": "the compact RAFT-Stereo that ships, started from semi-global matching",
    "raft:CHECKPOINT": "RAFT-Stereo with a checkpoint of its authors, e.g. raft:raftstereo-middlebury.pth",
}
PUBLISHED_ITERATIONS = 32  # what the authors' networks are made for


def find_matcher(name: str) -> StereoMatcher | PlaneSweep:
    """The matcher of a name, see `MATCHERS`.

    Raises:
        DepthError: no matcher of that name.
        WeightsError: no weights, or not RAFT-Stereo's.
    """
    kind, _, checkpoint = name.partition(":")
    if kind == "raft":
        return _raft(checkpoint)
    if name == "sgbm":
        return SgbmMatcher()
    if name == "sweep":
        return PlaneSweep()
    nearest = difflib.get_close_matches(name, MATCHERS, n=1)
    hint = f"; did you mean {nearest[0]}?" if nearest else ""
    raise DepthError(f"no stereo matcher {name!r}; there are {', '.join(MATCHERS)}{hint}")


def _raft(checkpoint: str) -> StereoMatcher:
    from ggvs_eval.pipelines.offline.stereo.raft_matcher import RaftMatcher
    from ggvs_eval.pipelines.offline.stereo.raft_weights import load_network, shipped_weights, weights_digest

    path = Path(checkpoint) if checkpoint else shipped_weights()
    digest = weights_digest(path)
    load_network(path)  # what is wrong with it is said before hours of work
    if checkpoint:
        return RaftMatcher(path, digest, iterations=PUBLISHED_ITERATIONS, from_matching=False)
    return RaftMatcher(path, digest)
