"""The verb of the command line that trains the networks of this package."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import tyro

from ggvs_eval.pipelines.commands.captures import Folder
from ggvs_eval.processes import default_workers

if TYPE_CHECKING:
    from ggvs_eval.pipelines.online.blend_network import BlendConfig
    from ggvs_eval.pipelines.training.blend_data import BlendData
    from ggvs_eval.pipelines.training.task import Task

Precision = Literal["auto", "float32", "bfloat16"]
Guidance = Literal["registered", "channels", "none", "naive"]
Size = Literal["small", "standard", "large"]


def train(
    what: Annotated[Literal["stereo", "blend", "fwd", "gps-gaussian", "ibrnet", "enerf"], tyro.conf.Positional],
    out: Folder,
    steps: int = 20000,
    seed: int = 0,
    views: int = 6,
    size: Size = "standard",
    guidance: Guidance = "registered",
    rooms: int = 3,
    targets: int = 9,
    domains: tuple[str, ...] = (),
    configuration: Literal["compact", "full"] = "compact",
    captures: tuple[Path, ...] = (),
    hold_back: bool = False,
    device: str = "auto",
    precision: Precision = "auto",
    workers: int = 1,
    compile_network: bool = False,
    start_from: Path | None = None,
) -> None:
    """Train a network of this package; a second call goes on where the first one stopped.

    Args:
        what: stereo: the compact RAFT-Stereo, on scenes made on the fly. blend: the blending network, on rooms that are filmed,
            and whose depth is estimated, before the first step (blend-samples beside the folder). fwd, gps-gaussian, ibrnet,
            enerf: a baseline, on the same rooms, targets and sources.
        out: folder for the state to go on from, the weights, the logs and the model card.
        steps: of the whole training, those of earlier calls included.
        seed: of the weights and the scenes.
        views: blend: the most source views it can take, K; it learns from two views on.
        size: blend: of the U-Net; its first level has 8, 16 or 32 channels.
        guidance: blend: what it sees of the fused depth: views registered by it, its channels as the paper prints them, none
            of it (ablation), or no depth at all (naive).
        rooms: blend, baselines: rooms to film of each domain, one to four minutes and 50 MB each.
        targets: blend, baselines: target views per room.
        domains: blend: kinds of captures to learn from and to choose by (plain, narrow, arc, ...); all of them unless named.
        configuration: baselines: compact, which an hour of one core trains, or full, as the authors publish it.
        captures: blend: folders of captures to learn from beside the rooms (RGB-D sequences by ScanNet's rule, Spaces, DyNeRF,
            rigs of your own), never those that you test on.
        hold_back: captures: RGB-D sequences are learned from in their first half, and what is new in the rest validates.
        device: cpu, cuda, or the better one by default.
        precision: of convolutions; auto takes bfloat16 where the hardware multiplies it faster.
        workers: processes that make batches.
        start_from: weights to begin with where the folder holds no state, such as those that ship.
        compile_network: let torch compile it first: some minutes once, a fifth less per step.
    """
    from ggvs_eval.compute_device import compute_device, describe_device
    from ggvs_eval.pipelines.online.blend_network import WIDTHS, BlendConfig
    from ggvs_eval.pipelines.training.blend_data import BlendData
    from ggvs_eval.pipelines.training.card import write_card
    from ggvs_eval.pipelines.training.loop import TrainingOptions
    from ggvs_eval.pipelines.training.loop import train as go_on

    hardware = describe_device(compute_device(device))  # what is missing shows before anything is filmed
    samples = out.parent / "blend-samples"
    if what == "stereo":
        task = _stereo(seed)
    elif what == "blend":
        data = BlendData(rooms, targets, domains, captures, hold_back)
        task = _blend(samples, seed, BlendConfig(views, guidance, WIDTHS[size]), data)
    else:
        task = _baseline(what, samples, seed, configuration, rooms, targets)
    options = TrainingOptions(
        steps=steps, device=device, precision=precision, workers=workers, compile=compile_network, start_from=start_from
    )
    command = f"ggvs-eval train {what} {out.name} --steps {steps} --seed {seed}"
    if what == "blend":
        command += f" --guidance {guidance} --views {views} --size {size} --rooms {rooms}"
        command += f" --targets {targets}" + (f" --domains {' '.join(domains)}" if domains else "")
        command += f" --captures {' '.join(path.name for path in captures)}" if captures else ""
        command += " --hold-back" if hold_back else ""
        command += f" --start-from {start_from.name}" if start_from else ""
    if what not in ("stereo", "blend"):
        command += f" --configuration {configuration} --rooms {rooms} --targets {targets}"
    print(go_on(task, out, options), write_card(task, out, command, device=hardware), sep="\n")


def _stereo(seed: int) -> "Task":
    from ggvs_eval.pipelines.training.stereo_task import StereoTask

    return StereoTask(seed=seed)


def _blend(cache: Path, seed: int, config: "BlendConfig", data: "BlendData") -> "Task":
    """The task with its samples in place."""
    from ggvs_eval.pipelines.training.blend_data import blend_samples
    from ggvs_eval.pipelines.training.blend_task import BlendTask

    training, validation = blend_samples(cache, data, config.views)
    for samples in (validation, training):
        samples.prepare(default_workers())
    return BlendTask(training, validation, config, seed=seed)


def _baseline(what: str, cache: Path, seed: int, configuration: str, rooms: int, targets: int) -> "Task":
    """The task of a baseline with its samples in place."""
    from ggvs_eval.pipelines.training.baseline_tasks import baseline_task
    from ggvs_eval.pipelines.training.room_plan import RoomPlan

    task = baseline_task(what, cache, RoomPlan(rooms=rooms, targets=targets), configuration, seed)
    for samples in (task.validation, task.training):
        samples.prepare(default_workers())
    return task
