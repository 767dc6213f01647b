"""Doors of scoring: questions that are asked of every method's frames, and what is scored besides
the frames of test views.

Both are listed in `ggvs_eval.built_in` and loaded by name, so that `score` works without any of
them.
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any
from typing import Protocol as Door

from ggvs_eval import built_in
from ggvs_eval.arrays import Image8
from ggvs_eval.coverage import Coverage
from ggvs_eval.finding import Finding
from ggvs_eval.plugins import Registry
from ggvs_eval.protocol import Protocol
from ggvs_eval.results import installed_versions
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from ggvs_eval.tasks.task import Task

FrameReader = Callable[[int], Image8]  # frame number -> (H, W, 3) uint8 RGB
# of rendered frames with these numbers, in a row
FrameCheck = Callable[[FrameReader, range], list[Finding]]
WHOLE = -1  # in the place of a frame's number
Value = tuple[str, int, float]  # metric, frame, value
Row = tuple[str, int, str, float]  # view, frame (-1: of no single one), metric, value


@dataclass(frozen=True)
class ScoredMethod:
    """A method whose frames have been measured.

    Attributes:
        values: metric -> view -> frame -> value.
    """

    run: RunFolder
    protocol: Protocol
    label: str
    values: Mapping[str, Mapping[str, Mapping[int, float]]]


class Question(Door):
    """A question that scoring asks of every method's frames.

    Its findings stand next to the scores.
    """

    def of_view(self, view: str, truth: FrameReader, numbers: range) -> FrameCheck:
        """Return what checks a method's frames of a view.

        Work on the captured ones, which have these numbers, is shared.
        """

    def of_method(
        self, method: ScoredMethod, findings: Mapping[str, list[Finding]]
    ) -> dict[str, list[Finding]]:
        """Return the findings of a measured method by view: those of all questions so far, with
        some more or some fewer.
        """


class OfScores:
    """What a question asks of frames that is asked of scores: nothing."""

    def of_view(self, _view: str, _truth: FrameReader, _numbers: range) -> FrameCheck:
        """See `Question`."""
        return lambda _rendered, _frames: []


@dataclass(frozen=True)
class ScoreRequest:
    """Methods of a run that are to be scored.

    Attributes:
        views: test views that are scored.
        units: the shard's test views, or ``path``; None for all.
    """

    run: RunFolder
    protocol: Protocol
    coverage: Coverage
    labels: Sequence[str]
    views: Sequence[str]
    units: Collection[str] | None


@dataclass(frozen=True)
class ScorePart:
    """Something that is scored besides the frames of test views: a camera path, noise ceilings, a
    viewer's screen.

    Attributes:
        tasks: measure it.
        rows: label -> values, and metric -> why there are none, once the tasks are done; None if it
            has no rows.
        references: rows of the report that belong to no method, once the tasks are done.
        write: writes further records into the run folder.
        partial: label of a row that it adds to the methods -> view -> its frames, which are there.
    """

    tasks: tuple[Task, ...] = ()
    rows: Callable[[str], tuple[list[Row], dict[str, str]]] | None = None
    references: Callable[[], list[dict[str, Any]]] = list
    write: Callable[[], None] = lambda: None
    partial: Mapping[str, Mapping[str, Sequence[int]]] = field(default_factory=dict)


@dataclass(frozen=True)
class MetricScores:
    """Values of metrics of one method in one view.

    Attributes:
        values: (metric, frame, value); the frame is `WHOLE` where the value belongs to all frames.
        not_computed: metric -> reason.
        versions: package -> version that they were measured by.
    """

    values: Sequence[Value]
    not_computed: Mapping[str, str]
    versions: Mapping[str, str] = field(default_factory=lambda: installed_versions())

    def of(self, metric: str, parts: Collection[str]) -> "MetricScores":
        """Return one metric with the parts that it is pooled from."""
        values = [value for value in self.values if value[0] == metric or value[0] in parts]
        reasons = {name: reason for name, reason in self.not_computed.items() if name == metric}
        return replace(self, values=values, not_computed=reasons)

    @classmethod
    def read(cls, folder: Path) -> "MetricScores":
        """Read those of a task that is done; their fields are in its record."""
        record = read_json(folder / JOB_FILE)
        return cls(**{part.name: record[part.name] for part in fields(cls)})


QUESTIONS: Registry[Question] = Registry("questions", built_in.QUESTIONS)
SCORE_PARTS: Registry[Callable[[ScoreRequest], ScorePart]] = Registry(
    "scores", built_in.SCORE_PARTS
)
