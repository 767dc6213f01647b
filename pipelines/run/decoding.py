"""The truth as other programs decode it from video.

FFmpeg's scaler has a fast conversion from YUV to RGB, which it takes unless it is asked to be
accurate. OpenCV, imageio, PyAV and plain ffmpeg commands do not ask. Its frames are darker by about
a level in each channel (1.0 of red, 1.4 of green, 1.0 of blue in the demo) and coarser in colour,
which costs a rendering of 32 dB one decibel.

Reading:
    Renders whose sources were decoded so are not recognised: they inherit the level of darkness,
    not the coarse colours, and honest renders of cameras with gains of their own are off by 1 to 5
    levels.
"""

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import video_of
from ggvs_eval.errors import GgvsError
from ggvs_eval.files.video import VideoFrames
from ggvs_eval.measured_frames import resized_frame
from ggvs_eval.pipelines.run.evaluate import recorded_capture
from ggvs_eval.pipelines.run.run_plan import fit_capture
from ggvs_eval.protocol import Measurement
from ggvs_eval.run_folder import RunFolder
from ggvs_eval.scoring import FrameReader


class _Sequence:
    """Frames of a camera by their number; those that are asked for in order are decoded once."""

    def __init__(self, capture: Capture, camera: str, measurement: Measurement) -> None:
        self._capture, self._camera = capture, camera
        self._measurement = measurement
        self._next = -1
        self._frames: Iterator[Image8] = iter(())

    def __call__(self, index: int) -> Image8:
        if index != self._next:
            self._frames = self._capture.frames(self._camera, index)
        self._next = index + 1
        return resized_frame(next(self._frames), self._measurement)


def fast_truth(run: RunFolder) -> dict[str, FrameReader]:
    """Return the captured frames of the test views by FFmpeg's fast conversion.

    Returns:
        View -> frame number -> frame (H, W, 3) uint8 RGB at the size at which the protocol
        measures; none for views that were not captured as video, or whose capture is gone.
    """
    if "truth_decoding" not in run.capture_record():
        return {}
    protocol = run.protocol()
    try:
        capture = fit_capture(recorded_capture(run), protocol)
    except GgvsError:
        return {}
    videos = [name for name in protocol.views.test if video_of(capture.source(name))]
    fast = [_decoded_fast(source) for source in capture.sources]
    capture = replace(capture, sources=tuple(fast))
    return {name: _Sequence(capture, name, protocol.measurement) for name in videos}


def _decoded_fast(source: Any) -> Any:
    """Return a chain of sources that ends with a video, decoded by the fast conversion."""
    if isinstance(source, VideoFrames):
        return replace(source, is_exact=False)
    inner = getattr(source, "source", None)
    return source if inner is None else replace(source, source=_decoded_fast(inner))
