"""Test views that a method has seen: its renders are better than perfect ones, which lack the noise
of the captured frames.
"""

from collections.abc import Collection, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from ggvs_eval.finding import Finding
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.pipelines.inspection.renders.examine import COMPARED, find_seen
from ggvs_eval.pipelines.inspection.renders.identity import views_of_run
from ggvs_eval.pipelines.run.references import ceiling_tasks, read_ceiling
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.scoring import OfScores, ScoredMethod

LEAST_DB = 30.0


class SeenViews(OfScores):
    """The question whether a method has seen a test view, see `find_seen`.

    It is asked of scores, not of frames.
    """

    def of_method(
        self, method: ScoredMethod, findings: Mapping[str, list[Finding]]
    ) -> dict[str, list[Finding]]:
        """See `Question`."""
        psnrs_db = method.values.get(COMPARED, {})
        return {
            view: [
                *of_view,
                *find_seen_view(
                    view,
                    psnrs_db.get(view, {}).values(),
                    read_ceiling(method.run, method.protocol, view),
                ),
            ]
            for view, of_view in findings.items()
        }


QUESTION = SeenViews()


def find_seen_view(
    view: str, psnrs_db: Collection[float], perfect: Mapping[str, Any] | None
) -> list[Finding]:
    """Report a view whose renders are better than a perfect one's, see `find_seen`.

    Args:
        view: name.
        psnrs_db: of its frames; empty if they were not measured.
        perfect: its record of `read_ceiling`; None if there is none.
    """
    ceiling_db = (perfect or {}).get("noise_free", {}).get(COMPARED)
    if ceiling_db is None or not psnrs_db:
        return []
    return find_seen(view, float(np.mean(list(psnrs_db))), ceiling_db)


def find_seen_views(run: RunFolder, label: str) -> list[Finding]:
    """Ask the same of frames that need not have been scored, and of a protocol that wants no
    ceilings.

    They are estimated only where renders are so good that they may be above: noise of `LEAST_DB`
    would be seen by everybody.
    """
    protocol, findings = run.protocol(), []
    measurement = replace(protocol.measurement, metrics=(COMPARED,), ceilings=True)
    terms = replace(protocol, measurement=measurement)
    for name, view in views_of_run(run, label, as_measured=True).items():
        psnrs_db = [psnr(*pair) for pair in view.pairs(list(view.frames))]
        if np.mean(psnrs_db) > LEAST_DB:
            (task,) = ceiling_tasks(run, terms, [name])
            assert task.make is not None
            findings += find_seen_view(name, psnrs_db, task.make(run.root))
    return findings
