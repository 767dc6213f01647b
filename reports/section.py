"""The door of the sections of a report: all that it shows besides its main tables, each of which
can be deleted.

`ggvs_eval.built_in.SECTIONS` lists them as text, and a plug-in's table SECTIONS adds to them.
"""

import typing
from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from copy import deepcopy
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, NamedTuple

from ggvs_eval import built_in
from ggvs_eval.errors import AbsentPartError, PluginError
from ggvs_eval.plugins import Registry, foreign, say_once
from ggvs_eval.protocol import Protocol
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.model.table import Table
from ggvs_eval.reports.tables.verdict import Verdict
from ggvs_eval.results import Results

Draw = Callable[[], object]
# of which a section keeps what it reads of their frames, for a page that grows with every run
RUNS_KEPT = 8


@dataclass(frozen=True)
class RunGroup:
    """Runs of one protocol, which share their tables.

    Attributes:
        id: of the group on the page.
        name: short, and no other group of the report has it.
        heading: the same for a reader of the page.
        runs: id of each on the page -> run.
        results: of all runs in one.
        tables: quality, consistency and all other measurements, over all runs.
        verdict: who is best in these.
    """

    id: str
    name: str
    heading: str
    runs: Mapping[str, MeasuredRun]
    results: Results
    tables: tuple[Table, ...]
    verdict: Verdict

    @property
    def protocol(self) -> Protocol:
        """Under which all runs were measured."""
        return next(iter(self.runs.values())).protocol

    @property
    def scenes(self) -> str:
        """Names of the captured scenes."""
        return ", ".join(dict.fromkeys(run.scene for run in self.runs.values()))

    @property
    def titles(self) -> str:
        """Titles of the captured scenes, as readers know them."""
        return ", ".join(dict.fromkeys(run.title for run in self.runs.values()))


class FigurePlaces(NamedTuple):
    """Folder for the figures of the report and each run, by id, and the number of each name's
    colour.
    """

    folders: Mapping[str, Path]
    numbers: Mapping[str, int]


@dataclass(frozen=True)
class SectionContent:
    """What a section adds to a report, by the ids of its runs and groups.

    The id of the report itself is empty.

    Attributes:
        tables: of a run or a group, for the page and for all files.
        part: of the page that lists the tables of runs, `views` or `timing`; else the section does.
        values: what the templates read of a run, a group or the report; a template is shown of a
            group if a value of its name, of the group or any of its runs, is not empty.
        data: what the page's scripts read of a run.
        sheets: further sheets of the page: `id`, `title`, `comes_first`, and the name of a
            `template` with what it reads, or `html`.
        names: of further lines in the drawings, which get colours.
        figures: what draws each figure.
        files: further files next to the page, name -> text.
        notes: what belongs below all tables in their files.
    """

    tables: Mapping[str, Sequence[Table]] = field(default_factory=dict)
    part: str = ""
    values: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    data: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    sheets: Sequence[Mapping[str, Any]] = ()
    names: Sequence[str] = ()
    figures: Callable[[FigurePlaces], Iterable[Draw]] | None = None
    files: Mapping[str, str] = field(default_factory=dict)
    notes: Sequence[str] = ()


@dataclass(frozen=True)
class Report:
    """What a report is of, and what its sections add to that.

    Attributes:
        sweeps: folders of sweeps whose runs it shows.
        tables_of: folders of sweeps of which it shows the tables alone.
        folder: where the page will be; None if it loads nothing.
        contents: of the sections, in the order of `ggvs_eval.built_in.SECTIONS`.
        absent: a line on each section that is not there.
    """

    groups: tuple[RunGroup, ...]
    sweeps: tuple[Path, ...] = ()
    tables_of: tuple[Path, ...] = ()
    folder: Path | None = None
    contents: tuple[SectionContent, ...] = ()
    absent: tuple[str, ...] = ()

    @property
    def runs(self) -> dict[str, MeasuredRun]:
        """Id on the page -> run, of all groups."""
        return {key: run for group in self.groups for key, run in group.runs.items()}

    def tables(self, key: str, part: str | None = None) -> list[Table]:
        """Return the sections' tables of a run or a group.

        Those that one part of the page lists, or all.
        """
        contents = [content for content in self.contents if part in (None, content.part)]
        return [table for content in contents for table in content.tables.get(key, ())]

    def values(self, key: str) -> dict[str, Any]:
        """Return what templates read of a run, a group or the report."""
        return {
            name: value
            for content in self.contents
            for name, value in content.values.get(key, {}).items()
        }

    def data(self, key: str) -> dict[str, Any]:
        """Return what scripts read of a run.

        Of two sections that give the same the later one counts.
        """
        return {
            name: value
            for content in self.contents
            for name, value in content.data.get(key, {}).items()
        }


class Section(typing.Protocol):
    """One section of a report."""

    def __call__(self, report: Report, /) -> SectionContent:
        """Return what it adds to a report, which has the contents of the sections before it."""


SECTIONS: Registry[Section] = Registry("sections", built_in.SECTIONS)


def section_modules() -> list[str]:
    """Return the modules that sections are loaded from, for the identity of a report's code."""
    modules = [module for name in SECTIONS.present() if (module := SECTIONS.root(name))]
    for name in SECTIONS.plugins:
        with suppress(PluginError):  # of which the report says so
            modules.append(SECTIONS[name].__module__)
    return modules


def with_sections(report: Report) -> Report:
    """Return a report with the contents of all sections, and a line on each one that is not
    there.
    """
    for name in SECTIONS.known():
        try:
            content = _content(name, report)
        except (AbsentPartError, PluginError) as error:
            say_once(f"section {error}")
            report = replace(report, absent=(*report.absent, f"section {error}"))
        else:
            report = replace(report, contents=(*report.contents, content))
    return report


def _content(name: str, report: Report) -> SectionContent:
    """Return the content of a section, of which every part must be there and no plug-in's code can
    end the report.
    """
    if name in SECTIONS.plugins:
        with foreign(f"{SECTIONS.plugins[name].origin}: section {name!r} does not work"):
            return SECTIONS[name](deepcopy(report))
    return SECTIONS[name](report)


def tables_of_runs(
    read: Callable[[MeasuredRun], Iterable[Table | None] | Table | None], part: str
) -> Section:
    """Return the section that has tables of single runs and nothing else.

    Args:
        read: returns a table of a run, or several.
        part: of the page, see `SectionContent`.
    """

    def section(report: Report) -> SectionContent:
        tables = {}
        for key, run in report.runs.items():
            of_run = read(run)
            tables[key] = [
                table
                for table in ([of_run] if isinstance(of_run, Table) else of_run or ())
                if table
            ]
        return SectionContent(tables=tables, part=part)

    return section


def value_of_runs(read: Callable[[MeasuredRun], object], name: str) -> Section:
    """Return the section that gives one value of each run, by this name, to the sections and
    templates behind it.
    """
    return lambda report: SectionContent(
        values={key: {name: read(run)} for key, run in report.runs.items()}
    )
