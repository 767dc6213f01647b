"""What can be chosen about the demo capture."""

from dataclasses import dataclass

from ggvs_eval.errors import CaptureError

LEAST = {"width": 16, "height": 16, "n_frames": 1, "cameras_per_row": 2, "supersampling": 1, "path_poses": 0, "depth_stride": 0}


@dataclass(frozen=True)
class DemoOptions:
    """What the demo capture looks like; equal options give equal bytes.

    Attributes:
        seed: chooses the room, its contents, the rig's small errors and the noise.
        width: of the videos, pixels, even.
        height: of the videos, pixels, even.
        n_frames: frames per camera.
        fps: frames per second.
        cameras_per_row: cameras in each of the two rows.
        noise_sigma_255: standard deviation of the sensor noise of every pixel and frame, of 255 levels; 0 for none.
        exposure_spread: standard deviation of the gain of each camera; its colour balance varies by half as much; 0 for none.
        crf: x264's rate factor of the videos.
        supersampling: rays per pixel along each side.
        path_poses: positions of the true camera path; 0 for no path.
        depth_stride: exact depth is kept of every so many frames; 0 for no depth.
    """

    seed: int = 0
    width: int = 480
    height: int = 360
    n_frames: int = 24
    fps: float = 30.0
    cameras_per_row: int = 12
    noise_sigma_255: float = 1.5
    exposure_spread: float = 0.02
    crf: float = 12.0
    supersampling: int = 2
    path_poses: int = 48
    depth_stride: int = 1

    def __post_init__(self) -> None:
        """Refuse what cannot be filmed."""
        for name, least in LEAST.items():
            if getattr(self, name) < least:
                raise CaptureError(f"demo: {name} must be at least {least}, got {getattr(self, name)}")
        if self.width % 2 or self.height % 2:
            raise CaptureError(f"demo: H.264 wants an even size, got {self.width} x {self.height}; add one pixel")
        if self.fps <= 0 or self.noise_sigma_255 < 0 or self.exposure_spread < 0:
            values = f"{self.fps:g}, {self.noise_sigma_255:g}, {self.exposure_spread:g}"
            raise CaptureError(f"demo: fps must be positive, noise and exposure spread not negative, got {values}")

    @property
    def path_frame(self) -> int:
        """The frame whose instant the camera path shows."""
        return self.n_frames // 2

    @property
    def depth_frames(self) -> list[int]:
        """Frames whose exact depth is kept."""
        return list(range(0, self.n_frames, self.depth_stride)) if self.depth_stride else []
