"""Renders in question, as verbs of the command line take them: frames of others with their capture,
or a run folder.
"""

import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated

import tyro

from ggvs_eval.pipelines.commands.flags import CAPTURE_DEFAULTS, ONE_PER_CORE, CaptureFlags, Jobs
from ggvs_eval.run_folder import RunFolder

Renders = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RENDERS|RUN")]


@dataclass(frozen=True)
class RendersOptions:
    """Options of commands that question renders.

    Attributes:
        capture: rendered capture.
        protocol: protocol (.toml or packaged name); fitted to the capture by default.
        run: run folder to create or resume; temporary by default, with the protocol of
            scores/CAPTURE.
        with_truth: the renders come with their reference (.npz of `renders` and `gts`, or renders/
            and gt/); no capture.
        first_frame: number of the protocol's first frame in the file names, if ambiguous.
        reading: capture reading.
        jobs: parallel processes, at least 1.
    """

    capture: Path | None = None
    protocol: str | None = None
    run: Path | None = None
    with_truth: bool = False
    first_frame: int | None = None
    reading: CaptureFlags = CAPTURE_DEFAULTS
    jobs: Jobs = ONE_PER_CORE

    @contextmanager
    def open(
        self, *renders: Path, allow_partial: bool = False
    ) -> Iterator[tuple[RunFolder, list[str]]]:
        """A run folder with the frames in question, and what they are called there.

        It goes where none is named.
        """
        if len(renders) == 1 and (renders[0] / "protocol.toml").is_file():
            folder = RunFolder(renders[0])
            yield folder, folder.labels()
            return
        from ggvs_eval.pipelines.run.import_renders import (
            SCORES_ROOT,
            import_renders,
            named_renders,
            require_there,
            run_for,
        )
        from ggvs_eval.pipelines.run.own_truth import run_with_truth

        require_there(named := named_renders(tuple(map(str, renders))))
        capture, protocol, run = self.capture, self.protocol, self.run
        scored = (
            RunFolder(SCORES_ROOT / capture.resolve().name).protocol_file if capture else Path()
        )
        if run is None and protocol is None and scored.is_file():
            protocol = str(scored)
        with TemporaryDirectory(prefix="ggvs-eval-") as scratch:
            root = Path(scratch) / "run" if run is None and (capture or self.with_truth) else run
            opened = partial(self.reading.open, capture) if capture else None
            opening = (
                run_with_truth(root, named, protocol)
                if self.with_truth
                else run_for(root, opened, protocol, self.jobs)
            )
            with opening as folder:
                for label, path in named.items():
                    record = import_renders(
                        folder,
                        label,
                        path,
                        allow_partial,
                        self.jobs,
                        self.first_frame,
                        link=run is None,
                    )
                    for note in record["notes"]:
                        print(f"{label}: {note}", file=sys.stderr)
            yield folder, [*named]

    @contextmanager
    def scored(self, *renders: Path) -> Iterator[tuple[RunFolder, list[str]]]:
        """Open the same with their scores."""
        from ggvs_eval.pipelines.run.score import score

        with self.open(*renders) as (folder, labels):
            score(folder, self.jobs)
            yield folder, labels


RendersFlags = tyro.conf.OmitArgPrefixes[RendersOptions]
RENDERS_DEFAULTS = RendersOptions()
