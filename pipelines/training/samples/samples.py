"""Samples on disk: what a pool of them offers, what kinds there are to make, and several pools as one."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Generic, Protocol, TypeVar

from ggvs_eval.camera import Camera
from ggvs_eval.errors import TrainingError
from ggvs_eval.jobs.processes import finish_all, worker_pool
from ggvs_eval.pipelines.training.samples.blend_samples import SampleMaker

Sample = TypeVar("Sample")
Job = Callable[[], None]  # can be sent to a worker process


class SamplePlan(Protocol):
    """Properties that a task asks of a plan."""

    @property
    def most_views(self) -> int:
        """The largest K of a sample."""

    @property
    def least_size(self) -> tuple[int, int]:
        """Least width and height of a sample, pixels."""


class SampleKind(ABC, Generic[Sample]):
    """Kind of sample: how one is made of a capture, and its file.

    Attributes:
        depth: whether it depends on the depth of its sources.
        device: where it is computed, beside its depth; another one than ``cpu`` wants NVIDIA Warp.
    """

    depth: bool = True
    device: str = "cpu"

    @abstractmethod
    def make(self, maker: SampleMaker, target: Camera, sources: Sequence[Camera]) -> Sample:
        """The sample of a target and its source cameras."""

    @abstractmethod
    def cropped(self, sample: Sample, left: int, top: int, width: int, height: int) -> Sample:
        """The window of a sample that starts at pixel (left, top)."""

    @abstractmethod
    def read(self, path: Path) -> Sample:
        """Read a sample.

        Raises:
            TrainingError: absent or damaged.
        """

    @abstractmethod
    def write(self, path: Path, sample: Sample) -> None:
        """Write a sample, the whole file or none."""

    def describe(self) -> dict[str, str]:
        """Describe what the bits of a sample depend on beside its plan; folders are named by it.

        Reading:
            Samples of a GPU lie apart: on the CPU equal inputs give equal bits, of a training too, and theirs differ in the last
            ones. Which GPU is not told, since samples are rounded to 8 bits, where that moves next to nothing.
        """
        return {} if self.device == "cpu" else {"device": self.device.partition(":")[0]}


class Samples(ABC, Generic[Sample]):
    """Samples of one kind on disk: of rooms, of captures, or several pools of them."""

    @property
    @abstractmethod
    def plans(self) -> tuple[SamplePlan, ...]:
        """Which samples there are."""

    @property
    @abstractmethod
    def data(self) -> str:
        """Contents of the samples, for the model card."""

    @abstractmethod
    def __len__(self) -> int: ...

    @abstractmethod
    def read(self, index: int) -> Sample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """

    @abstractmethod
    def jobs(self) -> list[Job]:
        """List the jobs that make the samples that are not there yet; each is independent of the others."""

    def prepare(self, workers: int) -> None:
        """Make the samples that are not there yet; a killed preparation goes on where it stopped.

        Args:
            workers: processes that share the jobs.
        """
        jobs = self.jobs()
        if jobs:
            with worker_pool(min(workers, len(jobs))) as pool:
                finish_all(pool, [pool.submit(job) for job in jobs], "views to learn from")


class JoinedSamples(Samples[Sample]):
    """Several pools, one after the other; each sample is as likely as any other.

    Args:
        pools: at least one.
    """

    def __init__(self, *pools: Samples[Sample]) -> None:
        self.pools = pools

    def __repr__(self) -> str:
        """The pools; the model card shows them."""
        return "; ".join(map(repr, self.pools))

    def __len__(self) -> int:
        return sum(map(len, self.pools))

    @property
    def plans(self) -> tuple[SamplePlan, ...]:
        """Of all pools."""
        return tuple(plan for pool in self.pools for plan in pool.plans)

    @property
    def data(self) -> str:
        """Contents of the samples, for the model card."""
        return "; ".join(pool.data for pool in self.pools)

    def read(self, index: int) -> Sample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """
        for pool in self.pools:
            if index < len(pool):
                return pool.read(index)
            index -= len(pool)
        raise IndexError(index)

    def jobs(self) -> list[Job]:
        """Those of all pools."""
        return [job for pool in self.pools for job in pool.jobs()]


def require_room(samples: Samples[Sample], width: int, height: int) -> None:
    """Refuse samples in which crops of that size do not fit.

    Raises:
        TrainingError: a sample may be smaller.
    """
    for plan in samples.plans:
        least = plan.least_size
        if least[0] < width or least[1] < height:
            raise TrainingError(
                f"crops of {width} x {height} do not fit samples of {least[0]} x {least[1]}; take larger samples or smaller crops"
            )
