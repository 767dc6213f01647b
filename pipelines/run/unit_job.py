"""Jobs of a run by the units that they are for: test views and the camera path."""

from collections.abc import Collection
from dataclasses import dataclass

from ggvs_eval.jobs.job import Job


@dataclass(frozen=True)
class UnitJob(Job):
    """A job of one method.

    Attributes:
        units: the test view that it renders, or ``path``; of a fit, all that are rendered from it.
    """

    label: str = ""
    units: tuple[str, ...] = ()


@dataclass(frozen=True)
class RunJobs:
    """Jobs of the methods of a run, made once; counting, status and running use parts of these lists.

    Attributes:
        fit: scenes to fit, one per method and fold.
        render: one per method and unit; those that wait for no fit first, and the longest of them.
    """

    fit: tuple[UnitJob, ...]
    render: tuple[UnitJob, ...]

    @property
    def needed_fits(self) -> list[UnitJob]:
        """Fits that are done, or that something is still to be rendered from: a scene may go when its frames are there."""
        wanted = {(job.label, unit) for job in self.render if not job.is_done() for unit in job.units}
        return [fit for fit in self.fit if fit.is_done() or any((fit.label, unit) in wanted for unit in fit.units)]

    def of_units(self, units: Collection[str] | None) -> "RunJobs":
        """Jobs of a shard; all where None."""
        if units is None:
            return self
        fits, renders = ([job for job in jobs if not set(units).isdisjoint(job.units)] for jobs in (self.fit, self.render))
        return RunJobs(tuple(fits), tuple(renders))
