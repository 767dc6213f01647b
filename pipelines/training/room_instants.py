"""What the baselines learn from: the same targets and sources as the blending network's, as a method is shown them."""

import hashlib
import json
import os
import zipfile
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.baselines.method import Instant, SourceView
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.errors import TrainingError
from ggvs_eval.images import Image8
from ggvs_eval.pipelines.offline.depth_choice import DepthChoice
from ggvs_eval.pipelines.training.blend_rooms import RoomPlan, choose_views, film_room, refuse_tests
from ggvs_eval.pipelines.training.blend_samples import SampleMaker, camera_of, camera_values
from ggvs_eval.processes import finish_all, worker_pool

FOCUS_MARGIN_PX = 8  # what a convolution sees around a pixel
FOCUS_MULTIPLE = 32
VERSION = 1  # counts up whenever equal plans give other samples


@dataclass(frozen=True, eq=False)
class InstantSample:
    """One target view.

    Attributes:
        instant: what a method is shown.
        truth: what the target's camera saw, (H, W, 3) uint8.
    """

    instant: Instant
    truth: Image8

    def cropped(self, left: int, top: int, width: int, height: int) -> "InstantSample":
        """The window of the target that starts at pixel (left, top); sources stay whole."""
        target = self.instant.target.cropped(left, top, width, height)
        truth = self.truth[top : top + height, left : left + width]
        return InstantSample(replace(self.instant, target=target), truth)

    def focused(self, margin_px: int = FOCUS_MARGIN_PX, multiple: int = FOCUS_MULTIPLE) -> "InstantSample":
        """The same with each source cut to what the target's window can show of it at any depth, all to one size.

        Args:
            margin_px: kept around that.
            multiple: sides are so many pixels times a whole number, if the sources are large enough.
        """
        boxes = np.stack([_window_in(source.camera, self.instant.target) for source in self.instant.sources])  # (K, 4)
        sizes = np.array([source.camera.size for source in self.instant.sources])
        wanted = (boxes[:, 2:] - boxes[:, :2]).max(axis=0) + 2 * margin_px
        size = np.minimum(np.ceil(wanted / multiple) * multiple, sizes.min(axis=0)).astype(int)
        start = np.clip(np.floor((boxes[:, :2] + boxes[:, 2:] - size) / 2), 0, sizes - size).astype(int)
        sources = tuple(
            _cut(source, *corner, *size.tolist()) for source, corner in zip(self.instant.sources, start.tolist(), strict=True)
        )
        return InstantSample(replace(self.instant, sources=sources), self.truth)

    def recoloured(self, order: tuple[int, ...]) -> "InstantSample":
        """The same with red, green and blue in another order, in sources and truth alike."""
        sources = tuple(replace(source, image=np.ascontiguousarray(source.image[..., order])) for source in self.instant.sources)
        return InstantSample(replace(self.instant, sources=sources), np.ascontiguousarray(self.truth[..., order]))


class RoomInstants:
    """The samples of a plan on disk.

    Args:
        folder: where rooms and samples are kept; `RoomSamples` may share it.
        plan: which samples.
        depth: whether sources come with depth; methods that take none need not wait for it.

    Raises:
        TrainingError: seeds of neither training nor validation rooms, or a plan without samples.
    """

    def __init__(self, folder: Path, plan: RoomPlan, depth: bool = True) -> None:
        refuse_tests(plan)
        self.plan = plan
        self._depth = depth
        self._rooms = folder / "rooms"
        self._samples = folder / f"instants-{_digest(plan, depth)}"

    def __repr__(self) -> str:
        """The plan; the model card shows it, and where the folder lies is nobody's business."""
        return repr(self.plan)

    def __len__(self) -> int:
        return self.plan.rooms * self.plan.targets

    @property
    def data(self) -> str:
        """What they show, for the model card."""
        depth = f"depth by {self.plan.matcher}" if self._depth else "no depth"
        return f"{len(self)} views of {self.plan.rooms} procedural rooms (ggvs_eval.synthetic), {depth}"

    def read(self, index: int) -> InstantSample:
        """One of the samples.

        Raises:
            TrainingError: it has not been prepared, or is damaged.
        """
        room, target = divmod(index, self.plan.targets)
        return read_instant(self._path(self.plan.seeds[room], target))

    def prepare(self, workers: int) -> None:
        """Film the rooms and make the samples that are not there yet; a killed preparation goes on where it stopped.

        Args:
            workers: processes; a room is one job.
        """
        missing = [seed for seed in self.plan.seeds if not all(self._path(seed, n).is_file() for n in range(self.plan.targets))]
        if not missing:
            return
        with worker_pool(min(workers, len(missing))) as pool:
            finish_all(pool, [pool.submit(self.prepare_room, seed) for seed in missing], "rooms to learn from")

    def prepare_room(self, seed: int) -> None:
        """Film one room and make its samples."""
        self.prepare_capture(seed, film_room(self._rooms, seed, self.plan))

    def prepare_capture(self, seed: int, capture: Capture) -> None:
        """Make the samples of a room that has been filmed."""
        maker = SampleMaker(capture, DepthChoice(self.plan.matcher).options())
        for number in range(self.plan.targets):
            path = self._path(seed, number)
            if not path.is_file():
                write_instant(path, self._sample(maker, seed, number))

    def _sample(self, maker: SampleMaker, seed: int, number: int) -> InstantSample:
        target, sources = choose_views(maker.capture, self.plan, seed, number)
        if self._depth:
            return InstantSample(maker.instant(target, sources), maker.truth(target))
        views = []
        for source in sources:
            unknown = np.zeros((source.height, source.width), np.float32)
            views.append(SourceView(source, maker.truth(source), unknown, unknown))
        return InstantSample(Instant(0, target, tuple(views), maker.capture.units_per_metre), maker.truth(target))

    def _path(self, seed: int, number: int) -> Path:
        return self._samples / f"room{seed}-{number:02d}.npz"


def _window_in(source: Camera, target: Camera) -> NDArray[np.float64]:
    """Left, top, right and bottom of what the target can see, where the source sees it, (4,), within the source's image."""
    columns, rows = (np.linspace(0, side, 5) for side in target.size)
    rim = np.stack(np.meshgrid(columns, rows, [target.near, (target.near * target.far) ** 0.5, target.far]), axis=-1).reshape(
        -1, 3
    )
    uv, depth = source.project(target.unproject(rim[:, :2], rim[:, 2]))
    seen = uv[depth > 0] if (depth > 0).any() else np.array([[0.0, 0.0], source.size])
    limits = np.array(source.size, np.float64)
    return np.concatenate([seen.min(axis=0).clip(0, limits), seen.max(axis=0).clip(0, limits)])


def _cut(source: SourceView, left: int, top: int, width: int, height: int) -> SourceView:
    rows, columns = slice(top, top + height), slice(left, left + width)
    return SourceView(
        source.camera.cropped(left, top, width, height),
        np.ascontiguousarray(source.image[rows, columns]),
        np.ascontiguousarray(source.depth[rows, columns]),
        np.ascontiguousarray(source.confidence[rows, columns]),
    )


def write_instant(path: Path, sample: InstantSample) -> None:
    """Write a sample so that a killed process leaves either the whole file or none; depth in half precision, per its median."""
    instant = sample.instant
    depths = np.stack([source.depth for source in instant.sources])
    unit = float(np.median(depths[depths > 0])) if (depths > 0).any() else 1.0
    cameras = [instant.target, *(source.camera for source in instant.sources)]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    with temporary.open("wb") as file:
        np.savez(
            file,
            cameras=np.stack([camera_values(camera) for camera in cameras]),
            names=np.array([camera.name for camera in cameras]),
            images=np.stack([source.image for source in instant.sources]),
            depths=(depths / np.float32(unit)).astype(np.float16),
            unit=np.float64(unit),
            units_per_metre=np.float64(instant.units_per_metre),
            truth=sample.truth,
        )
    temporary.replace(path)


def read_instant(path: Path) -> InstantSample:
    """Read what `write_instant` wrote; confidence is 1 where depth is known.

    Raises:
        TrainingError: absent or damaged.
    """
    try:
        with np.load(path, allow_pickle=False) as stored:
            arrays = {name: stored[name] for name in stored.files}
        target, *cameras = (camera_of(str(name), row) for name, row in zip(arrays["names"], arrays["cameras"], strict=True))
        depths = arrays["depths"].astype(np.float32) * np.float32(arrays["unit"])
        sources = tuple(
            SourceView(camera, image, depth, (depth > 0).astype(np.float32))
            for camera, image, depth in zip(cameras, arrays["images"], depths, strict=True)
        )
        return InstantSample(Instant(0, target, sources, float(arrays["units_per_metre"])), arrays["truth"])
    except (OSError, KeyError, ValueError, EOFError, zipfile.BadZipFile) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        raise TrainingError(f"{path}: wanted a training sample, got none ({reason}); delete it and prepare again") from error


def _digest(plan: RoomPlan, depth: bool) -> str:
    """Names all that a sample depends on but its room and its number."""
    options = DepthChoice(plan.matcher).options()
    described = {
        "version": VERSION,
        "views": [plan.views, plan.other_views, plan.other_share],
        "size": [plan.width, plan.height],
        "wide_share": plan.wide_share,
        "depth": options.describe() if depth else None,
        "consistency": options.consistency.describe() if depth and options.consistency else None,
    }
    return hashlib.sha256(json.dumps(described, sort_keys=True).encode()).hexdigest()[:12]
