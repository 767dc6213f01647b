"""ColorVideoVDP, visible difference of two videos on a stated display, by its authors' package."""

import sys
from collections.abc import Iterable, Sequence
from functools import lru_cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import TYPE_CHECKING, Any

from ggvs_eval.arrays import Image8
from ggvs_eval.contrib.more_metrics.spooled_frames import SpooledFrames
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import check_pair, require_finite
from ggvs_eval.metrics.metric import (
    FURTHER,
    ColourMap,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)

if TYPE_CHECKING:
    import torch

DISPLAY = "standard_4k"
FRAMES_PER_SECOND = 30.0


def colour_video_vdp(
    pairs: Iterable[tuple[Image8, Image8]],
    device: str = "cpu",
    display: str = DISPLAY,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> float:
    """ColorVideoVDP of one view (Mantiuk et al. 2024).

    Args:
        pairs: rendered and captured frame of each instant, in order, (H, W, 3) uint8, sRGB; spooled
            to disk.

    Returns:
        Just-objectionable differences: 10 for equal videos, 1 less where 3 of 4 viewers prefer the
        captured one; higher is better.

    Example:
        >>> import numpy as np
        >>> truth = np.full((64, 64, 3), 100, np.uint8)
        >>> colour_video_vdp([(truth, truth)])  # doctest: +SKIP
        10.0

    Reading:
        The package's own display ``standard_4k``, 30 inches, 200 cd/m^2, 250 lux, seen from two
        heights, and 30 frames per second: pixels are as small as on that display, regardless of the
        size of the frames.
    """
    with SpooledFrames() as frames:
        for rendered, truth in pairs:
            check_pair(rendered, truth)
            frames.add(rendered, truth)
        return _quality(frames, device, display, frames_per_second)


def _quality(
    frames: SpooledFrames,
    device: str,
    display: str = DISPLAY,
    frames_per_second: float = FRAMES_PER_SECOND,
) -> float:
    import torch

    if not frames.count:
        raise MetricError("ColorVideoVDP: no frames to measure")
    package = load_package()
    metric = package.cvvdp(display_name=display, quiet=True, device=torch.device(device))
    rendered, truth = frames.videos()

    class Videos(package.video_source_dm):  # type: ignore[name-defined]
        """Both videos, read frame by frame."""

        def get_video_size(self) -> tuple[int, int, int]:
            return truth.shape[1], truth.shape[2], truth.shape[0]

        def get_batch_size(self) -> int:
            return 1

        def get_frames_per_second(self) -> float:
            return frames_per_second if frames.count > 1 else 0

        def get_test_frame(self, frame: int, device: Any, colorspace: str) -> "torch.Tensor":
            return self._shown(rendered[frame], device, colorspace)

        def get_reference_frame(self, frame: int, device: Any, colorspace: str) -> "torch.Tensor":
            return self._shown(truth[frame], device, colorspace)

        def _shown(self, image: Image8, device: Any, colorspace: str) -> "torch.Tensor":
            levels = torch.tensor(image).permute(2, 0, 1)[None, :, None].to(device).float() / 255
            displayed: torch.Tensor = self.apply_dm_and_color_transform(levels, colorspace)
            return displayed

    with torch.inference_mode():
        quality, _ = metric.predict_video_source(Videos(metric.display_photometry))
    return require_finite(float(quality), "ColorVideoVDP")


@lru_cache(maxsize=1)
def load_package() -> Any:
    """Return the metric's own module, without its package's imports for files, trained variants and
    progress bars.

    Of torchvision it uses one Gaussian blur. Where a package is absent, or was compiled for another
    torch, a substitute is used for it while the module is imported: the blur does the same, and
    what is never called is empty.

    Raises:
        MetricError: cvvdp is not installed, or is a version that this does not fit.
    """
    spec = find_spec("pycvvdp")
    if spec is None or spec.submodule_search_locations is None:
        raise MetricError("ColorVideoVDP needs cvvdp; `pip install 'ggvs-eval[cvvdp]'`")
    package = ModuleType("pycvvdp")  # its __init__ imports everything that it has
    package.__path__ = list(spec.submodule_search_locations)
    package.__spec__ = spec
    before = dict(sys.modules)
    sys.modules["pycvvdp"] = package
    substitutes = {name: module for name, module in _substitutes().items() if not _is_usable(name)}
    sys.modules.update(substitutes)
    try:
        return import_module("pycvvdp.cvvdp_metric")
    except Exception as error:  # another version of it can raise anything
        sys.modules.pop("pycvvdp", None)
        raise MetricError(
            f"ColorVideoVDP: cvvdp cannot be imported ({error}); `pip install 'ggvs-eval[cvvdp]'`"
        ) from error
    finally:
        for name in substitutes:
            sys.modules.pop(name, None)
            if name in before:
                sys.modules[name] = before[name]


def _is_usable(name: str) -> bool:
    try:
        import_module(name)
    except Exception:  # torchvision raises what it likes where torch is another one
        return False
    return True


def _substitutes() -> dict[str, ModuleType]:
    names = ("torchvision", "torchvision.transforms", "ffmpeg", "imageio", "imageio.v2", "tqdm")
    modules = {name: ModuleType(name) for name in names}
    vars(modules["torchvision.transforms"])["GaussianBlur"] = GaussianBlur
    vars(modules["tqdm"])["tqdm"] = lambda steps, **_: steps
    return modules


class GaussianBlur:
    """Gaussian blur of images (..., H, W), sampled at `taps` places, borders mirrored without the
    edge; as torchvision's.
    """

    def __init__(self, taps: int, sigma_px: float) -> None:
        self._taps = taps
        self._sigma_px = sigma_px

    def forward(self, images: "torch.Tensor") -> "torch.Tensor":
        """Return the blurred images, same shape."""
        import torch
        from torch.nn import functional

        reach = self._taps // 2
        offsets = torch.arange(-reach, reach + 1, dtype=images.dtype, device=images.device)
        weights = torch.exp(-0.5 * (offsets / self._sigma_px) ** 2)
        weights = weights / weights.sum()
        flat = functional.pad(
            images.reshape(-1, 1, *images.shape[-2:]), (reach, reach, reach, reach), mode="reflect"
        )
        window = torch.outer(weights, weights)[None, None]
        return functional.conv2d(flat, window).reshape(images.shape)


class ColourVideoVdpScorer:
    """ColorVideoVDP; one value for the view."""

    names = ("CVVDP",)

    def __init__(
        self, _names: Sequence[str], options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self._device = options.device
        self._frames = SpooledFrames()

    def add(self, _index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        load_package()  # before anything is written
        self._frames.add(rendered, truth.image)
        return []

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        with self._frames as frames:
            return [("CVVDP", None, _quality(frames, self._device))]


CVVDP = ViewMetric(
    name="CVVDP",
    kind="view",
    function=colour_video_vdp,
    unit="JOD",
    higher_is_better=True,
    group=FURTHER,
    decimals=3,
    describe=f"ColorVideoVDP on its display {DISPLAY} at {FRAMES_PER_SECOND:g} frames per second; "
    f"10 is no visible difference",
    reference="Mantiuk et al. 2024",
    scorer=ColourVideoVdpScorer,
    on_device=True,
)
