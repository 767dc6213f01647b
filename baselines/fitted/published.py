"""Scenes that the authors' program of 4DGS has fitted: their output folder, rendered by this
package's splat.
"""

from pathlib import Path

from ggvs_eval.baselines.fitted.hexplane import read_deformation
from ggvs_eval.baselines.fitted.scene import HexPlaneMotion, render_cloud
from ggvs_eval.camera import Camera
from ggvs_eval.compute_device import compute_device
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import GaussianCloud
from ggvs_eval.gaussians.ply import read_ply
from ggvs_eval.gaussians.settings import NO_SETTINGS, SplatSettings
from ggvs_eval.method import Rendering
from ggvs_eval.scene_fitter import FittedScene

CLOUD, FIELD = "point_cloud.ply", "deformation.pth"


class PublishedScene(FittedScene):
    """Canonical Gaussians and the deformation field of a folder that hustvl/4DGaussians has
    written.

    Args:
        folder: with ``point_cloud.ply`` and ``deformation.pth``, or with iterations of them below
            ``point_cloud``, of which the last one is taken.
        instants: frame numbers of the clip that it was fitted to; an attribute too.
        near: Gaussians at or before this depth are not rendered, world units.
        settings: of the training, where files next to it state any.

    Reading:
        The time of the i-th of n instants is i / n, as their loaders give it. Every Gaussian is
        moved; which ones are is a table next to the files that their program fills with yes.
    """

    def __init__(
        self,
        folder: Path,
        instants: range,
        near: float,
        device: str = "cpu",
        settings: SplatSettings = NO_SETTINGS,
    ) -> None:
        self._folder = _iteration(folder)
        self._motion = HexPlaneMotion(read_deformation(self._folder / FIELD)).to(
            compute_device(device)
        )
        values = read_ply(self._folder / CLOUD).to(compute_device(device)).parameters()
        sh = values.pop("sh")
        self._gaussians = {**values, "sh_base": sh[:, :1], "sh_rest": sh[:, 1:]}
        self.instants, self._near, self._device, self._settings = instants, near, device, settings

    def cloud(self, index: int) -> GaussianCloud:
        """Return the Gaussians of an instant."""
        if index not in self.instants:
            raise RenderError(
                f"{self._folder}: wanted instants {self.instants[0]}..{self.instants[-1]}, got "
                f"{index}"
            )
        return self._settings.apply(
            self._motion.cloud(self._gaussians, self.instants.index(index) / len(self.instants))
        )

    def render(self, index: int, target: Camera) -> Rendering:
        """Render one instant."""
        return render_cloud(
            lambda: self.cloud(index), target, self._near, self._device, self._settings.background
        )

    @property
    def size_bytes(self) -> int:
        """Bytes of both files."""
        return sum((self._folder / name).stat().st_size for name in (CLOUD, FIELD))


def _iteration(folder: Path) -> Path:
    """Return the folder of the two files: the given one, or its last iteration."""
    iterations = [
        path
        for path in folder.glob("point_cloud/iteration_*")
        if path.name.removeprefix("iteration_").isdigit()
    ]
    for place in (
        folder,
        *sorted(
            iterations, key=lambda path: int(path.name.removeprefix("iteration_")), reverse=True
        ),
    ):
        if (place / CLOUD).is_file() and (place / FIELD).is_file():
            return place
    raise RenderError(
        f"{folder}: wanted {CLOUD} and {FIELD}, there or below point_cloud/iteration_N; give an "
        f"output folder of 4DGS"
    )
