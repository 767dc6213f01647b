"""Repair of a capture as it is read: findings about timing and colour become corrections."""

from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path

from ggvs_eval.datasets.corrections import (
    Correction,
    corrections_file,
    describe_corrections,
    read_corrections,
    write_corrections,
)
from ggvs_eval.pipelines.inspection.capture import colour, timing
from ggvs_eval.pipelines.inspection.finding import RIG, Finding


def propose_corrections(findings: Iterable[Finding], present: Mapping[str, Correction]) -> dict[str, Correction]:
    """Corrections of the cameras that were found to be out of step by whole frames, or brighter or darker than the rig.

    Args:
        present: corrections under which they were found; what is found is added to them.

    Returns:
        All corrections, by camera; `present` where there is nothing to add.

    Reading:
        Half a frame and less cannot be mended by a shift. Gains below the threshold of the check are left alone: they are hardly
        measured better.
    """
    corrections = dict(present)
    for finding in findings:
        if finding.subject == RIG or finding.verdict not in ("warn", "bad"):
            continue
        before = corrections.get(finding.subject, Correction(finding.subject))
        if finding.question == timing.QUESTION and round(finding.values["offset_frames"]):
            total = before.offset_frames + round(finding.values["offset_frames"])
            corrections[finding.subject] = replace(before, offset_frames=total)
        elif finding.question == colour.GAIN:
            gain = tuple(round(old * new, 4) for old, new in zip(before.gain, finding.values["gain"], strict=True))
            corrections[finding.subject] = replace(before, gain=gain)
    return corrections


def repair_capture(path: Path, findings: Iterable[Finding]) -> str:
    """Write what was found into the capture's ``corrections.toml``.

    Returns:
        The file and what it says now; empty where there was nothing to add, and the file is as it was.
    """
    file = corrections_file(path)
    present = read_corrections(file)
    corrections = propose_corrections(findings, present)
    if corrections == present:
        return ""
    write_corrections(file, corrections)
    return f"{file}: {describe_corrections(corrections)}"
