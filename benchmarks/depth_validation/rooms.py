"""The rendered rooms with exact depth: three for validation, by which parameters may be chosen, and
the demo capture.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.demo import write_demo
from ggvs_eval.contrib.worlds.domains import VALIDATION_SEEDS
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.datasets import open_capture

FRAMES = 8  # of every room; no evaluate looks at more
DEMO = "demo"


@dataclass(frozen=True, eq=False)
class RenderedRoom:
    """A room on disk and what it was made by.

    Attributes:
        name: for people.
        options: of its demo capture.
        capture: as any method sees it, noise, gains and video coding included.
    """

    name: str
    options: DemoOptions
    capture: Capture

    @property
    def evaluated_cameras(self) -> Sequence[Camera]:
        """Every sixth camera: both rows, their middle and their ends."""
        return self.capture.cameras[::6]


def film_rooms(out: Path, seeds: Sequence[int] = VALIDATION_SEEDS) -> list[RenderedRoom]:
    """Write the rooms that are not there yet, and open all of them.

    Args:
        out: folder of the rooms; the demo room is with them, since the one that ships and `make
            reports` unpacks has no depth.
        seeds: of the validation rooms.
    """
    plans = {f"room {seed}": (out / "rooms" / f"seed{seed}", room_options(seed)) for seed in seeds}
    plans[DEMO] = (out / "rooms" / DEMO, DemoOptions())
    return [
        RenderedRoom(name, options, open_capture(write_demo(folder, options)))
        for name, (folder, options) in plans.items()
    ]


def room_options(seed: int) -> DemoOptions:
    """Return the demo's options for a validation room: few frames, no camera path."""
    return DemoOptions(seed=seed, n_frames=FRAMES, path_poses=0)
