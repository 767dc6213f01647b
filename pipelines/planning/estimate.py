"""What runs still need: bytes on disk and seconds of wall time, from what is left of them and what a trial took."""

import heapq
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.pipelines.planning.rates import Rates
from ggvs_eval.pipelines.planning.work_left import WorkLeft

# Bytes per pixel where nothing was tried: depth as it is stored, PNG of frames with and without sensor noise as on the demo.
DEPTH_BYTES, TRUTH_BYTES, RENDER_BYTES, PATH_DEPTH_BYTES = 5.0, 2.1, 1.5, 4.0
PAGE_SHARE = 0.3  # of the renders; a page keeps small copies of them


@dataclass(frozen=True)
class Portion:
    """What one run has left, with what decides how large and how slow that is.

    Attributes:
        left: missing frames.
        n_pixels: of a frame.
        k: source cameras.
    """

    left: WorkLeft
    n_pixels: int
    k: int


def disk_bytes(portions: Sequence[Portion], rates: Rates | None) -> float:
    """What runs will still write; what they share is counted once.

    Args:
        portions: what is left of each.
        rates: what was tried, if anything was.
    """
    truth: dict[Path, float] = {}
    depth: dict[Path, float] = {}
    other = 0.0
    for each in portions:
        left, n_pixels = each.left, each.n_pixels
        truth_bytes = (rates.truth_bytes if rates else 0.0) or n_pixels * TRUTH_BYTES
        render_bytes = (rates.render_bytes if rates else 0.0) or n_pixels * RENDER_BYTES
        truth |= {folder: n * truth_bytes for folder, n in left.truth.items()}
        depth |= {folder: n * n_pixels * DEPTH_BYTES for folder, n in {**left.found_depth, **left.checked_depth}.items()}
        other += left.n_rendered * render_bytes * (1 + PAGE_SHARE) + left.path_depth * n_pixels * PATH_DEPTH_BYTES
    return sum(truth.values()) + sum(depth.values()) + other


@dataclass(frozen=True)
class Pace:
    """How fast this machine works on runs.

    Attributes:
        rates: what was tried.
        probed_k: source cameras in that trial.
        jobs: processes.
    """

    rates: Rates
    probed_k: int
    jobs: int

    def stage_seconds(self, portions: Sequence[Portion]) -> dict[str, float]:
        """Estimate of every stage's wall time, without the page.

        Reading:
            Ceilings of a view and the images along a path are taken for as slow to measure as one method's frames without LPIPS.
        """
        seconds = dict.fromkeys(("frames and depth", "rendering", "scoring"), 0.0)
        done: set[Path] = set()
        for each in portions:
            larger = each.k / self.probed_k
            seconds["frames and depth"] += self._preparing(each.left, larger, done)
            seconds["rendering"] += self._rendering(each.left, larger)
            seconds["scoring"] += self._scoring(each.left)
        return seconds

    def _preparing(self, left: WorkLeft, larger: float, done: set[Path]) -> float:
        """Frames, depth and masks; `done` takes the folders that runs share."""
        rates, seconds = self.rates, left.path_depth * self.rates.pose_depth_s * larger
        for counts, rate in (
            (left.truth, rates.truth_s),
            (left.found_depth, rates.depth_s),
            (left.checked_depth, rates.check_s * larger),
            (left.disoccluded, rates.mask_s * larger),
        ):
            fresh = {folder: n for folder, n in counts.items() if n and folder not in done}
            done |= set(fresh)
            seconds += self._spread((n * rate for n in fresh.values()), rates.start_s)
        return seconds

    def _rendering(self, left: WorkLeft, larger: float) -> float:
        renders = [(label, n) for counts in (left.renders, left.path_renders) for (label, _), n in counts.items()]
        setup_s, step_s = self.rates.setup_s, self.rates.step_s
        return self._spread(
            (setup_s.get(label, 0.0) + n * step_s.get(label, 0.0) * larger for label, n in renders), self._start_s
        )

    def _scoring(self, left: WorkLeft) -> float:
        """The views, their ceilings, and the path of every method."""
        plain_s = self.rates.plain_score_s
        views = self._spread((n * self.rates.score_s for n in left.scores.values()), self._start_s + self.rates.score_setup_s)
        ceilings = self._spread((n * plain_s for n in left.ceilings.values()), self._start_s)
        return views + ceilings + self._spread((n * plain_s for n in left.path_renders.values()), self._start_s)

    @property
    def _start_s(self) -> float:
        """Of a stage whose jobs run in this very process where there is but one."""
        return self.rates.start_s if self.jobs > 1 else 0.0

    def _spread(self, durations_s: Iterable[float], start_s: float) -> float:
        """Wall time of jobs that are begun in their order in several processes, each of which has to start first."""
        durations = list(durations_s)
        ends = [start_s] * self.jobs
        for duration_s in durations:
            heapq.heappush(ends, heapq.heappop(ends) + duration_s)
        return max(ends) if durations else 0.0
