"""Known faults of scenes and cameras of public data sets."""

from dataclasses import dataclass
from functools import cache
from importlib import resources

from ggvs_eval.capture import Capture
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.toml_tables import build_table, parse_toml

FILE = "known_traps.toml"


@dataclass(frozen=True)
class KnownTrap:
    """One trap, as the file names it.

    Attributes:
        dataset: what people call the data set.
        reason: what is wrong, in words that follow the camera's or the scene's name.
        scenes: folders of the scenes that it concerns, whatever the case of their letters; any when empty.
        layout: name of the layout that it concerns; any when empty.
        camera: the camera that it concerns; the whole scene when empty.
        leave_out: the camera is no good as a source and left out unless it is asked for.
        more_frames_than: it concerns captures with more frames only.
    """

    dataset: str
    reason: str
    source: str
    scenes: tuple[str, ...] = ()
    layout: str = ""
    camera: str = ""
    leave_out: bool = False
    more_frames_than: int = 0

    def concerns(self, capture: Capture) -> bool:
        """Tell whether a capture is of the trap's scene and has its camera."""
        return (
            (not self.scenes or capture.scene.lower() in self.scenes)
            and self.layout in ("", capture.layout)
            and (not self.camera or self.camera in capture.camera_names)
            and capture.n_frames > self.more_frames_than
        )


@dataclass(frozen=True)
class TrapTable:
    """The file."""

    trap: tuple[KnownTrap, ...]


def apply_known_traps(capture: Capture, leave_out: bool = True) -> Capture:
    """Leave out cameras that are known to be faulty, and note the other known faults of a capture.

    Args:
        leave_out: leave cameras out; when False they are kept, and the note says what is wrong with them.
    """
    for trap in known_traps():
        if not trap.concerns(capture):
            continue
        reason = f"{trap.reason} ({trap.source})"
        if trap.leave_out and leave_out:
            capture = capture.without([trap.camera], reason)
        else:
            of = f"{trap.camera} of {capture.scene}" if trap.camera else capture.scene
            capture = capture.noted(f"known trap of {trap.dataset}, {of}{', kept' if trap.leave_out else ''}: {reason}")
    return capture


@cache
def known_traps() -> tuple[KnownTrap, ...]:
    """The traps that ship with the package.

    Examples:
        >>> [(trap.scenes, trap.camera) for trap in known_traps() if trap.leave_out]
        [(('coffee_martini',), 'cam13')]
    """
    text = (resources.files("ggvs_eval.datasets") / FILE).read_text(encoding="utf-8")
    return build_table(TrapTable, parse_toml(text, FILE, CaptureError), FILE, "", CaptureError).trap
