"""Samples of several origins as one lot: rooms beside captures."""

from typing import Protocol

from ggvs_eval.pipelines.training.blend_samples import BlendSample


class SamplePlan(Protocol):
    """What a task wants to know of a plan."""

    @property
    def most_views(self) -> int:
        """The largest K of a sample."""

    @property
    def width(self) -> int:
        """Least width of a sample, pixels."""

    @property
    def height(self) -> int:
        """Least height of a sample, pixels."""


class Samples(Protocol):
    """Samples on disk: `RoomSamples`, `CaptureSamples`, or several of them."""

    @property
    def plans(self) -> tuple[SamplePlan, ...]:
        """Which samples there are."""

    @property
    def data(self) -> str:
        """What they show, for the model card."""

    def __len__(self) -> int: ...

    def read(self, index: int) -> BlendSample:
        """One of the samples."""

    def prepare(self, workers: int) -> None:
        """Make the samples that are not there yet."""


class JoinedSamples:
    """Several lots, one after the other; each sample is as likely as any other.

    Args:
        lots: at least one.
    """

    def __init__(self, *lots: Samples) -> None:
        self._lots = lots

    def __repr__(self) -> str:
        """The lots; the model card shows them."""
        return "; ".join(map(repr, self._lots))

    def __len__(self) -> int:
        return sum(map(len, self._lots))

    @property
    def plans(self) -> tuple[SamplePlan, ...]:
        """Of all lots."""
        return tuple(plan for lot in self._lots for plan in lot.plans)

    @property
    def data(self) -> str:
        """What they show, for the model card."""
        return "; ".join(lot.data for lot in self._lots)

    def read(self, index: int) -> BlendSample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """
        for lot in self._lots:
            if index < len(lot):
                return lot.read(index)
            index -= len(lot)
        raise IndexError(index)

    def prepare(self, workers: int) -> None:
        """Make the samples that are not there yet."""
        for lot in self._lots:
            lot.prepare(workers)
