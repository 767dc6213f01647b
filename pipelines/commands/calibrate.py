"""The verbs of the command line that find cameras and straighten lenses: calibrate and
undistort.
"""

import sys
from pathlib import Path
from typing import Annotated

import tyro

from ggvs_eval.pipelines.commands.flags import Output
from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions
from ggvs_eval.pipelines.offline.calibration.undistort import UndistortOptions

Frames = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="FRAMES")]
Calibrating = tyro.conf.OmitArgPrefixes[CalibrationOptions]


def calibrate(frames: Frames, out: Output, calibration: Calibrating = CalibrationOptions()) -> None:  # noqa: B008 - frozen
    """Calibrate a fixed rig from one instant with COLMAP.

    Args:
        frames: videos, folders of images, or one image per camera.
        out: capture to write, absent or empty.
        calibration: known and assumed parameters.
    """
    from ggvs_eval.pipelines.offline.calibration.calibrate import calibrate as find_cameras
    from ggvs_eval.pipelines.offline.calibration.calibrate import own_lens_option

    rig = find_cameras(frames, out, calibration)
    for name, reason in rig.missing.items():
        print(f"{name} left out: {reason}", file=sys.stderr)
    for name, lens in rig.odd_lenses.items():
        print(
            f"{name} {lens.describe()}: another zoom? calibrate again with "
            f"{own_lens_option(rig.odd_lenses)}",
            file=sys.stderr,
        )
    error = (
        f"mean reprojection error {rig.mean_reprojection_error_px:.3f} px over {rig.n_points} "
        f"points"
    )
    print(f"{rig.path}: {len(rig.cameras)} cameras, {error}")


def undistort(
    source: Frames,
    out: Output,
    lenses: Path | None = None,
    output: tyro.conf.OmitArgPrefixes[UndistortOptions] = UndistortOptions(),  # noqa: B008 - frozen
) -> None:
    """Convert videos of known lenses to pinhole videos.

    Writes the new intrinsics next to them, for `calibrate`.

    Args:
        source: folder of raw videos, with --lenses; or a capture whose layout includes lenses.
        out: folder to write, absent or empty.
        lenses: lens file of EasyMocap, D3DMV, Qualisys, OpenCV, anipose or freemocap
            (docs/captures.md).
        output: output format.
    """
    from ggvs_eval.pipelines.offline.calibration.undistort import undistort_videos

    videos = undistort_videos(source, lenses, out, output)
    print(f"{videos.path}: {len(videos.cameras)} cameras of {videos.n_frames} frames")
