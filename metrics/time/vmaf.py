"""VMAF, the video industry's fused measure, by the ffmpeg that imageio-ffmpeg brings."""

import json
import subprocess
from collections.abc import Iterable, Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from ggvs_eval import kernels
from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import FURTHER, ColourMap, MetricOptions, TruthFrame, Value, ViewMetric
from ggvs_eval.metrics.time.spooled_frames import SpooledFrames

MODEL = "vmaf_v0.6.1"
MIN_SIDE_PX = 32  # below, VMAF's pyramid has no coarsest scale
TIMEOUT_S = 3600


def vmaf(pairs: Iterable[tuple[Image8, Image8]], model: str = MODEL, matrix: str = "bt709") -> list[float]:
    """VMAF of each frame of one view.

    Args:
        pairs: rendered and captured frame of each instant, in order, (H, W, 3) uint8; spooled to disk.
        model: version of one that is built in, e.g. ``vmaf_v0.6.1neg``.
        matrix: which YCbCr luma is taken from, ``bt709`` or ``bt601``.

    Returns:
        One value per frame, 0 to 100; higher is better.

    Raises:
        MetricError: imageio-ffmpeg is not installed, its ffmpeg lacks libvmaf or fails, or the frames are too small.

    Example:
        >>> import numpy as np
        >>> truth = np.full((64, 64, 3), 100, np.uint8)
        >>> vmaf([(truth, truth)])  # doctest: +SKIP
        [97.43...]

    Reading:
        Model vmaf_v0.6.1, for a 1080p screen at three heights, whatever the size of the frames. It looks at luma alone, here
        BT.709 in 16..235, and was trained on compression and scaling: it says little of geometry.
    """
    with SpooledFrames() as frames:
        for rendered, truth in pairs:
            check_pair(rendered, truth)
            frames.add(rendered, truth)
        return _vmaf_of(frames, model, matrix)


def _vmaf_of(frames: SpooledFrames, model: str = MODEL, matrix: str = "bt709") -> list[float]:
    if not frames.count or min(frames.shape[:2]) < MIN_SIDE_PX:
        raise MetricError(f"VMAF needs frames of at least {MIN_SIDE_PX} pixels a side, got {frames.count} of {frames.shape[:2]}")
    with TemporaryDirectory(prefix="ggvs-eval-vmaf-") as folder:
        log = Path(folder) / "vmaf.json"
        height, width = frames.shape[:2]
        raw = ["-f", "rawvideo", "-pix_fmt", "rgb24", "-video_size", f"{width}x{height}", "-framerate", "30"]
        measure = f"libvmaf=log_fmt=json:log_path={log.name}:model=version={model}:n_threads={kernels.get_threads()}"
        to_luma = f"scale=out_color_matrix={matrix}:out_range=tv,format=yuv420p"
        graph = f"[0:v]{to_luma}[rendered];[1:v]{to_luma}[truth];[rendered][truth]{measure}"
        inputs = [*raw, "-i", str(frames.rendered), *raw, "-i", str(frames.truth)]
        command = [find_ffmpeg(), "-nostdin", "-loglevel", "error", *inputs, "-lavfi", graph, "-f", "null", "-"]
        try:
            run = subprocess.run(command, cwd=folder, capture_output=True, text=True, timeout=TIMEOUT_S, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise MetricError(f"VMAF: {error}") from error
        if run.returncode or not log.is_file():
            reason = (run.stderr.strip().splitlines() or ["no word why"])[-1]
            raise MetricError(f"VMAF: ffmpeg failed: {reason}")
        return [float(frame["metrics"]["vmaf"]) for frame in json.loads(log.read_text(encoding="utf-8"))["frames"]]


def find_ffmpeg() -> str:
    """The program of imageio-ffmpeg, or that of its variable ``IMAGEIO_FFMPEG_EXE``."""
    try:
        import imageio_ffmpeg

        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except (ImportError, RuntimeError) as error:
        raise MetricError("VMAF needs the ffmpeg of imageio-ffmpeg; `pip install 'ggvs-eval[vmaf]'`") from error


class VmafScorer:
    """VMAF; all frames have their values at the end."""

    names = ("VMAF",)

    def __init__(self, _names: Sequence[str], _options: MetricOptions, _colour_map: ColourMap | None) -> None:
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
            return [("VMAF", index, value) for index, value in zip(self._indices, _vmaf_of(frames), strict=True)]


VMAF = ViewMetric(
    name="VMAF",
    kind="frame",
    function=vmaf,
    higher_is_better=True,
    group=FURTHER,
    decimals=2,
    describe=f"fused measure of the video industry, 0 to 100, model {MODEL}; trained on compression, says little of geometry",
    reference="Li et al. 2016, Netflix",
    scorer=VmafScorer,
)
