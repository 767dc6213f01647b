"""Calibration of a run: the given cameras, refined ones, or those of the two that render source
cameras better.

Test cameras take part in refinement, as in every public data set that COLMAP has calibrated, but
not in the choice.
"""

import sys
from collections.abc import Callable, Mapping
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Calibration, Capture
from ggvs_eval.depth_options import FREE_MATCHER, DepthRunOptions
from ggvs_eval.errors import GgvsError
from ggvs_eval.files.atomic import scratch_folder
from ggvs_eval.jobs.engine import Workers
from ggvs_eval.metrics.image.psnr import PSNR
from ggvs_eval.pipelines.offline.calibration import refine_capture
from ggvs_eval.pipelines.offline.calibration.refine_capture import (
    epipolar_residual,
    match_capture,
    refine_cameras,
)
from ggvs_eval.pipelines.run.evaluate import measure
from ggvs_eval.pipelines.run.run_plan import RunRequest, plan_run, visible_cameras
from ggvs_eval.pipelines.run.suggest_protocol import suggest_protocol
from ggvs_eval.protocol import CameraPath, Frames, Measurement, Protocol
from ggvs_eval.tasks.identity import code_of
from ggvs_eval.tasks.task import Task, digest_inputs, read_record

METHOD = "ours-geometric"  # by which calibrations are compared: weights without a network
LONGEST_SIDE_PX = 640  # of the pictures compared


def calibrate(request: RunRequest, protocol: Protocol) -> tuple[Capture, Callable[[Workers], Task]]:
    """Return the capture of a run with its calibrated cameras, the given ones until these are
    known, and the work of workers.
    """
    capture, choice = request.capture, protocol.synthesis.calibration
    inputs = {
        "calibration": choice,
        "cameras": {camera.name: camera.to_json() for camera in capture.cameras},
        "views": [protocol.views.test, protocol.views.sources, protocol.frames.start],
        "frames": {name: capture.digest(name) for name in capture.camera_names},
        "code": code_of(refine_capture.__name__),
    }
    folder = (request.shared or request.root) / "calibration" / digest_inputs(inputs)[:16]

    def task(workers: Workers) -> Task:
        make = partial(_calibrate, capture, protocol, workers)
        return Task(name=f"calibration, {choice}", folder=folder, inputs=inputs, make=make)

    if not task(1).is_done():
        return capture, task
    record = read_record(folder)
    refined = [
        replace(camera, K=K, world_to_camera=pose)
        # none where the given ones are used
        for camera, (K, pose) in zip(capture.cameras, record["cameras"], strict=False)
    ]
    calibration = Calibration(**record["calibration"])
    return replace(
        capture, cameras=tuple(refined) or capture.cameras, calibration=calibration
    ), task


def _calibrate(
    capture: Capture, protocol: Protocol, workers: Workers, folder: Path
) -> Mapping[str, Any]:
    """Return what is known of the cameras, for the record, and the refined ones where these are
    used.
    """
    calibration, cameras = choose_calibration(capture, protocol, workers, folder)
    print(f"{capture.path}: {calibration.describe()}", file=sys.stderr)
    poses = [(camera.K.tolist(), camera.world_to_camera.tolist()) for camera in cameras]
    return {"calibration": asdict(calibration), "cameras": poses}


def choose_calibration(
    capture: Capture, protocol: Protocol, workers: Workers, folder: Path
) -> tuple[Calibration, tuple[Camera, ...]]:
    """Return which cameras are used and why, and the refined ones where it is these.

    Args:
        folder: for the runs that are compared, which are removed.

    Raises:
        CaptureError: refined cameras are asked for, and cannot be found.
    """
    choice = protocol.synthesis.calibration
    pairs = match_capture(capture)
    calibration = Calibration(str(choice), "given", epipolar_residual(capture.cameras, pairs))
    if choice == "given" or (choice == "compare" and calibration.is_precise):
        return calibration, ()
    try:
        refined, n_points = refine_cameras(capture.path, capture.cameras, pairs)
        psnr_db = (
            _compare(capture, refined, protocol, workers, folder) if choice == "compare" else ()
        )
    except GgvsError as error:
        if choice == "refined":
            raise
        return replace(calibration, failure=str(error)), ()
    is_better = not psnr_db or psnr_db[1] > psnr_db[0]
    calibration = replace(
        calibration,
        cameras="refined" if is_better else "given",
        refined_px=epipolar_residual(refined, pairs),
        n_points=n_points,
        psnr_db=psnr_db,
    )
    return calibration, refined if is_better else ()


def _compare(
    capture: Capture,
    refined: tuple[Camera, ...],
    protocol: Protocol,
    workers: Workers,
    folder: Path,
) -> tuple[float, ...]:
    """Return the mean PSNR of source cameras with given and with refined cameras.

    Each is rendered small from the others by geometric weights, with the depth of its own cameras.
    """
    sources = visible_cameras(capture.without(protocol.views.test, "not asked"), protocol)
    rule = suggest_protocol(sources)
    size = np.array(sources.cameras[0].size)
    width, height = (size * min(1.0, LONGEST_SIDE_PX / size.max())).round().astype(int).tolist()
    small = replace(
        rule,
        views=replace(rule.views, test=rule.views.test[::2]),  # at most five
        frames=Frames(protocol.frames.start, 1),
        synthesis=replace(
            rule.synthesis, width=width, height=height, resize_filter="area", calibration=None
        ),
        measurement=Measurement((PSNR.name,), ceilings=False),
        path=CameraPath(0),
    )
    psnr_db = []
    by_name = {camera.name: camera for camera in refined}
    for cameras in (sources.cameras, tuple(by_name[name] for name in sources.camera_names)):
        with scratch_folder(folder / "compared") as root:
            request = RunRequest(
                root=root,
                capture=replace(sources, cameras=cameras),
                protocol=small,
                labels=(METHOD,),
                depth=DepthRunOptions(FREE_MATCHER),
            )
            psnr_db.append(float(measure(plan_run(request), workers).summary()[PSNR.name].iloc[0]))
    return tuple(psnr_db)
