"""The clouds of a fit, instant by instant, whichever fitter of this package has left them."""

from pathlib import Path

from ggvs_eval.baselines.fitted.per_instant import scene_file
from ggvs_eval.baselines.fitted.scene import SCENE, Backdrop, StoredScene
from ggvs_eval.baselines.fitted.stream import StreamedScene
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians import GaussianCloud
from ggvs_eval.run_folder import JOB_FILE


class FittedClouds:
    """Clouds of a fit of a run, ``RUN/fits/LABEL/FOLD``; the fold ``all`` has seen every camera.

    Attributes:
        instants: frame numbers.

    Raises:
        RenderError: no fit there, or one that is not finished.
    """

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._whole = StoredScene(folder / SCENE) if (folder / SCENE).is_file() else None
        numbers = sorted(
            int(file.stem) for file in folder.glob("*.safetensors") if file.stem.isdecimal()
        )
        self.instants = (
            list(range(self._whole.first, self._whole.last + 1)) if self._whole else numbers
        )
        self._streamed = StreamedScene(folder, "cpu")
        if not self.instants or not (folder / JOB_FILE).is_file():
            raise RenderError(
                f"{folder}: wanted a finished fit, RUN/fits/LABEL/FOLD; 'ggvs-eval run' continues "
                f"with it"
            )

    def cloud(self, index: int) -> GaussianCloud:
        """Return the Gaussians of an instant."""
        scene = self._whole or StoredScene(scene_file(self._folder, index))
        if scene.motion.kind != "transformation":
            return scene.cloud(index)
        # 3DGStream: what has moved, and what is new
        return Backdrop(self._streamed.moved(index)).cloud(scene.gaussians, 0.0)
