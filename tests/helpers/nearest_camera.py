"""The smallest method that is fitted: it keeps what the training cameras saw, and shows the image
of the nearest one.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.method import Rendering
from ggvs_eval.pipelines.methods import registry
from ggvs_eval.pipelines.methods.fitted import FittedMethod
from ggvs_eval.run_folder import read_json, write_json
from ggvs_eval.scene_fitter import FittedScene, Footage, Progress, SceneFitter

LABEL = "nearest-camera"


@dataclass(frozen=True)
class NearestCamera(SceneFitter):
    """One step per training camera.

    Attributes:
        noise: standard deviation of what each seed adds, of 255 levels.
        dies_after: steps after which an attempt dies; 0 for never.
    """

    noise: float = 1.0
    dies_after: int = 0
    name = "nearest camera"
    look_ahead = "none"

    def depth_indices(self, indices: range) -> list[int]:
        """It looks at depth once."""
        return [indices[0]]

    def fit(self, footage: Footage, folder: Path, progress: Progress) -> None:
        """Copy images; those that are there already were copied by an attempt that died."""
        generator, steps = np.random.default_rng(footage.seed), 0
        noise = generator.normal(
            0, self.noise, (footage.cameras[0].height, footage.cameras[0].width, 3)
        )
        for done, view in enumerate(footage.views, start=1):
            assert (
                footage.depth(view, footage.indices[0]).shape
                == footage.image(view, footage.indices[0]).shape[:2]
            )
            if (folder / view / "last").is_file():
                continue
            if self.dies_after and steps == self.dies_after:
                raise KeyboardInterrupt
            for index in footage.indices:
                image = np.clip(footage.image(view, index) + noise, 0, 255).astype(np.uint8)
                write_image(folder / view / f"{index}.png", image)
            (folder / view / "last").touch()
            steps += 1
            progress(done, len(footage.views))
        write_json(
            folder / "cameras.json", {camera.name: camera.to_json() for camera in footage.cameras}
        )

    def load(self, folder: Path) -> "NearestScene":
        """Read the cameras."""
        return NearestScene(
            folder, [Camera.from_json(*item) for item in read_json(folder / "cameras.json").items()]
        )


class NearestScene(FittedScene):
    """Images of cameras.

    Args:
        folder: of the images.
        cameras: that took them.
    """

    def __init__(self, folder: Path, cameras: list[Camera]) -> None:
        self.folder, self.cameras = folder, cameras

    def render(self, index: int, target: Camera) -> Rendering:
        """Show what the nearest camera saw."""
        nearest = min(
            self.cameras, key=lambda camera: float(np.linalg.norm(camera.centre - target.centre))
        )
        image = read_image(self.folder / nearest.name / f"{index}.png")
        return Rendering(image.astype(np.float32) / 255, seconds={"look up": 0.002})

    @property
    def size_bytes(self) -> int:
        """Of its images."""
        return sum(file.stat().st_size for file in self.folder.rglob("*.png"))


def register(patch, fitter: str = f"{__name__}:NearestCamera", label: str = LABEL) -> None:
    """Make a fitter a method for as long as the patch lasts."""
    spec = FittedMethod("Nearest Camera", "the nearest image", fitter)
    patch.setitem(registry.METHODS.shipped, label, spec)
