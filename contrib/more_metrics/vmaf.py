"""VMAF, the video industry's fused measure, by the ffmpeg of imageio-ffmpeg."""

import json
import subprocess
from collections.abc import Iterable, Sequence
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import ClassVar

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.more_metrics.spooled_frames import SpooledFrames
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import (
    FURTHER,
    ColourMap,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)

MODEL = "vmaf_v0.6.1"
MODEL_V1 = "vmaf_v1.0.16_3d0h"  # built into libvmaf from 3.2 on
# Shorter and longer side: below, the pyramid has no coarsest scale; v1's measure of banding has
# none either, and crashes.
SMALLEST_PX = {MODEL_V1: (160, 216)}
SMALLEST_OF_OTHERS_PX = (32, 32)
TIMEOUT_S = 3600


def vmaf(
    pairs: Iterable[tuple[Image8, Image8]], model: str = MODEL, matrix: str = "bt709"
) -> list[float]:
    """VMAF of each frame of one view.

    Args:
        pairs: rendered and captured frame of each instant, in order, (H, W, 3) uint8; spooled to
            disk.
        model: version of one that is built in, e.g. ``vmaf_v0.6.1neg``.
        matrix: which YCbCr luma is taken from, ``bt709`` or ``bt601``.

    Returns:
        One value per frame, 0 to 100; higher is better.

    Raises:
        MetricError: imageio-ffmpeg is not installed, its ffmpeg lacks libvmaf or fails, or the
            frames are too small.

    Example:
        >>> import numpy as np
        >>> truth = np.full((64, 64, 3), 100, np.uint8)
        >>> vmaf([(truth, truth)])  # doctest: +SKIP
        [97.43...]

    Reading:
        Models for a 1080p screen at three heights, regardless of the size of the frames, and below
        45 frames per second. The older one looks at luma alone, v1.0.16 (June 2026) at chroma and
        banding too; frames are BT.709 in 16..235, 4:2:0. Both were trained on compression and
        scaling: they say little of geometry. Each is a separate metric, as their values differ and
        which models there are depends on the ffmpeg that is installed.
    """
    with SpooledFrames() as frames:
        for rendered, truth in pairs:
            check_pair(rendered, truth)
            frames.add(rendered, truth)
        return _vmaf_of(frames, model, matrix)


def _vmaf_of(frames: SpooledFrames, model: str = MODEL, matrix: str = "bt709") -> list[float]:
    smallest = SMALLEST_PX.get(model, SMALLEST_OF_OTHERS_PX)
    if not frames.count or any(
        side < least for side, least in zip(sorted(frames.shape[:2]), smallest, strict=True)
    ):
        sides = " x ".join(map(str, smallest))
        raise MetricError(
            f"VMAF by {model}: wanted frames of at least {sides} pixels, got {frames.count} of "
            f"{frames.shape[:2]}"
        )
    with TemporaryDirectory(prefix="ggvs-eval-vmaf-") as folder:
        log = Path(folder) / "vmaf.json"
        height, width = frames.shape[:2]
        raw = [
            "-f",
            "rawvideo",
            "-pix_fmt",
            "rgb24",
            "-video_size",
            f"{width}x{height}",
            "-framerate",
            "30",
        ]
        n_threads = kernels.get_threads()
        measure = (
            f"libvmaf=log_fmt=json:log_path={log.name}:model=version={model}:n_threads={n_threads}"
        )
        to_luma = f"scale=out_color_matrix={matrix}:out_range=tv,format=yuv420p"
        graph = f"[0:v]{to_luma}[rendered];[1:v]{to_luma}[truth];[rendered][truth]{measure}"
        inputs = [*raw, "-i", str(frames.rendered), *raw, "-i", str(frames.truth)]
        command = [
            find_ffmpeg(),
            "-nostdin",
            "-loglevel",
            "error",
            *inputs,
            "-lavfi",
            graph,
            "-f",
            "null",
            "-",
        ]
        try:
            run = subprocess.run(
                command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, check=False
            )
        except (OSError, subprocess.TimeoutExpired) as error:
            raise MetricError(f"VMAF: {error}") from error
        if run.returncode or not log.is_file():
            said = run.stderr.strip().splitlines()
            reason = next(
                (line for line in said if "libvmaf" in line), said[-1] if said else "no word why"
            )
            raise MetricError(f"VMAF by {model}: ffmpeg failed: {reason}")
        return [
            float(frame["metrics"]["vmaf"])
            for frame in json.loads(log.read_text(encoding="utf-8"))["frames"]
        ]


def find_ffmpeg() -> str:
    """Return the program of imageio-ffmpeg, or that of its variable ``IMAGEIO_FFMPEG_EXE``."""
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise MetricError(
            "VMAF needs the ffmpeg of imageio-ffmpeg; `pip install 'ggvs-eval[vmaf]'`"
        ) from error


class VmafScorer:
    """VMAF by its model of 2016; all frames have their values at the end."""

    names: ClassVar = ("VMAF_v0",)
    model: ClassVar = MODEL

    def __init__(
        self, _names: Sequence[str], _options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self._frames = SpooledFrames()
        self._indices: list[int] = []

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        if not self._indices:
            find_ffmpeg()  # before anything is written
        self._frames.add(rendered, truth.image)
        self._indices.append(index)
        return []

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        with self._frames as frames:
            values = _vmaf_of(frames, self.model)
        return [
            (self.names[0], index, value)
            for index, value in zip(self._indices, values, strict=True)
        ]


class VmafV1Scorer(VmafScorer):
    """VMAF by its model of 2026; a separate scorer, since an older ffmpeg lacks it alone."""

    names: ClassVar = ("VMAF_v1",)
    model: ClassVar = MODEL_V1


VMAF_V0, VMAF_V1 = (
    ViewMetric(
        name=scorer.names[0],
        kind="frame",
        function=partial(vmaf, model=scorer.model),
        higher_is_better=True,
        group=FURTHER,
        decimals=2,
        describe=f"fused measure of the video industry, 0 to 100, {scorer.model}; trained on "
        f"compression, not on geometry",
        reference="Li et al. 2016, Netflix",
        scorer=scorer,
    )
    for scorer in (VmafScorer, VmafV1Scorer)
)
