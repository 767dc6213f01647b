"""Lenses of a rig that was calibrated with one for all: cameras that would like another focal
length.
"""

from collections.abc import Mapping
from typing import Any

from ggvs_eval.capture import Capture
from ggvs_eval.errors import GgvsError
from ggvs_eval.finding import RIG, Finding
from ggvs_eval.pipelines.offline.calibration.calibrate import RECORD, OddLens, own_lens_option
from ggvs_eval.run_folder import read_json

QUESTION = "lens"


def check_lens(capture: Capture) -> tuple[Finding, ...]:
    """Report what `calibrate` found when it freed each camera of a rig with shared intrinsics.

    A lens that is wrong in one camera only is found by the epipolar error; where all were adjusted
    together, one other zoom bends the common lens and every pose until the errors are small.
    """
    record = _record(capture)
    options, odd = record.get("options", {}), record.get("odd_lenses")
    if (
        not options.get("shared_intrinsics")
        or options.get("known_poses")
        or options.get("known_intrinsics")
        or odd is None
    ):
        return (
            Finding(
                subject=RIG,
                question=QUESTION,
                verdict="ok",
                measured="no lens was shared by 'calibrate'",
            ),
        )
    own_lens = ", ".join(options.get("own_lens", ()))
    text = f"one for all cameras except {own_lens}" if own_lens else "one for all cameras"
    lenses = {
        name: OddLens(**values) for name, values in odd.items() if name in capture.camera_names
    }
    findings = [
        Finding(
            subject=name,
            question=QUESTION,
            verdict="bad",
            measured=lens.describe(),
            values=dict(odd[name]),
            advice=f"another zoom? calibrate again with {own_lens_option(odd)}",
        )
        for name, lens in lenses.items()
    ]
    shared = [
        Finding(subject=name, question=QUESTION, verdict="ok", measured=text)
        for name in capture.camera_names
        if name not in lenses
    ]
    tested = text if own_lens else f"{text}; {len(lenses)} disagree"
    return (
        Finding(
            subject=RIG,
            question=QUESTION,
            verdict="ok",
            measured=tested,
            values={"n_odd": len(lenses)},
        ),
        *findings,
        *shared,
    )


def _record(capture: Capture) -> Mapping[str, Any]:
    """Return what `calibrate` recorded of the capture.

    Empty if it was calibrated otherwise, or cannot be read.
    """
    file = capture.path / RECORD
    try:
        return dict(read_json(file)) if file.is_file() else {}
    except (GgvsError, TypeError, ValueError):
        return {}
