"""All networks from one command: samples first, then trainings side by side, each as the single
command would run it.
"""

import fcntl
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import TracebackType
from typing import IO

from ggvs_eval.compute_device import compute_device
from ggvs_eval.contrib.training.recipes.recipe import TRAINED_BASELINES
from ggvs_eval.contrib.training.request import Guidance, TrainingOptions
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind, InstantKind
from ggvs_eval.contrib.training.samples.training_data import prepare_samples, sample_pools
from ggvs_eval.contrib.training.train_one import CACHE, sample_device, sample_workers
from ggvs_eval.errors import TrainingError
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.pipelines.online.blend_network import weights_name
from ggvs_eval.progress import LOOK_BACK_S

LOOK_S = 1.0  # between two looks at the trainings
GRACE_S = 10.0  # that a stopped training has before it is killed
TAIL_BYTES = 4096  # of a log: more than its last line
CORES_PER_TRAINING = 2  # on a CPU: one computes steps, one makes batches
TENTHS = 10  # lines of progress if there is no terminal


@dataclass(frozen=True)
class Training:
    """One of the trainings.

    Attributes:
        arguments: of ``ggvs-eval``, the verb first.
        steps: that it is to have at its end.
    """

    name: str
    folder: Path
    arguments: tuple[str, ...]
    steps: int

    @property
    def log(self) -> Path:
        """File of its output."""
        return self.folder / "train.log"

    def steps_done(self) -> int:
        """Return the steps in its log; 0 before the first."""
        line = last_line(self.folder / "log.csv")
        number = line.partition(",")[0]
        return int(number) + 1 if number.isdigit() else 0


def default_jobs(device_type: str, trainings: int) -> int:
    """Return how many trainings run at once: all of them on a GPU, one per two cores on a CPU."""
    return (
        trainings
        if device_type == "cuda"
        else max(min(usable_cpus() // CORES_PER_TRAINING, trainings), 1)
    )


def run_trainings(trainings: Sequence[Training], jobs: int) -> dict[str, str]:
    """Run trainings, at most `jobs` at once, those given first first, and show how far they are.

    Args:
        jobs: at least 1.

    Returns:
        Name of each training that failed, and one line that says why and where its log is.

    Reading:
        A training keeps its log locked while it runs, so that a second call never trains into the
        same folder.
    """
    if jobs < 1:
        raise TrainingError(
            f"train all: wanted at least one job at a time, got --jobs {jobs}; give 1 or more"
        )
    waiting, failures = list(trainings), dict[str, str]()
    running: dict[Training, subprocess.Popen[bytes]] = {}
    with (
        ProgressLines({training.name: training.steps for training in trainings}) as lines,
        _stopped_at_the_end(running),
    ):
        while waiting or running:
            while waiting and len(running) < jobs:
                training = waiting.pop(0)
                try:
                    running[training] = _start(training, jobs)
                except TrainingError as error:
                    failures[training.name] = str(error)
            for training, process in list(running.items()):
                lines.show(training.name, training.steps_done())
                if process.poll() is not None:
                    del running[training]
                    failures |= _failure(training, process.returncode)
                    lines.end(training.name, failed=training.name in failures)
            time.sleep(LOOK_S if running else 0)
    return failures


def last_line(path: Path) -> str:
    """Return the last line of a file that is not empty, nothing if there is none.

    A line that is being written counts.
    """
    try:
        with path.open("rb") as file:
            file.seek(max(file.seek(0, os.SEEK_END) - TAIL_BYTES, 0))
            lines = file.read().decode("utf-8", "replace").split("\n")
    except FileNotFoundError:
        return ""
    return next((line.strip() for line in reversed(lines) if line.strip()), "")


def _start(training: Training, jobs: int) -> subprocess.Popen[bytes]:
    """Start the training as a separate process group; its output is added to its log."""
    training.folder.mkdir(parents=True, exist_ok=True)
    with training.log.open("ab") as log:
        _lock(training, log)
        command = [sys.executable, "-m", "ggvs_eval", *training.arguments]
        threads = str(max(usable_cpus() // jobs, 1))
        environment = {"OMP_NUM_THREADS": threads, "GGVS_EVAL_THREADS": threads, **os.environ}
        return subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=log,
            stderr=subprocess.STDOUT,
            env=environment,
            start_new_session=True,
        )


def _lock(training: Training, log: IO[bytes]) -> None:
    """Lock the log for all who write to it, the process that inherits it included."""
    try:
        fcntl.flock(log, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        raise TrainingError(
            f"{training.name}: another call trains it in {training.folder}; wait for it or stop "
            f"it, and run this again (log: {training.log})"
        ) from error


def _failure(training: Training, code: int) -> dict[str, str]:
    """Describe why a training failed, by its name; nothing if it ended well."""
    if code == 0:
        return {}
    end = f"signal {signal.Signals(-code).name}" if code < 0 else f"exit {code}"
    said = last_line(training.log).removeprefix("ggvs-eval: ")
    progress = f"{training.steps_done()} of {training.steps} steps"
    return {training.name: f"{training.name}: {end} after {progress}: {said} (log: {training.log})"}


@contextmanager
def _stopped_at_the_end(running: dict[Training, subprocess.Popen[bytes]]) -> Iterator[None]:
    """Stop what still runs when the block is left early: by an error, Ctrl-C or a request to
    terminate.
    """
    try:
        yield
    finally:
        for process in running.values():
            _signal_group(process, signal.SIGTERM)
        for process in running.values():
            try:
                process.wait(GRACE_S)
            except subprocess.TimeoutExpired:
                _signal_group(process, signal.SIGKILL)


def _signal_group(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
    with suppress(ProcessLookupError):  # it has just ended
        os.killpg(process.pid, number)


class ProgressLines:
    """A progress line per training, a context manager: bars on a terminal, a line at each tenth
    elsewhere.

    Args:
        steps: name -> steps of each.
    """

    def __init__(self, steps: Mapping[str, int]) -> None:
        from rich.console import Console
        from rich.progress import (
            BarColumn,
            MofNCompleteColumn,
            Progress,
            TextColumn,
            TimeElapsedColumn,
            TimeRemainingColumn,
        )

        console = Console(stderr=True)
        self._steps = dict(steps)
        self._tenths = dict.fromkeys(steps, -1)
        self._bars = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("left"),
            TimeRemainingColumn(),
            console=console,
            disable=not console.is_terminal,
            speed_estimate_period=LOOK_BACK_S,
        )
        self._tasks = {
            name: self._bars.add_task(name, total=total) for name, total in steps.items()
        }

    def __enter__(self) -> "ProgressLines":
        self._bars.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._bars.stop()

    def show(self, name: str, n_done: int) -> None:
        """Report N finished steps."""
        self._bars.update(self._tasks[name], completed=n_done)
        tenth = TENTHS * n_done // max(self._steps[name], 1)
        if self._bars.disable and tenth > self._tenths[name]:
            self._tenths[name] = tenth
            print(f"{name}: {n_done} of {self._steps[name]} steps", file=sys.stderr, flush=True)

    def end(self, name: str, failed: bool) -> None:
        """Nothing more will be done."""
        outcome = "failed" if failed else "done"
        self._bars.update(self._tasks[name], description=f"{name}: {outcome}")
        self._bars.stop_task(self._tasks[name])
        if self._bars.disable:
            print(f"{name}: {outcome}", file=sys.stderr, flush=True)


Network = tuple[str, Guidance]  # what `train` calls it, and what blend sees of the fused depth
NETWORKS: tuple[Network, ...] = (
    ("blend", "registered"),
    ("blend", "none"),
    ("blend", "naive"),
    *((baseline, "registered") for baseline in TRAINED_BASELINES),
)


def train_all(
    folder: Path,
    request: TrainingOptions,
    jobs: int | None = None,
    networks: Sequence[Network] = NETWORKS,
) -> list[Path]:
    """Train all networks of a comparison on the same views; finished ones are not trained again.

    Args:
        folder: gets a folder per network, with state, logs, curve, weights and card, and the
            samples.
        jobs: trainings at a time; by default all on a GPU, one per two cores on a CPU.

    Raises:
        DeviceError: there is no such device here.
        TrainingError: nothing to learn from, an option that is for one network alone, or trainings
            that failed; all others are finished then.
    """
    device = compute_device(request.device)
    if request.start_from is not None or request.guidance != "registered":
        raise TrainingError(
            "train all: wanted options that all networks share, got --start-from or --guidance; "
            "train that network alone, as `ggvs-eval train blend` does, and call again"
        )
    trainings = planned_trainings(folder, request, networks)
    prepare_all(folder / CACHE, request, networks)
    failures = run_trainings(
        trainings, default_jobs(device.type, len(trainings)) if jobs is None else jobs
    )
    if failures:
        print(*failures.values(), sep="\n", file=sys.stderr)
        raise TrainingError(
            f"train all: wanted {len(trainings)} trained networks, {', '.join(failures)} failed, "
            "the others are trained; fix the errors in their logs and run this again to resume"
        )
    return [
        training.folder / f"{training.name}{end}"
        for training in trainings
        for end in (".safetensors", ".md")
    ]


def planned_trainings(
    folder: Path, request: TrainingOptions, networks: Sequence[Network] = NETWORKS
) -> list[Training]:
    """Return the command of each network's training."""
    trainings = []
    for network, guidance in networks:
        name = weights_name(guidance) if network == "blend" else network
        words = replace(request, guidance=guidance).words(network)
        trainings.append(
            Training(
                name=name,
                folder=folder / name,
                arguments=("train", network, str(folder / name), *words),
                steps=request.steps,
            )
        )
    return trainings


def prepare_all(
    cache: Path, request: TrainingOptions, networks: Sequence[Network] = NETWORKS
) -> None:
    """Make the samples that any of the networks lacks, with all cores.

    Rooms are rendered once for all.
    """
    if any(network == "blend" for network, _ in networks):
        device = sample_device(request)
        prepare_samples(*sample_pools(cache, request, BlendKind(device)), sample_workers(device))
    for depth in sorted(
        {
            TRAINED_BASELINES[network].takes_depth
            for network, _ in networks
            if network in TRAINED_BASELINES
        }
    ):
        prepare_samples(*sample_pools(cache, request, InstantKind(depth)), usable_cpus())
