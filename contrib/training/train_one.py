"""The training of one network as it is asked for: samples in place, steps, the card."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.baselines.learned import LearnedBaseline
from ggvs_eval.compute_device import compute_device, describe_device
from ggvs_eval.contrib.training import blend_task, stereo_task
from ggvs_eval.contrib.training.blend_task import FINE_TUNING, LEARNING, BlendTask
from ggvs_eval.contrib.training.instant_samples import InstantSample
from ggvs_eval.contrib.training.loop import train, write_card
from ggvs_eval.contrib.training.recipes.recipe import RECIPES, TRAINED_BASELINES, TrainingRecipe
from ggvs_eval.contrib.training.request import TrainingOptions
from ggvs_eval.contrib.training.samples.sample_kinds import BlendKind, InstantKind
from ggvs_eval.contrib.training.samples.samples import SamplePool, require_room
from ggvs_eval.contrib.training.samples.training_data import prepare_samples, sample_pools
from ggvs_eval.contrib.training.stereo_task import StereoTask
from ggvs_eval.contrib.training.task import Schedule, Task, freeze_statistics, recompute_statistics
from ggvs_eval.errors import TrainingError
from ggvs_eval.files.images import quantise
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.method import Instant
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.pipelines.online.blend_network import WIDTHS, BlendNetworkShape
from ggvs_eval.plugins import DEVICE_PARTS

STATISTICS_VIEWS = 48  # that running statistics are computed over
# windows of SSIM and of attention fit in, coarse levels of volumes have whole pixels
LEAST_CROP_PX, CROP_MULTIPLE = 32, 8


def baseline_task(
    name: str,
    cache: Path,
    data: TrainingOptions,
    configuration: str = "compact",
    seed: int = 0,
    is_trained: bool = False,
    crop: tuple[int, int] | None = None,
) -> "BaselineTask":
    """Return the training of a baseline on the views that the blending network learns from.

    Args:
        name: one of `TRAINED_BASELINES`.
        is_trained: begins with weights that have learned already, and changes them less.
        crop: width and height of the target's crops, pixels; the recipe's where None.
    """
    baseline = TRAINED_BASELINES[name]
    samples = sample_pools(cache, data, InstantKind(baseline.takes_depth))
    recipe = RECIPES[name](configuration, seed)
    if crop:
        if min(crop) < LEAST_CROP_PX or any(side % CROP_MULTIPLE for side in crop):
            raise TrainingError(
                f"{name}: wanted crops whose sides are multiples of {CROP_MULTIPLE} and at least "
                f"{LEAST_CROP_PX} pixels, got {crop[0]} x {crop[1]}; correct --crop"
            )
        recipe = replace(recipe, crop_width=crop[0], crop_height=crop[1])
    return BaselineTask(
        *samples,
        baseline,
        recipe,
        recipe.batch_size,
        FINE_TUNING if is_trained else LEARNING,
        is_trained,
    )


@dataclass(frozen=True)
class BaselineTask:
    """The training of a method that the paper compares itself with.

    Attributes:
        training: samples to learn from; their `prepare` makes them.
        validation: samples that are never learned from.
        recipe: its network, its loss and the size of its crops.
        schedule: that of the blending network; what a rate for a GPU's day would learn in an hour
            of one core is little.
        has_statistics: the network begins with running statistics that are right, and learns under
            them; else they follow the crops, and are computed anew at the end.
    """

    training: SamplePool[InstantSample]
    validation: SamplePool[InstantSample]
    baseline: LearnedBaseline = field(repr=False)
    recipe: TrainingRecipe[Any]
    batch_size: int = 1
    schedule: Schedule = LEARNING
    has_statistics: bool = False

    def __post_init__(self) -> None:
        """Refuse options that do not fit together."""
        require_room(self.training, self.recipe.crop_width, self.recipe.crop_height)

    @property
    def name(self) -> str:
        """Names the weights."""
        return self.baseline.name

    @property
    def summary(self) -> str:
        """Sentence of the model card on the network."""
        return f"The training of {self.baseline.title} ({self.baseline.source})."

    @property
    def data(self) -> str:
        """Sentence of the model card on the training data."""
        return f"{self.training.data}; the targets and sources of the blending network's training"

    @property
    def evaluated_on(self) -> str:
        """Sentence of the model card on the measures of `validate`."""
        step, refusals = (
            self.recipe.validated_step,
            [refusal for refusal in self._refusals if refusal],
        )
        measures = "PSNR (dB) and SSIM, means of whole views, single instants"
        if step > 1:
            measures = f"PSNR (dB) of one pixel in {step} x {step}; means of single instants"
        left_out = (
            f"; without {len(refusals)} of them, as the method cannot render such views: "
            f"{refusals[0]}"
            if refusals
            else ""
        )
        return f"{measures}: {self.validation.data}{left_out}."

    @property
    def step_pixels(self) -> int:
        """Pixels of target views that a step learns from."""
        return self.batch_size * self.recipe.crop_pixels

    def network(self) -> nn.Module:
        """Return a fresh network."""
        torch.manual_seed(self.recipe.seed)
        network: nn.Module = self.recipe.network()
        return network

    def batch(self, step: int) -> dict[str, Tensor]:
        """Draw the crops of a step.

        Returns:
            ``samples``: numbers, (B,). ``places``: of the windows, as shares of the room that each
            sample leaves to its right and below, (B, 2), in [0, 1). ``colours``: their order, (B,
            3). ``step``: its number, ().
        """
        rng = np.random.default_rng([self.recipe.seed, step])
        draws = {
            "samples": rng.integers(len(self.training), size=self.batch_size),
            "places": rng.random((self.batch_size, 2)),
            "colours": np.stack([rng.permutation(3) for _ in range(self.batch_size)]),
            "step": np.array(step),
        }
        return {name: torch.as_tensor(values) for name, values in draws.items()}

    def loss(
        self, network: nn.Module, batch: Mapping[str, Tensor]
    ) -> tuple[Tensor, Mapping[str, float]]:
        """Return the mean over the crops.

        ``passed_over`` counts the views that a crop skipped, see `_crop_loss`.
        """
        network.train()
        if self.has_statistics:
            freeze_statistics(network)
        losses, figures = [], []
        for number, place, order in zip(
            *(batch[name].tolist() for name in ("samples", "places", "colours")), strict=True
        ):
            loss, terms = self._crop_loss(network, number, place, order, int(batch["step"]))
            losses.append(loss)
            figures.append({name: float(term.detach()) for name, term in terms.items()})
        means = {
            name: sum(figure[name] for figure in figures) / len(figures) for name in figures[0]
        }
        return torch.stack(losses).mean(), means

    def _crop_loss(
        self,
        network: nn.Module,
        number: int,
        place: Sequence[float],
        order: Sequence[int],
        step: int,
    ) -> tuple[Tensor, dict[str, Tensor]]:
        """Loss of the window at a place of a sample, or of the next one that the method can render
        and that shows something.
        """
        refusal = None
        for passed_over in range(len(self.training)):
            sample = self._crop(
                self.training.read((number + passed_over) % len(self.training)), place
            ).focused()
            refusal = self.recipe.refusal(sample.instant)
            if refusal is None:
                loss, terms = self.recipe.sample_loss(
                    network, sample.recoloured(tuple(order)), step
                )
                # as it does not where no source has depth of what the window shows
                if loss.requires_grad:
                    return loss, {**terms, "passed_over": torch.tensor(float(passed_over))}
        reason = refusal or "no source has depth in these views"
        raise TrainingError(
            f"{self.name}: wanted training views, got none that it can render: {reason}; give "
            f"others"
        )

    def _crop(self, sample: InstantSample, place: Sequence[float]) -> InstantSample:
        """Return the window at a place of a sample, regardless of the sample's size."""
        width, height = sample.instant.target.size
        across, down = self.recipe.crop_width, self.recipe.crop_height
        left, top = int(place[0] * (width - across + 1)), int(place[1] * (height - down + 1))
        return sample.cropped(left, top, across, down)

    @cached_property
    def _refusals(self) -> list[str | None]:
        """Of each validation view why the method cannot render it, None if it can."""
        return [
            self.recipe.refusal(self.validation.read(index).instant)
            for index in range(len(self.validation))
        ]

    def settle(self, network: nn.Module) -> None:
        """Compute running statistics anew, over whole views of all parts of the training data."""
        if not self.has_statistics:
            count = min(STATISTICS_VIEWS, len(self.training))
            samples = (
                self.training.read(number * len(self.training) // count) for number in range(count)
            )
            instants = (
                sample.instant for sample in samples if self.recipe.refusal(sample.instant) is None
            )
            recompute_statistics(
                network, (partial(self._render, instant=instant) for instant in instants)
            )

    def _render(self, network: nn.Module, instant: Instant) -> Tensor:
        return self.recipe.validated_view(network, instant)

    def validate(self, network: nn.Module) -> Mapping[str, float]:
        """Return the scores of the validation views that the method can render, their means."""
        network.eval()
        scores = []
        for index in (index for index, refusal in enumerate(self._refusals) if refusal is None):
            sample = self.validation.read(index)
            with torch.inference_mode():
                view = self.recipe.validated_view(network, sample.instant).float()
            scores.append(self._scores(view.permute(1, 2, 0).numpy(force=True), sample.truth))
        if not scores:
            raise TrainingError(
                f"{self.name}: wanted validation views, got none that it can render: "
                f"{self._refusals[0]}"
            )
        return {name: sum(score[name] for score in scores) / len(scores) for name in scores[0]}

    def _scores(self, view: Map, truth: Image8) -> dict[str, float]:
        """Return a whole view as an evaluation would measure it.

        Pixels without their neighbours have no SSIM.
        """
        step = self.recipe.validated_step
        if step > 1:
            return {"psnr_db": psnr(view, truth[::step, ::step] / np.float32(255))}
        image = quantise(view)
        return {"psnr_db": psnr(image, truth), "ssim": ssim(image, truth)}


CACHE = "blend-samples"  # next to the folders of the trainings
# of a GPU, for a worker that makes samples: its context, kernels, and a sample's maps
WORKER_BYTES = 2**30


def train_one(name: str, folder: Path, request: TrainingOptions) -> tuple[Path, Path]:
    """Train a network, or continue training it.

    Args:
        name: stereo, blend, or one of `TRAINED_BASELINES`.

    Returns:
        The file of the weights, and the card.
    """
    # what is missing shows before anything is rendered
    hardware = describe_device(compute_device(request.device))
    task = planned_task(name, folder.parent / CACHE, request)
    weights = train(task, folder, request)
    command = " ".join(["ggvs-eval train", name, folder.name, *request.card_words(name)])
    return weights, write_card(task, folder, command, device=hardware)


def planned_task(name: str, cache: Path, request: TrainingOptions) -> Task:
    """Return the task that is asked for, its samples in place."""
    if name == "stereo":
        return StereoTask(
            seed=request.seed,
            schedule=Schedule() if request.start_from is None else stereo_task.FINE_TUNING,
        )
    is_trained = request.start_from is not None
    if name != "blend":
        baseline = baseline_task(
            name, cache, request, request.configuration, request.seed, is_trained, request.crop
        )
        prepare_samples(baseline.training, baseline.validation, usable_cpus())
        return baseline
    config, device = (
        BlendNetworkShape(request.views, request.guidance, WIDTHS[request.size]),
        sample_device(request),
    )
    schedule = blend_task.FINE_TUNING if is_trained else blend_task.LEARNING
    blend = BlendTask(
        *sample_pools(cache, request, BlendKind(device)),
        config,
        seed=request.seed,
        schedule=schedule,
    )
    prepare_samples(blend.training, blend.validation, sample_workers(device))
    return blend


def sample_device(request: TrainingOptions) -> str:
    """Device of the blending network's samples: that of its training if NVIDIA Warp is installed,
    else on the CPU.
    """
    return str(compute_device(request.device)) if "training samples" in DEVICE_PARTS else "cpu"


def sample_workers(device: str) -> int:
    """Processes that make samples side by side: one per CPU, but of those that share a GPU no more
    than its memory holds.
    """
    if device.startswith("cuda"):
        return max(min(usable_cpus(), torch.cuda.mem_get_info(device)[0] // WORKER_BYTES), 1)
    return usable_cpus()
