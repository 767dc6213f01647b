"""The training loop of every network here: AdamW, averaged weights, checkpoints, a log.

A killed run continues where it was.
"""

import csv
import hashlib
import io
import pickle
import platform
from collections.abc import Iterator, Mapping
from dataclasses import asdict, dataclass, fields, is_dataclass
from functools import partial
from pathlib import Path
from time import perf_counter, process_time
from typing import Any

import torch
from safetensors.torch import save
from torch import nn
from torch.optim.swa_utils import AveragedModel
from torch.utils.data import DataLoader, Dataset

from ggvs_eval.baselines.fitted.training_log import TrainingLog, draw_curves
from ggvs_eval.compute_device import compute_device, computing_on
from ggvs_eval.contrib.training.request import Precision, TrainingOptions
from ggvs_eval.contrib.training.task import Task
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.atomic import write_bytes
from ggvs_eval.files.weights_file import CONFIGURATION_NOTE, load_strict, read_notes, read_tensors
from ggvs_eval.progress import track

NETWORK = "the network to be trained"  # in messages
PIXELS_NOTE = "pixels"  # in the header of weights


@dataclass
class TrainingState:
    """Everything that changes while training.

    Attributes:
        pixels: of target views that were learned from, those of the weights that it began with
            included.
        network: the weights that are moved.
    """

    step: int
    pixels: int
    network: nn.Module
    average: AveragedModel
    optimiser: torch.optim.Optimizer


def state_file(folder: Path) -> Path:
    """Return the path of a training's state."""
    return folder / "state.pt"


def write_state(folder: Path, state: TrainingState) -> None:
    """Write it under a temporary name and rename it, so that a kill leaves the old one or the new
    one.
    """
    values = {
        "step": state.step,
        "pixels": state.pixels,
        "network": state.network.state_dict(),
        "average": state.average.state_dict(),
        "optimiser": state.optimiser.state_dict(),
    }
    buffer = io.BytesIO()  # torch says of a full disk that something failed, not what
    torch.save(values, buffer)
    write_bytes(state_file(folder), buffer.getvalue())


def read_state(folder: Path, fresh: TrainingState, device: torch.device) -> TrainingState:
    """Return the state of a folder poured into a fresh one.

    The fresh one itself if there is none.
    """
    path = state_file(folder)
    if not path.is_file():
        return fresh
    try:
        values = torch.load(path, map_location=device, weights_only=True)
        fresh.network.load_state_dict(values["network"])
        fresh.average.load_state_dict(values["average"])
        fresh.optimiser.load_state_dict(values["optimiser"])
        fresh.step, fresh.pixels = int(values["step"]), int(values.get("pixels", 0))
    except (
        RuntimeError,
        KeyError,
        ValueError,
        TypeError,
        EOFError,
        pickle.UnpicklingError,
    ) as error:
        reason = str(error).splitlines()[0]
        raise TrainingError(
            f"{path}: wanted a state of this training, got {reason}; choose another folder"
        ) from error
    return fresh


def write_weights(path: Path, network: nn.Module, notes: Mapping[str, str]) -> None:
    """Write a network's weights in half precision, under a temporary name first."""
    tensors = {
        name: (tensor.half() if tensor.is_floating_point() else tensor).contiguous().cpu()
        for name, tensor in network.state_dict().items()
    }
    write_bytes(path, save(tensors, dict(notes)))


def pour_weights(path: Path, network: nn.Module) -> int:
    """Give a network the weights of such a file.

    One that says how earlier weights are `completed` takes those, too.

    Returns:
        Pixels that they have learned from, 0 if the file does not say.
    """
    completed = getattr(network, "completed", dict)
    load_strict(completed(read_tensors(path, model=NETWORK)), network, path, NETWORK)
    return int(read_notes(path).get(PIXELS_NOTE, 0))


SHOWN_VALIDATIONS = 12


def write_card(task: Task, folder: Path, command: str, note: str = "", device: str = "cpu") -> Path:
    """Write ``<task>.md`` from the logs of a training.

    Args:
        command: that made them.
    """
    weights = folder / f"{task.name}.safetensors"
    notes = read_notes(weights)
    steps, pixels = int(notes["steps"]), int(notes[PIXELS_NOTE])
    rows = _rows(folder / "log.csv")[:steps]
    hours = sum(float(row["seconds"]) for row in rows) / 3600
    on_cpu = sum(float(row.get("cpu_seconds") or 0) for row in rows) / 60
    validations = _rows(folder / "validation.csv")
    selection = validations[:: max(1, len(validations) // SHOWN_VALIDATIONS)]
    cost = f", {on_cpu:.0f} minutes of one core" if on_cpu else ""
    cost += "" if device == "cpu" else f", {device}"
    lines = [
        f"# {task.name}",
        "",
        task.summary,
        "",
        f"- Command: `{command}`",
        f"- Steps: {steps}, {hours:.1f} hours on {platform.machine()} ({platform.system()}){cost}",
        f"- Pixels of target views: {pixels / 1e6:.0f} million, including those of the initial "
        f"weights, if known",
        f"- Weights: `{weights.name}`, {weights.stat().st_size / 2**20:.1f} MB, half precision, "
        f"averaged over the last steps,",
        f"  sha256 {hashlib.sha256(weights.read_bytes()).hexdigest()}",
        f"- Data: {task.data}",
        "- Licence: that of this package.",
        *([f"- Note: {note}"] if note else []),
        "",
        "## Options",
        "",
        *(f"- {name}: {value}" for name, value in _options(task).items()),
        "",
        "## Validation",
        "",
        f"{task.evaluated_on}",
        "",
        *_table(
            selection
            if not validations or selection[-1] == validations[-1]
            else [*selection, validations[-1]]
        ),
    ]
    card = folder / f"{task.name}.md"
    card.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return card


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.is_file():
        return []
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def _options(task: Task) -> dict[str, object]:
    """Return the fields of a task that its repr shows."""
    if not is_dataclass(task) or isinstance(task, type):
        return {}
    values = asdict(task)
    return {field.name: values[field.name] for field in fields(task) if field.repr}


def _table(rows: list[dict[str, str]]) -> list[str]:
    if not rows:
        return ["not computed: the training has not reached its first validation"]
    header = list(rows[0])
    body = ["| " + " | ".join(row[name] for name in header) + " |" for row in rows]
    return [
        "| " + " | ".join(header) + " |",
        "| " + " | ".join("---:" for _ in header) + " |",
        *body,
    ]


def train(task: Task, folder: Path, options: TrainingOptions) -> Path:
    """Train a network, or continue training it.

    Args:
        folder: gets ``state.pt`` (to continue from), ``log.csv``, ``validation.csv``, both drawn in
            ``<task>.png``, and ``<task>.safetensors``.
    """
    device = compute_device(options.device)
    state = _start(task, folder, device, options.start_from)
    log = TrainingLog(folder, state.step)
    if options.compile_network:
        state.network.compile(dynamic=False)
    for step, batch in _remaining(task, state.step, options):
        started, on_cpu = perf_counter(), process_time()
        figures = _step(task, state, batch, step, options, device)
        log.step(
            step,
            figures | {"seconds": perf_counter() - started, "cpu_seconds": process_time() - on_cpu},
        )
        state.step, state.pixels = step + 1, state.pixels + task.step_pixels
        last = state.step == options.steps
        if last:
            with computing_on(device):
                task.settle(state.average.module)
        if last or state.step % options.validate_every == 0:
            with computing_on(device):
                log.validation(state.step, task.validate(state.average.module))
            draw_curves(folder, task.name)
        if last or state.step % options.save_every == 0:
            write_state(folder, state)
            write_weights(folder / f"{task.name}.safetensors", state.average.module, _notes(state))
    return folder / f"{task.name}.safetensors"


def _start(
    task: Task, folder: Path, device: torch.device, start_from: Path | None
) -> TrainingState:
    network, pixels = task.network(), 0
    if start_from is not None and not state_file(folder).is_file():
        pixels = pour_weights(start_from, network)
    network = network.to(device)
    for parameter in network.parameters():
        # weights of images' convolutions; those of volumes stay as they are
        if parameter.dim() == 4:
            parameter.data = parameter.data.contiguous(memory_format=torch.channels_last)
    average = AveragedModel(
        network, avg_fn=partial(_averaged, task.schedule.average), use_buffers=True
    )
    schedule = task.schedule
    optimiser = torch.optim.AdamW(
        network.parameters(), schedule.learning_rate, weight_decay=schedule.weight_decay
    )
    state = TrainingState(
        step=0, pixels=pixels, network=network, average=average, optimiser=optimiser
    )
    return read_state(folder, state, device)


def _notes(state: TrainingState) -> dict[str, str]:
    """Write the notes in the header of the weights: steps, pixels, and the configuration of a
    network that has several.
    """
    configuration = getattr(state.network, "configuration", None)
    notes = {"steps": str(state.step), PIXELS_NOTE: str(state.pixels)}
    return notes if configuration is None else {**notes, CONFIGURATION_NOTE: configuration}


def _averaged(
    decay: float, average: torch.Tensor, current: torch.Tensor, count: torch.Tensor | int
) -> torch.Tensor:
    """Running average that forgets faster at first, so that it does not keep the random weights it
    began with.
    """
    if not average.is_floating_point():
        return current
    return torch.lerp(average, current, 1 - min(decay, (1 + int(count)) / (10 + int(count))))


def _remaining(task: Task, start: int, options: TrainingOptions) -> Iterator[tuple[int, Any]]:
    steps = range(start, options.steps)
    numbered = zip(steps, _batches(task, start, options.steps, options.workers), strict=True)
    yield from track(numbered, f"training {task.name}", len(steps))


def _step(
    task: Task,
    state: TrainingState,
    batch: Any,
    step: int,
    options: TrainingOptions,
    device: torch.device,
) -> dict[str, float]:
    rate = task.schedule.rate(step, options.steps)
    for group in state.optimiser.param_groups:
        group["lr"] = rate
    with (
        computing_on(device),
        torch.autocast(
            device.type, torch.bfloat16, enabled=uses_bfloat16(options.precision, device)
        ),
    ):
        loss, figures = task.loss(
            state.network,
            {name: tensor.to(device, non_blocking=True) for name, tensor in batch.items()},
        )
    state.optimiser.zero_grad(set_to_none=True)
    loss.backward()
    norm = nn.utils.clip_grad_norm_(state.network.parameters(), task.schedule.clip)
    if torch.isfinite(norm):  # one bad batch must not spoil the weights for ever; the log shows it
        state.optimiser.step()
        state.average.update_parameters(state.network)
    return {
        "loss": float(loss.detach()),
        **figures,
        "gradient_norm": float(norm),
        "learning_rate": rate,
    }


def uses_bfloat16(precision: Precision, device: torch.device) -> bool:
    """Return whether convolutions run in bfloat16.

    ``auto`` asks for hardware that multiplies it in tiles.
    """
    if precision != "auto":
        return precision == "bfloat16"
    if device.type == "cuda":
        return bool(torch.cuda.is_bf16_supported(including_emulation=False))
    return bool(torch.cpu._is_amx_tile_supported())


class _Steps(Dataset[Any]):
    """Step -> batch."""

    def __init__(self, task: Task) -> None:
        self.task = task

    def __getitem__(self, step: int) -> Any:
        return self.task.batch(step)


def _batches(task: Task, start: int, stop: int, workers: int) -> Iterator[Any]:
    """Yield the batches of steps start..stop-1 in order.

    Which worker process makes which does not change them.
    """
    loader = DataLoader(
        _Steps(task),
        batch_size=None,
        sampler=range(start, stop),
        num_workers=workers,
        worker_init_fn=_one_thread,
        prefetch_factor=4 if workers else None,
        multiprocessing_context="spawn" if workers else None,
    )
    return iter(loader)


def _one_thread(_worker: int) -> None:
    import cv2

    cv2.setNumThreads(1)
    torch.set_num_threads(1)
