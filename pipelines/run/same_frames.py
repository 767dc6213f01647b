"""Frames that occur twice: those of another method under a second name, and those of another view
of the same method.

They carry one measurement, so that a rank between them would be made up. It happens on published
pages.
"""

import filecmp
from collections.abc import Mapping
from itertools import combinations, takewhile

from ggvs_eval.finding import Finding
from ggvs_eval.results import SAME_FRAMES
from ggvs_eval.run_folder import frame_path
from ggvs_eval.scoring import OfScores, ScoredMethod

MOST_DIFFERING = 0.01  # share of the frames in which two sets may differ and still be one
ADVICE = "render one of them again; is its folder a copy of the other?"


class SameFrames(OfScores):
    """The question whether a method has the frames of another one, or one view those of another."""

    def of_method(
        self, method: ScoredMethod, findings: Mapping[str, list[Finding]]
    ) -> dict[str, list[Finding]]:
        """Compare the files of a method with those of methods before it, and its views with each
        other.

        Reading:
            Of two methods with the same frames the later one is not ranked: those that were
            rendered here come before imported ones. The comparison is byte by byte; other PNG files
            of equal pixels differ.
        """
        run, label, views = method.run, method.label, [*findings]
        files = [frame_path(run.root, number).name for number in method.protocol.frames.numbers]
        before = takewhile(lambda name: name != label, run.labels())
        pairs = {
            (views[0], name): [((label, view), (name, view)) for view in views]
            for name in before
            if views
        }
        pairs |= {
            (view, first): [((label, view), (label, first))]
            for first, view in combinations(views, 2)
        }
        added = {view: list(of_view) for view, of_view in findings.items()}
        for (view, name), folders in pairs.items():
            equal = [
                filecmp.cmpfiles(run.renders(*first), run.renders(*second), files, shallow=False)[0]
                for first, second in folders
            ]
            n_equal, n_frames = sum(map(len, equal)), len(files) * len(folders)
            if n_frames - n_equal < MOST_DIFFERING * n_frames:
                message = f"{n_equal} of {n_frames} frames are equal byte by byte"
                added[view].append(
                    Finding(
                        subject=view,
                        question=f"{SAME_FRAMES}{name}",
                        verdict="certain",
                        measured=message,
                        values={},
                        advice=ADVICE,
                    )
                )
        return added


QUESTION = SameFrames()
