"""Recording of a viewer: poses and instants, written as a video, or as the camera path of a protocol that `run` evaluates."""

from dataclasses import dataclass, field, replace
from itertools import count
from pathlib import Path

from ggvs_eval.camera import Camera
from ggvs_eval.errors import ProtocolError, RenderError
from ggvs_eval.files.atomic import write_text
from ggvs_eval.files.toml_tables import build_table
from ggvs_eval.pipelines.play.play import record
from ggvs_eval.pipelines.play.playback import Playback
from ggvs_eval.pipelines.view.live_view import ViewRequest, recorded_pose
from ggvs_eval.protocol import CameraPath, PathCamera, Protocol


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
        """Render the path again at the rig's size, by the method that was shown last, into an MP4 file; says which."""
        poses, last = self._poses(), self.requests[-1]
        instants = [request.instant for request in self.requests]
        path = self._free_name(".mp4")
        record(replace(self.playback, poses=poses, instants=instants, k=last.k), path, last.methods[0], self.device)
        return f"{len(poses)} frames by {last.methods[0]} in {path}"

    def write_protocol(self) -> str:
        """Write the protocol with the recorded path; says how it is run.

        Reading:
            A protocol's path is walked at one instant, so that its epipolar plane images show the method's contradictions alone;
            that instant is the one at which the recording began.
        """
        poses = self._poses()
        if len(poses) < 2:
            raise RenderError("a protocol's path wants at least 2 poses, 1 was recorded; move the camera while recording")
        path = self._free_name(".toml")
        cameras = tuple(build_table(PathCamera, pose.to_json(), str(path), "path.cameras.", ProtocolError) for pose in poses)
        chosen = CameraPath(len(poses), cameras, self.requests[0].instant)
        write_text(path, replace(self.protocol, path=chosen).to_toml())
        return (
            f"{len(poses)} poses; evaluate them by `ggvs-eval run OUT --capture {self.playback.capture.path} --protocol {path}`"
        )

    def _poses(self) -> list[Camera]:
        if not self.requests:
            raise RenderError("nothing is recorded yet; press record, move the camera or let time play, and press stop")
        return [recorded_pose(request, self.view, index) for index, request in enumerate(self.requests)]

    def _free_name(self, ending: str) -> Path:
        """The first name in the folder that no file has."""
        self.folder.mkdir(parents=True, exist_ok=True)
        names = (self.folder / f"path{index:03d}{ending}" for index in count())
        return next(name for name in names if not name.exists())
