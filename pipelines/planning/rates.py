"""What a frame costs on this machine, as a trial has found it."""

from collections.abc import Mapping
from dataclasses import dataclass, field


@dataclass(frozen=True)
class Rates:
    """What a frame costs in one process of this machine; what is done once per process stands apart.

    Attributes:
        start_s: until a new process works.
        truth_s: decoding, resizing and writing a captured frame.
        depth_s: one depth map as it is found.
        check_s: holding one against the others of a view.
        mask_s: working out what no source camera sees.
        pose_depth_s: depth of one pose of a path.
        setup_s: label -> building the method and its first instant, beyond that of a usual one.
        step_s: label -> a usual instant.
        score_setup_s: as `setup_s`, of the metrics.
        score_s: an instant of all methods together.
        plain_score_s: an instant of one method without LPIPS, as ceilings and paths are measured.
        memory_bytes: the most that the process held.
        truth_bytes: a captured frame on disk.
        render_bytes: a synthesised frame on disk.
        took_s: the trial itself.
    """

    start_s: float = 0.0
    truth_s: float = 0.0
    depth_s: float = 0.0
    check_s: float = 0.0
    mask_s: float = 0.0
    pose_depth_s: float = 0.0
    setup_s: Mapping[str, float] = field(default_factory=dict)
    step_s: Mapping[str, float] = field(default_factory=dict)
    score_setup_s: float = 0.0
    score_s: float = 0.0
    plain_score_s: float = 0.0
    memory_bytes: float = 0.0
    truth_bytes: float = 0.0
    render_bytes: float = 0.0
    took_s: float = 0.0
