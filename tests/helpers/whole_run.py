"""One run of every stage, with its report, figures and page: what tests of finished runs read, or
copy to change.
"""

import shutil
from dataclasses import replace
from pathlib import Path

from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.pipelines.run.evaluate import evaluate
from ggvs_eval.protocol import Frames, Synthesis, Views, load_protocol
from ggvs_eval.run_folder import RunFolder
from helpers.packed_films import unpack_film

LABELS = ("no-blending", "ours-geometric")
PER_IMAGE = ("PSNR", "SSIM", "L1", "PSNR_cc", "PSNR_static", "PSNR_disoccluded")
OVER_TIME = ("TCC", "STED", "SDT", "SDV", "Flicker")
ALONG_PATH = ("EPI_coherence", "EPI_slope_error", "reprojection", "switch_ratio")
# Metrics of every kind that need no network.
PROTOCOL = replace(
    load_protocol("demo"),
    views=Views(("cam00", "cam01"), "test"),
    frames=Frames(0, 3),
    synthesis=Synthesis(3),
    measurement=replace(
        load_protocol("demo").measurement, metrics=(*PER_IMAGE, *OVER_TIME, *ALONG_PATH)
    ),
)


def make_whole_run(folder: Path) -> Path:
    """Evaluate two methods on two views and three frames of a packed room, in this process.

    Args:
        folder: gets the capture as ``room`` and the run, which is returned, as ``run``.
    """
    capture = open_capture(unpack_film("path", folder / "room"))
    page = evaluate(folder / "run", capture, PROTOCOL, LABELS, workers=1)
    assert list((page.parent / "figures").glob("*.png")), (
        "made under the fixture no_figures; ask for whole_run alone"
    )
    return folder / "run"


def copy_of(run: Path, folder: Path) -> RunFolder:
    """A copy to change, in a new folder."""
    return RunFolder(Path(shutil.copytree(run, folder)))


def capture_of(run: Path) -> Capture:
    """The capture that a run of `make_whole_run` was made of."""
    return open_capture(run.with_name("room"))
