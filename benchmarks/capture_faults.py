"""Faults of cameras planted in the videos of clean rigs against what `check` finds: smallest faults
found, false alarms.

``python -m benchmarks.capture_faults RIG [RIG ...] [--clean N] [--only FAULT ...]``
RIG is filmed by `ggvs-eval film`, so that its cameras are exact; their gains are divided out. Each
fault is planted in one camera of each rig, at each size; a fault counts as found where the right
question names that camera, and at the right time. Clean takes are parts of the rigs - other
cameras, other frames, new sensor noise, lamps that fade - of which every warning is false.
"""

import argparse
import json
import tempfile
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from ggvs_eval.arrays import Image8
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import write_video
from ggvs_eval.finding import RIG, Finding
from ggvs_eval.pipelines.inspection.capture.check import ExaminedRig, examine
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, record_camera
from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions, calibrate

Frames = list[Image8]
# Consequence of the cameras' places in a part of a rig.
PLACING = ("units", "poses", "overlap")
SPARE = 1  # frames at the end that a camera which loses one needs
LEAST_FRAMES, LEAST_CAMERAS = 16, 6


@dataclass(frozen=True)
class KeptFrames:
    """Frames in memory, a `FrameSource`."""

    kept: Sequence[Image8]
    digest: str = ""

    @property
    def n_frames(self) -> int:
        """Number of frames."""
        return len(self.kept)

    def frames(self, start: int, stop: int) -> Iterator[Image8]:
        """Yield the frames start <= t < stop."""
        yield from self.kept[start:stop]


@dataclass(frozen=True)
class Fault:
    """A fault of a camera.

    Attributes:
        question: that should find it.
        sizes: ascending.
        unit: of the sizes.
        plant: frames (SPARE more than are kept), size, frame at which it happens and random numbers
            -> spoilt frames.
        is_sudden: it happens at one frame, which the finding must name within two.
    """

    question: str
    sizes: tuple[float, ...]
    unit: str
    plant: Callable[[Frames, float, int, np.random.Generator], Frames]
    is_sudden: bool = True


def bump(frames: Frames, size_px: float, at: int, rng: np.random.Generator) -> Frames:
    """Return the picture is displaced from a frame on, in any direction."""
    angle = rng.uniform(0, 2 * np.pi)
    move = np.array([[1, 0, size_px * np.cos(angle)], [0, 1, size_px * np.sin(angle)]])
    return [*frames[:at], *(warp(frame, move) for frame in frames[at:])]


def turn(frames: Frames, size_deg: float, at: int, rng: np.random.Generator) -> Frames:
    """Return the picture is turned about its middle from a frame on."""
    height, width = frames[0].shape[:2]
    move = cv2.getRotationMatrix2D((width / 2, height / 2), size_deg * rng.choice([-1, 1]), 1.0)
    return [*frames[:at], *(warp(frame, move) for frame in frames[at:])]


def expose_longer(frames: Frames, share: float, at: int, rng: np.random.Generator) -> Frames:
    """Return the picture becomes brighter from the first frame to the last."""
    gains = np.linspace(1, 1 + share, len(frames) - SPARE)
    return [scale(frame, gain) for frame, gain in zip(frames, gains, strict=False)]


def redden(frames: Frames, share: float, at: int, rng: np.random.Generator) -> Frames:
    """Return the white balance changes at a frame: red by a share, blue the other way."""
    return [*frames[:at], *(scale(frame, [1 + share, 1, 1 - share]) for frame in frames[at:])]


def brighten(frames: Frames, share: float, at: int, rng: np.random.Generator) -> Frames:
    """Return the picture is brighter throughout."""
    return [scale(frame, 1 + share) for frame in frames]


def lose(frames: Frames, count: float, at: int, rng: np.random.Generator) -> Frames:
    """Return a frame is missing, and all later ones come early."""
    return frames[:at] + frames[at + int(count) :]


def double(frames: Frames, count: float, at: int, rng: np.random.Generator) -> Frames:
    """Return a frame comes twice, and all later ones come late; noise makes the second look new."""
    again = [
        np.clip(frames[at] + rng.normal(0, 1.5, frames[at].shape), 0, 255).astype(np.uint8)
    ] * int(count)
    return frames[: at + 1] + again + frames[at + 1 :]


def delay(frames: Frames, count: float, at: int, rng: np.random.Generator) -> Frames:
    """Return the camera starts late."""
    return frames[int(count) :]


FAULTS: Mapping[str, Fault] = {
    "bumped": Fault("stands still", (1.0, 1.5, 2.0, 3.0, 6.0), "px", bump),
    "turned": Fault("stands still", (0.3, 0.6, 1.2), "deg", turn),
    "exposure drifts": Fault(
        "colour over time", (0.03, 0.05, 0.07, 0.1, 0.2), "of 1", expose_longer, is_sudden=False
    ),
    "white balance jumps": Fault("colour over time", (0.03, 0.05, 0.1), "of 1", redden),
    "brighter": Fault("colour gain", (0.05, 0.07, 0.1, 0.15), "of 1", brighten, is_sudden=False),
    "frame lost": Fault("dropped frames", (1,), "frames", lose),
    "frame doubled": Fault("dropped frames", (1,), "frames", double),
    "late": Fault("time offset", (1,), "frames", delay, is_sudden=False),
}
ZOOM, ZOOMS = "zoomed, shared intrinsics", (1.02, 1.04, 1.08)


def warp(frame: Image8, move: np.ndarray) -> Image8:
    """Return the picture moved by an affine map."""
    return cv2.warpAffine(
        frame, move, frame.shape[1::-1], flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT
    )


def scale(frame: Image8, gain: object) -> Image8:
    """Return the picture's sRGB values multiplied."""
    return np.clip(np.rint(frame * np.asarray(gain)), 0, 255).astype(np.uint8)


def even_gains(capture: Capture) -> Capture:
    """Return the capture, in memory, with the gains that `demo.json` gives of its cameras divided
    out.
    """
    gains = json.loads((capture.path / DEMO_NOTES).read_text(encoding="utf-8"))["camera_gains"]
    frames = (
        [scale(frame, 1 / np.array(gain)) for frame in capture.frames(name)]
        for name, gain in zip(capture.camera_names, gains, strict=True)
    )
    return replace(capture, sources=tuple(map(KeptFrames, frames)))


class Take:
    """A clean rig in memory, of which single cameras can be spoilt."""

    def __init__(self, path: Path) -> None:
        self.capture = even_gains(open_capture(path))
        self.frames = {name: list(self.capture.frames(name)) for name in self.capture.camera_names}
        self.n_frames = self.capture.n_frames - SPARE
        self._records = {name: self.record(name, frames) for name, frames in self.frames.items()}

    def record(self, name: str, frames: Frames) -> CameraRecord:
        """Return the record of one camera with other frames."""
        return record_camera(self._shown({name: frames}), name)

    def check(self, spoilt: Mapping[str, CameraRecord]) -> tuple[Finding, ...]:
        """Findings with some cameras spoilt."""
        records = {**self._records, **spoilt}
        return examine(
            ExaminedRig(self._shown({}), [records[name] for name in self.capture.camera_names])
        )

    def _shown(self, other: Mapping[str, Frames]) -> Capture:
        sources = [
            KeptFrames((other.get(name) or self.frames[name])[: self.n_frames])
            for name in self.capture.camera_names
        ]
        return replace(self.capture, sources=tuple(sources), n_frames=self.n_frames)


def is_found(
    findings: Sequence[Finding], fault: Fault, camera: str, at: int
) -> tuple[bool, list[str]]:
    """Return whether the right question names the camera at the right time, and other warnings."""
    minded = [
        finding
        for finding in findings
        if finding.verdict in ("warn", "bad") and finding.question not in PLACING
    ]
    own = [
        finding
        for finding in minded
        if finding.subject == camera and finding.question == fault.question
    ]
    others = [
        f"{finding.subject} {finding.question}"
        for finding in minded
        if finding.subject not in (camera, RIG)
    ]
    if not own or not fault.is_sudden:
        return bool(own), others
    times = own[0].values.get("steps") or [own[0].values]
    return any(each["first_frame"] - 2 <= at <= each["last_frame"] + 2 for each in times), others


def smallest_faults(rigs: Sequence[Path], only: Sequence[str]) -> None:
    """Print how often each fault is found at each size."""
    takes = [Take(path) for path in rigs]
    for name, fault in FAULTS.items():
        if only and name not in only:
            continue
        for size in fault.sizes:
            found, accused = 0, []
            for number, take in enumerate(takes):
                rng = np.random.default_rng([number, 7])
                camera = take.capture.camera_names[int(rng.integers(len(take.frames)))]
                at = int(rng.integers(take.n_frames // 3, 2 * take.n_frames // 3))
                spoilt = take.record(camera, fault.plant(take.frames[camera], size, at, rng))
                ok, others = is_found(take.check({camera: spoilt}), fault, camera, at)
                found += ok
                accused += others
                if not ok:
                    print(f"    missed: {rigs[number].name} {camera} at {at}", flush=True)
            print(
                f"| {name} | {size:g} {fault.unit} | {found} of {len(takes)} | "
                f"{', '.join(accused) or '-'} |",
                flush=True,
            )


def zoomed_rigs(rigs: Sequence[Path]) -> None:
    """Print how often a camera that is zoomed is named by a calibration that takes all lenses for
    one.
    """
    for zoom in (1.0, *ZOOMS):
        found, n_calibrated, accused = 0, 0, []
        for number, path in enumerate(rigs):
            capture = even_gains(open_capture(path))
            rng = np.random.default_rng([number, 9])
            camera = capture.camera_names[int(rng.integers(len(capture.cameras)))]
            with tempfile.TemporaryDirectory() as folder:
                for name in capture.camera_names:
                    frame = capture.frame(name, 0)
                    height, width = frame.shape[:2]
                    move = cv2.getRotationMatrix2D(((width - 1) / 2, (height - 1) / 2), 0, zoom)
                    write_video(
                        Path(folder) / "table" / f"{name}.mp4",
                        [warp(frame, move) if name == camera else frame],
                        30.0,
                    )
                options = CalibrationOptions(shared_intrinsics=True, camera_model="SIMPLE_RADIAL")
                try:
                    odd = calibrate(
                        Path(folder) / "table", Path(folder) / "rig", options
                    ).odd_lenses
                except CaptureError:
                    continue  # a rig whose cameras are too far apart for features
            n_calibrated += 1
            found += camera in odd and zoom != 1
            accused += [
                f"{name} x {lens.factor:.3f}"
                for name, lens in odd.items()
                if name != camera or zoom == 1
            ]
        print(
            f"| {ZOOM} | x {zoom:g} | {found} of {n_calibrated} | {', '.join(accused) or '-'} |",
            flush=True,
        )


def false_alarms(rigs: Sequence[Path], count: int) -> None:
    """Print what is warned of in clean takes."""
    alarms, clean = 0, [even_gains(open_capture(path)) for path in rigs]
    for number in range(count):
        rng = np.random.default_rng([number, 11])
        capture = clean[number % len(rigs)]
        n_cameras = int(rng.integers(LEAST_CAMERAS, len(capture.cameras) + 1))
        chosen = sorted(rng.choice(len(capture.cameras), n_cameras, replace=False))
        n_frames = int(rng.integers(LEAST_FRAMES, capture.n_frames + 1))
        start, sigma = int(rng.integers(capture.n_frames - n_frames + 1)), rng.uniform(0, 3)
        lamps = np.linspace(1, rng.uniform(0.6, 1.0), n_frames)[:: rng.choice([-1, 1])]
        sources = []
        for index in chosen:
            frames = capture.frames(capture.camera_names[index], start, start + n_frames)
            noisy = [
                scale(frame + rng.normal(0, sigma, frame.shape), lamp)
                for frame, lamp in zip(frames, lamps, strict=True)
            ]
            sources.append(KeptFrames(noisy))
        cameras = tuple(capture.cameras[index] for index in chosen)
        take = replace(
            capture, cameras=cameras, sources=tuple(sources), n_frames=n_frames, extras=()
        )
        findings = examine(
            ExaminedRig(take, [record_camera(take, name) for name in take.camera_names])
        )
        false = [
            each
            for each in findings
            if each.verdict in ("warn", "bad") and each.question not in PLACING
        ]
        alarms += bool(false)
        for each in false:
            print(
                f"    {capture.path.name}: {each.subject} {each.question} {each.verdict}: "
                f"{each.measured}",
                flush=True,
            )
    print(f"| clean takes with any warning | {alarms} of {count} |", flush=True)


def main(words: Sequence[str] | None = None) -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("rigs", nargs="+", type=Path)
    parser.add_argument("--clean", type=int, default=0, help="clean takes")
    parser.add_argument("--only", nargs="*", default=(), help="faults; all by default")
    options = parser.parse_args(words)
    if options.clean:
        false_alarms(options.rigs, options.clean)
    if not options.only or set(options.only) & set(FAULTS):
        smallest_faults(options.rigs, options.only)
    if not options.only or ZOOM in options.only:
        zoomed_rigs(options.rigs)


if __name__ == "__main__":
    main()
