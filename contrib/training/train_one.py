"""The training of one network as it is asked for: samples in place, steps, the card."""

from pathlib import Path

import torch

from ggvs_eval.compute_device import compute_device, describe_device
from ggvs_eval.contrib.training.baseline_task import baseline_task
from ggvs_eval.contrib.training.blend import blend_task
from ggvs_eval.contrib.training.blend.blend_task import BlendTask
from ggvs_eval.contrib.training.card import write_card
from ggvs_eval.contrib.training.loop import train
from ggvs_eval.contrib.training.request import TrainingRequest
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind
from ggvs_eval.contrib.training.samples.training_data import prepare_samples, sample_pools
from ggvs_eval.contrib.training.stereo import stereo_task
from ggvs_eval.contrib.training.stereo.stereo_task import StereoTask
from ggvs_eval.contrib.training.task import Schedule, Task
from ggvs_eval.jobs.processes import default_workers
from ggvs_eval.pipelines.online.blend_network import WIDTHS, BlendNetworkOptions
from ggvs_eval.plugins import DEVICE_PARTS

CACHE = "blend-samples"  # beside the folders of the trainings
WORKER_BYTES = 2**30  # of a GPU, for a worker that makes samples: its context, kernels, and a sample's maps


def train_one(what: str, folder: Path, request: TrainingRequest) -> tuple[Path, Path]:
    """Train a network, or go on training it.

    Args:
        what: stereo, blend, or one of `TRAINED_BASELINES`.

    Returns:
        The file of the weights, and the card.
    """
    hardware = describe_device(compute_device(request.device))  # what is missing shows before anything is rendered
    task = planned_task(what, folder.parent / CACHE, request)
    weights = train(task, folder, request)
    command = " ".join(["ggvs-eval train", what, folder.name, *request.card_words(what)])
    return weights, write_card(task, folder, command, device=hardware)


def planned_task(what: str, cache: Path, request: TrainingRequest) -> Task:
    """The task that is asked for, its samples in place."""
    if what == "stereo":
        return StereoTask(seed=request.seed, schedule=Schedule() if request.start_from is None else stereo_task.FINE_TUNING)
    is_trained = request.start_from is not None
    if what != "blend":
        baseline = baseline_task(what, cache, request, request.configuration, request.seed, is_trained, request.crop)
        prepare_samples(baseline.training, baseline.validation, default_workers())
        return baseline
    config, device = BlendNetworkOptions(request.views, request.guidance, WIDTHS[request.size]), sample_device(request)
    schedule = blend_task.FINE_TUNING if is_trained else blend_task.LEARNING
    blend = BlendTask(*sample_pools(cache, request, BlendKind(device)), config, seed=request.seed, schedule=schedule)
    prepare_samples(blend.training, blend.validation, sample_workers(device))
    return blend


def sample_device(request: TrainingRequest) -> str:
    """Device of the blending network's samples: that of its training if NVIDIA Warp is installed, else on the CPU."""
    return str(compute_device(request.device)) if "training samples" in DEVICE_PARTS else "cpu"


def sample_workers(device: str) -> int:
    """Processes that make samples side by side: one per CPU, but of those that share a GPU no more than its memory holds."""
    if device.startswith("cuda"):
        return max(min(default_workers(), torch.cuda.mem_get_info(device)[0] // WORKER_BYTES), 1)
    return default_workers()
