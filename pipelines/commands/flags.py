"""Flags that several verbs of the command line share: what they read, what they render, where their
jobs run.
"""

import sys
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated, Any, Literal

import tyro

from ggvs_eval.capture import Capture, CaptureEdit, GivenDepth
from ggvs_eval.capture_edit import perturb_capture
from ggvs_eval.datasets import DATASETS, DEPTH_FILES, open_capture
from ggvs_eval.datasets.units import GivenUnits
from ggvs_eval.depth_options import LIVE_MATCHER, DepthRunOptions
from ggvs_eval.errors import CaptureError, CommandError
from ggvs_eval.jobs.engine import Engine
from ggvs_eval.kernels import usable_cpus
from ggvs_eval.pipelines.methods.registry import METHODS, usual_methods
from ggvs_eval.protocol import CalibrationChoice

NONE = "(none by default)"


def _at_least_one(words: list[str]) -> int:
    jobs = int(words[0])
    if jobs < 1:
        raise CommandError(f"--jobs {jobs}: wanted at least 1")
    return jobs


_COUNT = tyro.constructors.PrimitiveConstructorSpec(
    nargs=1,
    metavar="INT",
    instance_from_str=_at_least_one,
    is_instance=lambda value: isinstance(value, int),
    str_from_instance=lambda value: [str(value)],
)
Jobs = Annotated[int, _COUNT]
ONE_PER_CORE = usable_cpus()
Run = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="RUN")]
CaptureFolder = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="CAPTURE")]
Output = Annotated[Path, tyro.conf.Positional, tyro.conf.arg(metavar="OUT")]
Layout = Annotated[str | None, tyro.conf.arg(metavar=f"{{{','.join(DATASETS)}}}")]
Label = Annotated[str, tyro.conf.arg(metavar=f"{{{','.join(METHODS)}}}")]
Labels = Annotated[tuple[str, ...], tyro.conf.arg(metavar=f"{{{','.join(METHODS)},splats:PATH}}")]
USUAL_METHODS = usual_methods()
Weights = Annotated[
    tuple[str, ...], tyro.conf.arg(metavar="METHOD=FILE ...", help_behavior_hint=NONE)
]
Device = Annotated[str, tyro.conf.arg(metavar="{cpu,cuda,auto}")]
Poses = Annotated[CalibrationChoice | None, tyro.conf.arg(name="calibration")]
NoiseLevel = Annotated[float, tyro.conf.arg(aliases=["--sensor-noise"])]


@dataclass(frozen=True)
class CaptureOptions:
    """Options by which a capture is read and shown.

    Attributes:
        layout: layout on disk; detected by default.
        units: world units per metre, or a TOML file with a known distance (docs/captures.md).
        keep_unsynced: keep cameras that are out of step (cam13 of coffee_martini).
        hold_frames: number of instants for which one instant is repeated; 0: none.
        hold_frame: the repeated instant, from 0.
        sensor_noise_255: standard deviation of noise added to all frames, reference included,
            0..255.
        noise_seed: seed of the added noise.
        depth: folder of another program's depth, CAM/FRAME.EXT or CAM.EXT (npy, npz, png, exr, pfm,
            bin).
        depth_scale: world units per unit of those files; 0 fits one factor to matched points.
        depth_is: z of each pixel, or length of its ray.
    """

    layout: Layout = None
    units: str | None = None
    keep_unsynced: bool = False
    hold_frames: int = CaptureEdit.hold_frames
    hold_frame: int = CaptureEdit.hold_frame
    sensor_noise_255: NoiseLevel = CaptureEdit.sensor_noise_255
    noise_seed: int = CaptureEdit.noise_seed
    depth: Path | None = None
    depth_scale: float = 0.0
    depth_is: Literal["z", "distance"] = "z"

    def open(self, path: Path) -> Capture:
        """Open a capture and report which cameras and frames were dropped or modified."""
        capture = open_capture(
            path, self.layout, units=given_units(self.units), drop_unsynced=not self.keep_unsynced
        )
        edit = CaptureEdit(
            hold_frames=self.hold_frames,
            hold_frame=self.hold_frame,
            sensor_noise_255=self.sensor_noise_255,
            noise_seed=self.noise_seed,
        )
        capture = perturb_capture(capture, edit)
        if self.depth is not None:
            capture = DEPTH_FILES["maps"](
                capture, GivenDepth(str(self.depth), self.depth_scale, self.depth_is == "distance")
            )
        for note in capture.notes:
            print(f"{path}: {note}", file=sys.stderr)
        return capture


def given_units(words: str | None) -> GivenUnits:
    """Return the number or the file that ``--units`` gives."""
    if words is None or words.endswith(".toml"):
        return None if words is None else Path(words)
    try:
        return float(words)
    except ValueError as error:
        raise CaptureError(f"--units: wanted a number or a .toml file, got {words!r}") from error


CaptureFlags = tyro.conf.OmitArgPrefixes[CaptureOptions]
CAPTURE_DEFAULTS = CaptureOptions()
DepthFlags = tyro.conf.OmitArgPrefixes[DepthRunOptions]
DEPTH_DEFAULTS = DepthRunOptions()
LIVE_DEPTH = DepthRunOptions(LIVE_MATCHER)  # what play and view wait for
Running = tyro.conf.OmitArgPrefixes[Engine]
HERE = Engine()


def changed_flags(options: Any, default: Any) -> list[str]:
    """A frozen dataclass of options as words of the command line.

    Only what differs from its defaults.

    Args:
        options: values that are truth values, numbers, texts, paths, tuples of texts, or None.
    """
    words: list[str] = []
    for field in fields(options):
        value, usual = getattr(options, field.name), getattr(default, field.name)
        name = field.name.replace("_", "-")
        if value == usual:
            continue
        if isinstance(usual, bool):
            words.append("--" + ("" if value else "no-") + name)
        else:
            words += [f"--{name}", *(value if isinstance(usual, tuple) else [str(value)])]
    return words
