"""Owner of a run folder: the protocol and the capture that it was made for, and refusal of any
other.
"""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.frames import coding_of, video_of
from ggvs_eval.errors import ProtocolError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.files.video import EXACT_DECODING
from ggvs_eval.protocol import Protocol, name_differences
from ggvs_eval.run_folder import RunFolder, write_json


def require_owner(run: RunFolder, protocol: Protocol, capture: Capture) -> None:
    """Refuse a folder that holds a run of another protocol or of other frames.

    Args:
        run: the folder; one that holds no run is free.
    """
    require_protocol(run, protocol)
    if not run.protocol_file.is_file():
        return
    before, digests = run.capture_record()["digests"], _digests(capture)
    if before.keys() != digests.keys():
        _refuse(
            run,
            f"other cameras: {', '.join(sorted(before.keys() ^ digests.keys()))} on one side only",
        )
    changed = [name for name in before if before[name] != digests[name]]
    if changed:
        _refuse(
            run, f"other frames: those of {', '.join(changed)} differ from those of {capture.path}"
        )


def require_protocol(run: RunFolder, protocol: Protocol) -> None:
    """Refuse a folder that holds a run of another protocol."""
    if run.protocol_file.is_file() and not (protocol_there := run.protocol()).agrees_with(protocol):
        _refuse(
            run,
            "another protocol (there and here: "
            f"{name_differences(protocol_there.values(), protocol.values())})",
        )


def claim_folder(run: RunFolder, protocol: Protocol, capture: Capture) -> None:
    """Write protocol and capture into a folder that holds no run yet, or make sure that they are
    this run's.
    """
    require_owner(run, protocol, capture)
    if run.protocol_file.is_file() and not protocol.views.folds:
        protocol = run.protocol()  # folds that were stated once stay
    run.root.mkdir(parents=True, exist_ok=True)
    codings = {
        view: coding_of(capture.source(view), protocol.frames.numbers)
        for view in protocol.views.test
    }
    coding = {view: video_coding and asdict(video_coding) for view, video_coding in codings.items()}
    are_videos = any(video_of(capture.source(view)) for view in protocol.views.test)
    decoding = {"truth_decoding": EXACT_DECODING} if are_videos else {}
    write_json(
        run.root / "capture.json",
        _capture_record(capture, run.root) | {"coding": coding, **decoding},
    )
    write_text(run.protocol_file, protocol.to_toml())


def _refuse(run: RunFolder, difference: str) -> None:
    raise ProtocolError(
        f"{run.root}: holds a run of {difference}; choose a new folder (score: --run FOLDER)"
    )


def _digests(capture: Capture) -> dict[str, str]:
    return {name: capture.digest(name) for name in capture.camera_names}


def _capture_record(capture: Capture, root: Path) -> dict[str, Any]:
    """Describe a capture for its run folder: its path as given, absolute, and relative to
    the run.
    """
    place = capture.path.resolve()
    return {
        "path": str(capture.path),
        "place": {"absolute": str(place), "from_run": os.path.relpath(place, root.resolve())},
        "scene": capture.scene,
        "layout": capture.layout,
        "fps": capture.fps,
        "n_frames": capture.n_frames,
        "units_per_metre": capture.units_per_metre,
        "units_origin": capture.units_origin,
        "notes": list(capture.notes),
        "edit": capture.edit and asdict(capture.edit),
        **({"given_depth": asdict(capture.given_depth)} if capture.given_depth else {}),
        **({"calibration": asdict(capture.calibration)} if capture.calibration else {}),
        "cameras": {camera.name: camera.to_json() for camera in capture.cameras},
        "digests": _digests(capture),
    }
