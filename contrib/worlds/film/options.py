"""Options of the demo capture."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from ggvs_eval.errors import CaptureError

LayoutName = Literal["dynerf", "enerf-outdoor", "d3dmv", "colmap", "rgbd", "meetroom", "technicolor", "immersive", "panoptic"]
RigName = Literal["rows", "arc", "grid"]
SceneName = Literal["room", "garden"]
LEAST = {"width": 16, "height": 16, "n_frames": 1, "cameras_per_row": 2, "supersampling": 1, "path_poses": 0, "depth_stride": 0}
# What came after demos had been written: a demo says nothing of those that are as they were, so that it stays valid.
LATER = (
    "rig",
    "scene",
    "spacing",
    "sway",
    "shutter_s",
    "defocus_px",
    "processing",
    "jpeg_quality",
    "vignetting",
    "depth_offset_px",
    "depth_rotation_rad",
    "depth_delay_s",
    "depth_noise",
    "noise_seed",
)
# Layouts whose files hold no size, so that it must have the shape that they are distributed in.
SHAPES = {"technicolor": (2048, 1088)}
RGBD_ONLY = ("shutter_s", "depth_offset_px", "depth_rotation_rad", "depth_delay_s", "depth_noise")


@dataclass(frozen=True)
class DemoOptions:
    """Options of the demo capture; equal ones give equal bytes.

    Attributes:
        layout: of the files, as the data set of that name is distributed; the scene is the same in each.
        seed: chooses the room, its contents, the rig's small errors and the noise.
        width: of the images, pixels, even.
        height: of the images, pixels, even.
        n_frames: frames per camera; poses of the hand-held camera of rgbd.
        fps: frames per second.
        cameras_per_row: cameras in each of the two rows; rgbd has one camera, cam00.
        noise_sigma_255: standard deviation of the sensor noise of every pixel and frame, of 255 levels; 0 for none.
        exposure_spread: standard deviation of the gain of each camera; its colour balance varies by half as much; 0 for none.
        crf: x264's rate factor of the videos.
        supersampling: rays per pixel along each side.
        path_poses: positions of the true camera path next to the videos of dynerf and colmap; 0 for no path.
        depth_stride: frames per exact depth map; 0 for no depth.
        camera_gain: a fault, camera and factor: its images are so much brighter.
        frame_offset: a fault, camera and frames: frame t of the camera shows the instant of frame t + offset.
        calibration_error_px: a fault: cameras are written down with rotations that are wrong by this standard deviation about
            each axis, in pixels at the image's centre. Images are not touched.
        focal_error: a fault, camera and factor: its focal length is written down so much longer. Images are not touched.
        rig: the two rows of DyNeRF's rig, on an arc; as many cameras in one row on a wide arc, as ENeRF-Outdoor's are; or two
            rows that look almost straight ahead, as D3DMV's do.
        scene: the living room, or a garden: thin foliage before a far background.
        spacing: factor on the distances between the cameras of rows and grids.
        sway: factor on how far the hand-held camera of rgbd looks about.
        shutter_s: rgbd: how long the hand-held camera exposes each picture while it moves; 0 for no motion blur.
        defocus_px: radius of the disc into which the lens spreads every point, pixels; 0 for a sharp picture.
        processing: how strongly each camera makes its own picture of a mosaic of colours: shot noise, denoising and sharpening
            at 1 as a telephone's; 0 for none of it.
        jpeg_quality: at which each camera compresses its pictures, 1 to 100; 0 for no compression.
        vignetting: how much darker the corners of the pictures are than their middle, share of the sRGB values; of a rig's lenses
            each differs from it by a fifth; 0 for lenses without fall-off.
        depth_offset_px: rgbd: shift of the depth sensor's picture, pixels of the colour image, in a
            direction that the seed chooses. What is written down says nothing of it, nor of the next three.
        depth_rotation_rad: rgbd: the sensor of depth is turned by so much about an axis that the seed chooses.
        depth_delay_s: rgbd: the sensor of depth measures so long before the colour camera.
        depth_noise: rgbd: standard deviation of measured depth at 1 m, metres; it grows with the square of depth, as of sensors
            that triangulate. Depth at edges is lost with it.
        noise_seed: another value films the same room again: the noise of every sensor is another, all else is as it was.
    """

    layout: LayoutName = "dynerf"
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
    camera_gain: tuple[tuple[str, float], ...] = ()
    frame_offset: tuple[tuple[str, int], ...] = ()
    calibration_error_px: float = 0.0
    focal_error: tuple[tuple[str, float], ...] = ()
    rig: RigName = "rows"
    scene: SceneName = "room"
    spacing: float = 1.0
    sway: float = 1.0
    shutter_s: float = 0.0
    defocus_px: float = 0.0
    processing: float = 0.0
    jpeg_quality: int = 0
    vignetting: float = 0.0
    depth_offset_px: float = 0.0
    depth_rotation_rad: float = 0.0
    depth_delay_s: float = 0.0
    depth_noise: float = 0.0
    noise_seed: int = 0

    def __post_init__(self) -> None:
        """Refuse options that cannot be rendered."""
        for kind, names in (("layout", LayoutName), ("rig", RigName), ("scene", SceneName)):
            if getattr(self, kind) not in get_args(names):
                raise CaptureError(f"demo: wanted a {kind} of {', '.join(get_args(names))}, got {getattr(self, kind)!r}")
        for name, least in LEAST.items():
            if getattr(self, name) < least:
                raise CaptureError(f"demo: {name} must be at least {least}, got {getattr(self, name)}")
        if self.width % 2 or self.height % 2:
            raise CaptureError(f"demo: H.264 wants an even size, got {self.width} x {self.height}; add one pixel")
        width, height = SHAPES.get(self.layout, (self.width, self.height))
        if self.width * height != self.height * width:
            raise CaptureError(
                f"demo: pictures of {self.layout} have the shape of {width} x {height}, got {self.width} x {self.height}; "
                f"take {width // 4} x {height // 4}"
            )
        if self.fps <= 0 or self.noise_sigma_255 < 0 or self.exposure_spread < 0:
            values = f"{self.fps:g}, {self.noise_sigma_255:g}, {self.exposure_spread:g}"
            raise CaptureError(f"demo: fps must be positive, noise and exposure spread not negative, got {values}")
        self._check_faults()
        self._check_later()

    def _check_later(self) -> None:
        numbers = [name for name in LATER if name not in ("rig", "scene")]
        for name in numbers:
            least = 1e-3 if name == "spacing" else 0.0
            if not least <= getattr(self, name) < math.inf:
                raise CaptureError(f"demo: {name} must be at least {least:g}, got {getattr(self, name):g}")
        if self.vignetting > 0.5:
            raise CaptureError(f"demo: vignetting must be at most 0.5, corners half as bright, got {self.vignetting:g}")
        if self.jpeg_quality > 100:
            raise CaptureError(f"demo: jpeg_quality must be 1 to 100, or 0 for none, got {self.jpeg_quality}")
        if self.layout != "rgbd":
            for name in RGBD_ONLY:
                if getattr(self, name):
                    raise CaptureError(f"demo: {name} wants the hand-held camera of rgbd, got layout {self.layout}; drop it")

    def _check_faults(self) -> None:
        for option in ("camera_gain", "frame_offset", "focal_error"):
            self._check_names(option, [name for name, _ in getattr(self, option)])
        for option, pairs in (("camera_gain", self.camera_gain), ("focal_error", self.focal_error)):
            for name, factor in pairs:
                if not 0 < factor < math.inf:
                    raise CaptureError(f"demo: {option} of {name} must be a positive factor, got {factor:g}; 1 changes nothing")
        for name, offset in self.frame_offset:
            if not isinstance(offset, int):
                raise CaptureError(f"demo: frame_offset of {name} must be a whole number of frames, got {offset}")
        if self.frame_offset and self.layout == "rgbd":
            raise CaptureError("demo: frame_offset wants cameras that film together, rgbd has one at one instant; drop it")
        if not 0 <= self.calibration_error_px < math.inf:
            raise CaptureError(f"demo: calibration_error_px must not be negative, got {self.calibration_error_px:g}")

    def _check_names(self, option: str, names: list[str]) -> None:
        unknown = [name for name in names if name not in self.camera_names]
        if unknown:
            there = f"{self.camera_names[0]}..{self.camera_names[-1]}" if len(self.camera_names) > 1 else self.camera_names[0]
            raise CaptureError(f"demo: {option} names {', '.join(unknown)}, the cameras are {there}; correct the name")
        if len(set(names)) < len(names):
            raise CaptureError(f"demo: {option} wants each camera once, got {', '.join(names)}; keep one value")

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras in these options, regardless of the names in the layout."""
        count = 1 if self.layout == "rgbd" else 2 * self.cameras_per_row
        return [f"cam{number:02d}" for number in range(count)]

    @property
    def recording(self) -> tuple[int, ...]:
        """Last numbers of the seeds of noise; none in the first recording, so that older demos keep their bits."""
        return (self.noise_seed,) if self.noise_seed else ()

    @property
    def path_frame(self) -> int:
        """The frame whose instant the camera path shows."""
        return self.n_frames // 2

    @property
    def depth_frames(self) -> list[int]:
        """Frames whose exact depth is kept."""
        return list(range(0, self.n_frames, self.depth_stride)) if self.depth_stride else []
