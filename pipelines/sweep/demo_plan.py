"""Plans of the demo rooms: as they are rendered, or before that, of cameras without frames."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import CaptureError
from ggvs_eval.synthetic.film.options import DemoOptions
from ggvs_eval.synthetic.film.rig import in_metres
from ggvs_eval.synthetic.film.shots import rig_shots
from ggvs_eval.synthetic.layouts.enerf import easymocap_name
from ggvs_eval.synthetic.layouts.layouts import LAYOUTS

NEAR, FAR = 8.0, 40.0  # of the rooms, world units


@dataclass(frozen=True)
class FramesToRender:
    """Frames that a camera of the demo is going to show; there is nothing to decode.

    Attributes:
        digest: tells the cameras apart, as content would.
    """

    n_frames: int
    digest: str

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Refuse.

        Raises:
            CaptureError: always.
        """
        raise CaptureError(f"wanted frames {start}..{stop - 1} of {self.digest}, the demo is not rendered; leave --dry-run out")


def demo_to_plan(folder: Path, options: DemoOptions, open_demo: Callable[[Path], Capture]) -> Capture:
    """The demo in a folder where it is rendered already, else what it is going to be; nothing is written."""
    return open_demo(folder) if (folder / DEMO_NOTES).is_file() else planned_demo(folder, options)


def planned_demo(folder: Path, options: DemoOptions) -> Capture:
    """The demo capture without its frames: cameras, frame count and units are those of the rendered one.

    Reading:
        A rendered demo may carry a camera path of its own; a plan takes the path that a capture without one is given, which
        has as many poses.
    """
    cameras = tuple(_noted(options, shot.noted) for shot in rig_shots(options))
    sources = tuple(FramesToRender(options.n_frames, camera.name) for camera in cameras)
    units = LAYOUTS[options.layout].units_per_metre
    name = folder.resolve().name
    return Capture(name, options.layout, folder, cameras, sources, options.n_frames, options.fps, units, DEMO_NOTES)


def _noted(options: DemoOptions, camera: Camera) -> Camera:
    """A camera as the layout names it, in its units, with the depths that rooms have about, as it is not measured yet."""
    camera = replace(camera, near=NEAR, far=FAR)
    return replace(in_metres(camera), name=easymocap_name(camera)) if options.layout == "enerf-outdoor" else camera


def is_rendered(capture: Capture) -> bool:
    """Tell whether a capture has frames that can be read."""
    return not any(isinstance(source, FramesToRender) for source in capture.sources)


def renders_first(captures: Iterable[Capture]) -> list[str]:
    """A line for each capture whose own frames have to be rendered first."""
    lines = []
    for capture in {capture.path: capture for capture in captures if not is_rendered(capture)}.values():
        width, height = capture.cameras[0].size
        what = f"{len(capture.cameras)} cameras x {capture.n_frames} frames at {width} x {height}"
        lines.append(f"demo: is rendered first, {what}, into {capture.path}")
    return lines
