"""Sequences of Gaussians on disk, wherever they come from: others' files, or a fit of a run."""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Protocol

from ggvs_eval.errors import RenderError
from ggvs_eval.pipelines.methods.splats import DEFORMATION, open_splats, splats_files

if TYPE_CHECKING:  # the command line starts without torch
    from ggvs_eval.gaussians import GaussianCloud


class CloudSequence(Protocol):
    """Clouds of Gaussians by instants.

    Attributes:
        instants: frame numbers, ascending.
    """

    @property
    def instants(self) -> Sequence[int]: ...  # noqa: D102

    def cloud(self, index: int) -> "GaussianCloud": ...  # noqa: D102


def open_sequence(path: Path, n_frames: int | None) -> CloudSequence:
    """Open a sequence; nothing but one instant of it is in memory at a time.

    Args:
        path: see `splats_files`; or the folder of a fit, ``RUN/fits/LABEL/FOLD``.
        n_frames: of the capture, by which Gaussians of 4DGS's authors move; None if it is not
            known.

    Raises:
        RenderError: nothing there that is known, a fit that is not finished, or files of 4DGS
            without the length of their clip.
    """
    if path.is_dir() and any(path.glob("*.safetensors")):
        from ggvs_eval.baselines.fitted.clouds import FittedClouds

        return FittedClouds(path)
    if n_frames is None and splats_files(path)[-1].name == DEFORMATION:
        raise RenderError(
            f"{path}: wanted --capture with 4DGS output, whose motion depends on the clip's "
            f"length, got none; add it"
        )
    return open_splats(path, range(n_frames or 1))
