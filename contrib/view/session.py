"""One browser window: its controls, what it asks for, and the pictures that it is sent."""

import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy.spatial.transform import Rotation

from ggvs_eval.camera import Camera
from ggvs_eval.contrib.view.live_view import LAYERS, FrameStock, LiveView, Picture, ViewRequest
from ggvs_eval.contrib.view.scene import (
    Frusta,
    Leash,
    add_cloud,
    camera_orientation,
    gazed_depth,
    middle_camera,
)
from ggvs_eval.errors import GgvsError
from ggvs_eval.pipelines.play.playback import Playback
from ggvs_eval.pipelines.play.synthesizer import SEEN_FROM_DEG
from ggvs_eval.protocol import Protocol

if TYPE_CHECKING:
    import viser
from dataclasses import field
from itertools import count

from ggvs_eval.contrib.view.live_view import recorded_pose
from ggvs_eval.errors import ProtocolError, RenderError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.files.toml_tables import build_table
from ggvs_eval.pipelines.play.play import record
from ggvs_eval.protocol import CameraPath, PathCamera


@dataclass
class Recording:
    """The requests that were answered between start and stop; a new start forgets them.

    Attributes:
        view: camera whose size and depth range the recorded poses get.
        protocol: evaluates the capture; its path is replaced by the recorded one.
        folder: where files go, ``path000.mp4``, ``path000.toml``, ...
        requests: what was recorded, in the order of time.
    """

    playback: Playback
    view: Camera
    protocol: Protocol
    folder: Path
    device: str
    requests: list[ViewRequest] = field(default_factory=list)
    is_running: bool = False

    def toggle(self) -> bool:
        """Start or stop; whether it records now."""
        self.is_running = not self.is_running
        if self.is_running:
            self.requests.clear()
        return self.is_running

    def append(self, request: ViewRequest) -> None:
        """Remember a request while recording."""
        if self.is_running:
            self.requests.append(request)

    def write_video(self) -> str:
        """Render the path again at the rig's size, by the method that was shown last, into an MP4
        file; says which.
        """
        poses, last = self._poses(), self.requests[-1]
        instants = [request.instant for request in self.requests]
        path = self._free_name(".mp4")
        record(
            replace(self.playback, poses=poses, instants=instants, k=last.k),
            path,
            last.methods[0],
            self.device,
        )
        return f"{len(poses)} frames by {last.methods[0]} in {path}"

    def write_protocol(self) -> str:
        """Write the protocol with the recorded path; says how it is run.

        Reading:
            A protocol's path is walked at one instant, so that its epipolar plane images show the
            method's contradictions alone; that instant is the one at which the recording began.
        """
        poses = self._poses()
        if len(poses) < 2:
            raise RenderError(
                "a protocol's path wants at least 2 poses, 1 was recorded; move the camera while "
                "recording"
            )
        path = self._free_name(".toml")
        cameras = tuple(
            build_table(PathCamera, pose.to_json(), str(path), "path.cameras.", ProtocolError)
            for pose in poses
        )
        path_of_poses = CameraPath(len(poses), cameras, self.requests[0].instant)
        write_text(path, replace(self.protocol, path=path_of_poses).to_toml())
        return (
            f"{len(poses)} poses; evaluate them by `ggvs-eval run OUT --capture "
            f"{self.playback.capture.path} --protocol {path}`"
        )

    def _poses(self) -> list[Camera]:
        if not self.requests:
            raise RenderError(
                "wanted a recorded path, got none; press record, move the camera or let time play, "
                "and press stop"
            )
        return [
            recorded_pose(request, self.view, index) for index, request in enumerate(self.requests)
        ]

    def _free_name(self, ending: str) -> Path:
        """Return the first name in the folder that no file has."""
        self.folder.mkdir(parents=True, exist_ok=True)
        names = (self.folder / f"path{index:03d}{ending}" for index in count())
        return next(name for name in names if not name.exists())


NOTHING = "-"
MOST_SOURCES = 8
JPEG_QUALITY = 85
FIRST = "rendering the first frame ..."
OUTSIDE = (
    "**outside the cameras' coverage**: {:.0%} of this view is covered from within "
    f"{SEEN_FROM_DEG:g} degrees, the rest is extrapolated; press *reset view*"
)
# of the sources' pixels, below which the window notes that most of the picture is based on little
LITTLE_DEPTH = 0.5
REST_SECONDS = 0.25  # without a change, before the picture is made at full size
RATE_SECONDS = 2.0  # over which pictures per second are counted


@dataclass(frozen=True)
class ViewDefaults:
    """Initial settings of a window.

    Attributes:
        protocol: evaluates the capture, for paths that are recorded.
        recordings: folder of what is recorded.
    """

    method: str
    methods: Sequence[str]
    k: int
    protocol: Protocol
    recordings: Path


class Session:
    """A browser window and the two views behind it: a small one that keeps up, and a whole one for
    a camera at rest.

    The viewer calls `advance` again and again on one thread, `refine` on another; the browser's
    messages arrive on more.

    Args:
        pixels: of a small picture, at most.
    """

    def __init__(
        self,
        client: "viser.ClientHandle",
        playback: Playback,
        stocks: tuple[FrameStock, FrameStock],
        pixels: int,
        defaults: ViewDefaults,
        device: str,
        changed: Callable[[], None],
    ) -> None:
        self.client, self._playback, self._stocks, self._changed_callback = (
            client,
            playback,
            stocks,
            changed,
        )
        small, full = stocks
        units = playback.capture.units_per_metre
        self._moving = LiveView(
            stock=small,
            units_per_metre=units,
            pixels=pixels,
            device=device,
            sources=playback.sources,
        )
        view = middle_camera(full.cameras)
        self._whole = LiveView(
            stock=full,
            units_per_metre=units,
            pixels=view.width * view.height,
            device=device,
            sources=playback.sources,
        )
        self.recording = Recording(
            playback=playback,
            view=view,
            protocol=defaults.protocol,
            folder=defaults.recordings,
            device=device,
        )
        self._lock = threading.Lock()
        self._version, self._shown_version, self._refined_version = 1, 0, 0
        self._changed_at = monotonic()
        self._sent: list[float] = []
        self._next_instant_at = 0.0
        self._cloud: viser.PointCloudHandle | None = None
        self._frusta = Frusta(client.scene, small.cameras)
        self._leash = Leash(small.cameras, gazed_depth(small, playback.instants[0]))
        self._was_within = False  # a browser begins elsewhere, before it is told where to stand
        for handle, camera in zip(self._frusta.handles, small.cameras, strict=True):
            handle.on_click(partial(self._stand_where, camera.name))
        self._add_controls(defaults)
        client.camera.on_update(lambda _: self.change())

    def change(self, *_: Any) -> None:
        """Ask for a new picture."""
        with self._lock:
            self._version += 1
            self._changed_at = monotonic()
        self._changed_callback()

    def advance(self) -> bool:
        """Send the next small picture if one is due; whether there was one."""
        if self._play.value and monotonic() >= self._next_instant_at:
            self._next_instant_at = max(
                self._next_instant_at + 1 / (self._playback.capture.fps or 30.0), monotonic() - 0.1
            )
            instants = sorted(set(self._playback.instants))
            following = instants[(instants.index(int(self._time.value)) + 1) % len(instants)]
            self._time.value = following  # type: ignore[misc]  # its setter is too far from its getter for mypy
        with self._lock:
            version = self._version
        if version == self._shown_version:
            return False
        self._shown_version = version
        request = self._request()
        self._frusta.show(self._cameras.value, request.pose.centre)
        picture = self._attempt(self._moving, request)
        if picture is not None:
            self._send(picture)
            self.recording.append(request)
        return True

    def rests(self) -> bool:
        """Return whether nothing has changed for a while, and the whole picture has not been made
        yet.
        """
        with self._lock:
            rested = monotonic() - self._changed_at >= REST_SECONDS
            return rested and self._shown_version == self._version != self._refined_version

    def refine(self) -> None:
        """Make the whole picture and send it, unless something has changed meanwhile."""
        with self._lock:
            version = self._version
            self._refined_version = version
        self._come_back()
        self._whole.restart()  # what it saw before was another pose at another time
        picture = self._attempt(self._whole, self._request())
        with self._lock:
            is_current = version == self._version
        if picture is not None and is_current:
            self._send(picture)

    def complain(self, reason: str) -> None:
        """Show in the page why there is no picture."""
        self._status.content = f"**{reason}**"

    def _come_back(self) -> None:
        """Take the window's camera along where it was dragged out of reach, once it rests.

        The picture stays the one it has.
        """
        place = np.asarray(self.client.camera.position)
        within = self._leash.keep(place)
        if np.array_equal(within, place):
            self._was_within = True
        elif self._was_within:
            self.client.camera.position = within

    def _request(self) -> ViewRequest:
        label = self._label.value.strip() or self._method.value
        methods = (label,) if self._other.value == NOTHING else (label, self._other.value)
        instant, k = int(self._time.value), int(self._k.value)
        return ViewRequest(
            pose=self._pose(),
            instant=instant,
            methods=methods,
            k=k,
            layer=self._layer.value,
            divider=float(self._divider.value),
        )

    def _pose(self) -> Camera:
        """Return the window's camera; square pixels, the principal point in the middle."""
        state = self.client.camera
        view = middle_camera(self._stocks[1].cameras)
        width, height = max(state.image_width, 16), max(state.image_height, 16)
        focal = height / (2 * np.tan(state.fov / 2))
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = Rotation.from_quat(state.wxyz, scalar_first=True).as_matrix().T
        world_to_camera[:3, 3] = -world_to_camera[:3, :3] @ self._leash.keep(
            np.asarray(state.position)
        )
        K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
        return replace(
            view, name="view", K=K, world_to_camera=world_to_camera, width=width, height=height
        )

    def _attempt(self, view: LiveView, request: ViewRequest) -> Picture | None:
        """Return the picture, or a message in the page that says why there is none."""
        try:
            picture = view.picture(request)
        except GgvsError as error:
            self.complain(str(error))
            return None
        return picture

    def _send(self, picture: Picture) -> None:
        self.client.scene.set_background_image(
            picture.faded, format="jpeg", jpeg_quality=JPEG_QUALITY
        )
        time_s = monotonic()
        self._sent = [at for at in self._sent if at > time_s - RATE_SECONDS] + [time_s]
        self._status.content = status_text(picture, len(self._sent) / RATE_SECONDS)

    def _add_controls(self, defaults: ViewDefaults) -> None:
        gui, playback = self.client.gui, self._playback
        instants, names = (
            sorted(set(playback.instants)),
            [camera.name for camera in playback.capture.cameras],
        )
        gui.add_button("reset view", hint="back to the initial view (key: R)").on_click(
            lambda _: self._reset()
        )
        gui.add_command("reset view", hotkey="R").on_trigger(lambda _: self._reset())
        with gui.add_folder("Method"):
            self._method = gui.add_dropdown(
                "method", tuple(defaults.methods), initial_value=defaults.method
            )
            self._label = gui.add_text(
                "or by label", "", hint="any label, with options: ours+tau_m=0.05"
            )
            self._k = gui.add_slider(
                "K",
                1,
                max(min(MOST_SOURCES, len(names)), defaults.k),
                1,
                defaults.k,
                hint="source views",
            )
            self._layer = gui.add_dropdown("show", LAYERS)
            self._other = gui.add_dropdown("compare with", (NOTHING, *defaults.methods))
            self._divider = gui.add_slider("divider", 0.0, 1.0, 0.01, 0.5)
        with gui.add_folder("Time"):
            self._play = gui.add_checkbox("play", initial_value=False, disabled=len(instants) == 1)
            self._time = gui.add_slider(
                "instant",
                instants[0],
                max(instants[-1], instants[0] + 1),
                1,
                instants[0],
                disabled=len(instants) == 1,
            )
        with gui.add_folder("Scene"):
            self._go_to = gui.add_dropdown("go to camera", (NOTHING, *names))
            self._cameras = gui.add_checkbox(
                "cameras", initial_value=True, hint="click one to go there"
            )
            self._points = gui.add_checkbox(
                "points", initial_value=False, hint="surface points from depth"
            )
        self._add_recording(gui)
        with gui.add_folder("Latency"):
            # the last of all: it grows without moving a control
            self._status = gui.add_markdown(FIRST)
        method = (self._method, self._label, self._k, self._layer, self._other, self._divider)
        for control in (*method, self._time, self._play, self._cameras):
            control.on_update(self.change)
        self._go_to.on_update(lambda _: self._stand_where(self._go_to.value))
        self._points.on_update(lambda _: self._show_points())
        self._time.on_update(lambda _: self._show_points())

    def _add_recording(self, gui: "viser.GuiApi") -> None:
        with gui.add_folder("Path"):
            self._record = gui.add_button("record")
            video, protocol = gui.add_button("write video"), gui.add_button("write protocol")
            self._recorded = gui.add_markdown("")

        def toggle(_: Any) -> None:
            self._record.label = "stop" if self.recording.toggle() else "record"
            self._recorded.content = f"{len(self.recording.requests)} poses"

        def tell(write: Callable[[], str]) -> None:
            self._recorded.content = "writing ..."
            try:
                self._recorded.content = write()
            except (GgvsError, OSError) as error:
                self._recorded.content = f"**{error}**"

        self._record.on_click(toggle)
        video.on_click(lambda _: tell(self.recording.write_video))
        protocol.on_click(lambda _: tell(self.recording.write_protocol))

    def _stand_where(self, name: str, *_: Any) -> None:
        """Move the window's camera to a camera of the rig."""
        if name == NOTHING:
            return
        camera = self._playback.capture.camera(name)
        with self.client.atomic():
            self.client.camera.position = camera.centre
            self.client.camera.wxyz = camera_orientation(camera)
        self.change()

    def _reset(self) -> None:
        """Put the window's camera back to where it opened."""
        self._stand_where(middle_camera(self._playback.capture.cameras).name)

    def _show_points(self) -> None:
        if self._cloud is not None:
            self._cloud.remove()
            self._cloud = None
        if self._points.value:
            self._cloud = add_cloud(self.client.scene, self._stocks[0], int(self._time.value))


def status_text(picture: Picture, rate: float) -> str:
    """Pictures per second, size, source cameras and milliseconds of each stage, as Markdown.

    Outside of the rig that alone.
    """
    if picture.is_outside:
        return OUTSIDE.format(picture.seen_share)
    height, width = picture.image.shape[:2]
    lines = [f"{rate:.1f} frames per second, {width} x {height}, from {', '.join(picture.sources)}"]
    little = "**little**: " if picture.known_depth < LITTLE_DEPTH else ""
    lines.append(f"depth {little}known in {picture.known_depth:.0%} of its sources' pixels")
    for label, seconds in picture.seconds.items():
        stages = ", ".join(f"{stage} {1000 * stage_s:.0f}" for stage, stage_s in seconds.items())
        lines.append(f"{label}: {stages} ms")
    return "\n\n".join(lines)
