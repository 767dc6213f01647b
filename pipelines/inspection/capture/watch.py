"""Health of a rig while it films: folders of images or videos that grow, checked anew every few
seconds.

The checks of `check` are applied to the frames so far: is each camera static, is it in step, has it
lost or frozen frames, does its colour drift. What needs poses is answered where the folder has
them.
"""

import json
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, replace
from html import escape
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture
from ggvs_eval.datasets import open_capture
from ggvs_eval.datasets.camera_frames import CameraFrames, find_rig_frames
from ggvs_eval.errors import CaptureError, GgvsError
from ggvs_eval.files.atomic import atomic_file
from ggvs_eval.finding import SEVERITY, Finding
from ggvs_eval.geometry.epipolar import MatchedPair, neighbour_pairs
from ggvs_eval.pipelines.inspection.capture import colour, colour_drift, frames, stillness, timing
from ggvs_eval.pipelines.inspection.capture.check import LAYOUT, placeholder_camera
from ggvs_eval.pipelines.inspection.capture.pairs import match_pairs
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, Recorder

# What can go wrong while cameras film; poses, lenses and overlap do not change by themselves.
WATCHED = (
    frames.FRAMES,
    frames.FROZEN,
    stillness.QUESTION,
    timing.QUESTION,
    timing.DROPPED,
    colour.DRIFT,
)
# A light changes after so many rounds that agree, so that one bad frame turns none.
ROUNDS = 2
PAGE_HEAD = """<!doctype html><meta charset="utf-8">
<meta http-equiv="refresh" content="{seconds:g}"><title>{title}</title><style>
body{{font:16px system-ui;margin:2rem;background:Canvas;color:CanvasText;color-scheme:light dark}}
td{{padding:.3rem 1rem .3rem 0}}
.ok b{{color:#2a8a3a}}.warn b{{color:#c77700}}.bad b{{color:#d02020}}.unknown b{{color:#808080}}
</style>
"""


@dataclass(frozen=True)
class Light:
    """State of one camera.

    Attributes:
        verdict: ok, warn, bad, or unknown while too little is there.
        reason: the worst finding in words; empty if all is well.
        time: of the round in which it came to this, seconds since 1970.
        n_frames: read so far.
    """

    camera: str
    verdict: str
    reason: str
    time: float
    n_frames: int

    def line(self) -> str:
        """Return one line for people."""
        reason = f", {self.reason}" if self.reason else ""
        return (
            f"{self.camera}: {self.verdict}{reason} (since "
            f"{time.strftime('%H:%M:%S', time.localtime(self.time))})"
        )


class Watch:
    """Reads what a rig has filmed so far, round after round.

    Args:
        path: folder that videos or folders of images are written to. Videos must be readable while
            they grow, as fragmented MP4, MPEG-TS and Matroska are; the last frame of each camera,
            which may be unfinished, waits for the next round.
        rig: capture of the same cameras with poses, by name; without it time offsets and colours
            are unknown.
    """

    def __init__(self, path: Path, rig: Path | None = None) -> None:
        self.path = path
        self._posed = {camera.name: camera for camera in open_capture(rig).cameras} if rig else {}
        self._recorders: dict[str, Recorder] = {}
        self._read: dict[str, int] = {}
        self._sizes: dict[str, tuple[int, int]] = {}
        self._pairs: tuple[MatchedPair, ...] | None = None
        self._lights: dict[str, Light] = {}
        self._agreed: dict[str, tuple[str, int]] = {}

    def look(self, time_s: float) -> list[Light]:
        """Read the frames that came since the last round; gives the state of each camera.

        Args:
            time_s: seconds since 1970.

        Raises:
            CaptureError: no frames of two cameras are there yet, or a camera is not one of the rig.
        """
        files = find_rig_frames(self.path)
        if strange := [name for name in files if self._posed and name not in self._posed]:
            raise CaptureError(
                f"{self.path}: wanted cameras of the rig, got {', '.join(strange)}; there are "
                f"{', '.join(self._posed)}"
            )
        stuck = {
            name: message
            for name, file in files.items()
            if (message := self._add_frames(name, file))
        }
        n_frames = max(self._read.values())
        records = {name: self._recorders[name].record(n_frames) for name in files}
        readable = {name: file for name, file in files.items() if name in self._sizes}
        findings = self._ask(readable, [records[name] for name in readable]) if readable else []
        findings += [
            Finding(subject=name, question=frames.FRAMES, verdict="bad", measured=why)
            for name, why in stuck.items()
        ]
        return [self._turn(name, findings, time_s, record) for name, record in records.items()]

    def _add_frames(self, name: str, file: CameraFrames) -> str:
        """Add a camera's new frames.

        Gives the reason where one cannot be read, which is tried again.
        """
        recorder, begin = (
            self._recorders.setdefault(name, Recorder(name)),
            self._read.setdefault(name, 0),
        )
        try:
            for image in file.frames(begin, max(file.n_frames - 1, begin)):
                self._sizes[name] = (image.shape[1], image.shape[0])
                recorder.add(self._read[name], image)
                self._read[name] += 1
        except GgvsError as error:
            return str(error)
        return ""

    def _ask(self, files: Mapping[str, CameraFrames], records: list[CameraRecord]) -> list[Finding]:
        cameras = [self._camera(name) for name in files]
        fps = next((fps for file in files.values() if (fps := getattr(file, "fps", 0.0))), 0.0)
        capture = Capture(
            scene=self.path.name,
            layout=LAYOUT,
            path=self.path,
            cameras=tuple(cameras),
            sources=tuple(files.values()),
            n_frames=len(records[0].change),
            fps=fps,
            units_per_metre=1,
            units_origin=LAYOUT,
        )
        findings = [
            *frames.check_frames(capture, records),
            *frames.check_frozen(records, capture.fps),
        ]
        findings += stillness.check_stillness(cameras, records, fps)
        if self._posed and all(record.instants for record in records):
            if self._pairs is None:
                features = [record.instants[0] for record in records]
                self._pairs = tuple(match_pairs(cameras, features, neighbour_pairs(cameras)))
            findings += timing.check_timing(cameras, records, (), fps)
            findings += colour_drift.check_drift(capture.camera_names, records, self._pairs, fps)
        return findings

    def _camera(self, name: str) -> Camera:
        size = self._sizes[name]
        return self._posed[name].resized(*size) if self._posed else placeholder_camera(name, *size)

    def _turn(
        self, name: str, findings: Iterable[Finding], time_s: float, record: CameraRecord
    ) -> Light:
        """Return the light of a camera, which changes once two rounds in a row agree on its
        verdict.
        """
        answers = [
            finding
            for finding in findings
            if finding.subject == name
            and finding.question in WATCHED
            and finding.verdict != "unknown"
        ]
        worst = max(answers, key=lambda finding: SEVERITY[finding.verdict], default=None)
        verdict = worst.verdict if worst else "unknown"
        reason = f"{worst.question}: {worst.measured}" if worst and verdict != "ok" else ""
        before = self._lights.get(name)
        streak = self._agreed.get(name, ("", 0))
        self._agreed[name] = (verdict, streak[1] + 1 if streak[0] == verdict else 1)
        if before is None or (verdict != before.verdict and self._agreed[name][1] >= ROUNDS):
            light = Light(
                camera=name, verdict=verdict, reason=reason, time=time_s, n_frames=record.n_read
            )
        elif verdict == before.verdict:
            light = replace(before, reason=reason, n_frames=record.n_read)
        else:
            light = replace(before, n_frames=record.n_read)
        self._lights[name] = light
        return light


def watch(
    path: Path,
    every_s: float,
    *,
    rig: Path | None = None,
    page: Path | None = None,
    as_json: bool = False,
    rounds: int = 0,
    clock: Callable[[], float] = time.time,
    sleep: Callable[[float], None] = time.sleep,
) -> Iterator[str]:
    """Look at a rig every few seconds.

    Gives one line per camera in the first round, and later for each that changes.

    Args:
        rig: capture of the same cameras with poses.
        page: HTML file that is written anew each round and refreshes itself in a browser.
        as_json: all cameras of every round as one JSON object each, in place of sentences.
        rounds: to stop after; 0 continues until it is interrupted.
        clock: seconds since 1970.
    """
    watched, number = Watch(path, rig), 0
    states: dict[str, tuple[str, str]] = {}
    while True:
        number += 1
        time_s = clock()
        try:
            lights = watched.look(time_s)
        except CaptureError as error:
            lights = []
            yield (
                json.dumps({"time": time_s, "waiting": str(error)})
                if as_json
                else f"waiting: {error}"
            )
        for light in lights:
            state = (light.verdict, light.reason.split(":")[0])
            if as_json:
                yield json.dumps({"round": time_s, **asdict(light)})
            elif states.get(light.camera) != state:
                yield light.line()
            states[light.camera] = state
        if page is not None:
            write_page(page, path, lights, every_s, time_s)
        if number == rounds:
            return
        sleep(max(every_s - (clock() - time_s), 0.0))


def write_page(
    file: Path, path: Path, lights: Iterable[Light], every_s: float, time_s: float
) -> None:
    """One small page of all cameras, which loads itself again."""
    rows = "".join(
        f'<tr class="{light.verdict}"><td>{escape(light.camera)}<td><b>{light.verdict}</b>'
        f"<td>{escape(light.reason)}"
        f"<td>{time.strftime('%H:%M:%S', time.localtime(light.time))}<td>{light.n_frames} frames"
        for light in lights
    )
    head = PAGE_HEAD.format(seconds=max(every_s, 1.0), title=f"{escape(path.name)}: rig")
    clock = time.strftime("%H:%M:%S", time.localtime(time_s))
    text = f"{head}<h1>{escape(path.name)}</h1><p>{clock}</p><table>{rows}</table>\n"
    with atomic_file(file) as unfinished:
        unfinished.write_text(text, encoding="utf-8")
