"""Options of the demo capture."""

import math
from dataclasses import dataclass
from typing import Literal, get_args

from ggvs_eval.errors import CaptureError

LayoutName = Literal[
    "dynerf",
    "enerf-outdoor",
    "d3dmv",
    "colmap",
    "rgbd",
    "meetroom",
    "technicolor",
    "immersive",
    "panoptic",
]
RigName = Literal["rows", "arc", "grid"]
SceneName = Literal["room", "garden"]
LEAST = {
    "width": 16,
    "height": 16,
    "n_frames": 1,
    "cameras_per_row": 2,
    "supersampling": 1,
    "path_poses": 0,
    "depth_stride": 0,
}
# What came after demos had been written: a demo says nothing of those that are as they were, so
# that it stays valid.
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
        layout: file layout of the data set of that name; the scene is the same in each.
        seed: seed of the room, its contents, the rig's small errors and the noise.
        width: image width, pixels, even.
        height: image height, pixels, even.
        n_frames: frames per camera; poses of the hand-held camera of rgbd.
        fps: frame rate, frames per second.
        cameras_per_row: cameras in each of the two rows; rgbd has one camera, cam00.
        noise_sigma_255: standard deviation of sensor noise per pixel and frame, 0..255; 0: none.
        exposure_spread: standard deviation of camera gains; half as much for colour balance; 0:
            none.
        crf: x264 rate factor of the videos.
        supersampling: rays per pixel along each side.
        path_poses: poses of the true camera path next to the videos of dynerf and colmap; 0: none.
        depth_stride: frames per exact depth map; 0: no depth.
        camera_gain: fault: camera and brightness factor.
        frame_offset: fault: camera and offset; its frame t shows instant t + offset.
        calibration_error_px: fault: standard deviation of rotation errors, pixels at the image
            centre.
        focal_error: fault: camera and factor on its recorded focal length.
        rig: rows: DyNeRF's two rows on an arc; arc: one wide row (ENeRF-Outdoor); grid: two rows
            (D3DMV).
        scene: living room, or garden with thin foliage.
        spacing: factor on the camera distances of rows and grids.
        sway: factor on the rotation of rgbd's hand-held camera.
        shutter_s: rgbd: exposure time of the hand-held camera, seconds; 0: no motion blur.
        defocus_px: radius of the circle of confusion, pixels; 0: sharp.
        processing: strength of camera processing (shot noise, denoising, sharpening); 0: none, 1: a
            phone.
        jpeg_quality: JPEG quality of the cameras' pictures, 1..100; 0: no compression.
        vignetting: darkening of corners, share of sRGB values; lenses of a rig vary by a fifth; 0:
            none.
        depth_offset_px: rgbd: unrecorded shift of the depth sensor, colour pixels, in a random
            direction.
        depth_rotation_rad: rgbd: unrecorded rotation of the depth sensor, radians, about a random
            axis.
        depth_delay_s: rgbd: unrecorded lead of the depth sensor over the colour camera, seconds.
        depth_noise: rgbd: standard deviation of depth at 1 m, metres; grows with squared depth,
            blurs edges.
        noise_seed: seed of sensor noise alone, for another take of the same room.
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
                raise CaptureError(
                    f"demo: wanted a {kind} of {', '.join(get_args(names))}, got "
                    f"{getattr(self, kind)!r}"
                )
        for name, least in LEAST.items():
            if getattr(self, name) < least:
                raise CaptureError(
                    f"demo: {name} must be at least {least}, got {getattr(self, name)}"
                )
        if self.width % 2 or self.height % 2:
            raise CaptureError(
                f"demo: H.264 wants an even size, got {self.width} x {self.height}; add one pixel"
            )
        width, height = SHAPES.get(self.layout, (self.width, self.height))
        if self.width * height != self.height * width:
            raise CaptureError(
                f"demo: pictures of {self.layout} have the shape of {width} x {height}, got "
                f"{self.width} x {self.height}; use {width // 4} x {height // 4}"
            )
        if self.fps <= 0 or self.noise_sigma_255 < 0 or self.exposure_spread < 0:
            values = f"{self.fps:g}, {self.noise_sigma_255:g}, {self.exposure_spread:g}"
            raise CaptureError(
                f"demo: fps must be positive, noise and exposure spread not negative, got {values}"
            )
        self._check_faults()
        self._check_later()

    def _check_later(self) -> None:
        numbers = [name for name in LATER if name not in ("rig", "scene")]
        for name in numbers:
            least = 1e-3 if name == "spacing" else 0.0
            if not least <= getattr(self, name) < math.inf:
                raise CaptureError(
                    f"demo: {name} must be at least {least:g}, got {getattr(self, name):g}"
                )
        if self.vignetting > 0.5:
            raise CaptureError(
                f"demo: vignetting must be at most 0.5, corners half as bright, got "
                f"{self.vignetting:g}"
            )
        if self.jpeg_quality > 100:
            raise CaptureError(
                f"demo: jpeg_quality must be 1 to 100, or 0 for none, got {self.jpeg_quality}"
            )
        if self.layout != "rgbd":
            for name in RGBD_ONLY:
                if getattr(self, name):
                    raise CaptureError(
                        f"demo: {name} needs layout rgbd, got {self.layout}; drop it"
                    )

    def _check_faults(self) -> None:
        for option in ("camera_gain", "frame_offset", "focal_error"):
            self._check_names(option, [name for name, _ in getattr(self, option)])
        for option, pairs in (("camera_gain", self.camera_gain), ("focal_error", self.focal_error)):
            for name, factor in pairs:
                if not 0 < factor < math.inf:
                    raise CaptureError(
                        f"demo: {option} of {name} must be a positive factor, got {factor:g}; 1 "
                        f"changes nothing"
                    )
        for name, offset in self.frame_offset:
            if not isinstance(offset, int):
                raise CaptureError(
                    f"demo: frame_offset of {name} must be a whole number of frames, got {offset}"
                )
        if self.frame_offset and self.layout == "rgbd":
            raise CaptureError(
                "demo: frame_offset wants cameras that film together, rgbd has one at one instant; "
                "drop it"
            )
        if not 0 <= self.calibration_error_px < math.inf:
            raise CaptureError(
                f"demo: calibration_error_px must not be negative, got "
                f"{self.calibration_error_px:g}"
            )

    def _check_names(self, option: str, names: list[str]) -> None:
        unknown = [name for name in names if name not in self.camera_names]
        if unknown:
            cameras = (
                f"{self.camera_names[0]}..{self.camera_names[-1]}"
                if len(self.camera_names) > 1
                else self.camera_names[0]
            )
            raise CaptureError(
                f"demo: {option} names {', '.join(unknown)}, the cameras are {cameras}; correct "
                f"the name"
            )
        if len(set(names)) < len(names):
            raise CaptureError(
                f"demo: {option} wants each camera once, got {', '.join(names)}; keep one value"
            )

    @property
    def camera_names(self) -> list[str]:
        """Names of the cameras in these options, regardless of the names in the layout."""
        count = 1 if self.layout == "rgbd" else 2 * self.cameras_per_row
        return [f"cam{number:02d}" for number in range(count)]

    @property
    def recording(self) -> tuple[int, ...]:
        """Last numbers of the seeds of noise.

        None in the first recording, so that older demos keep their bits.
        """
        return (self.noise_seed,) if self.noise_seed else ()

    @property
    def path_frame(self) -> int:
        """The frame whose instant the camera path shows."""
        return self.n_frames // 2

    @property
    def depth_frames(self) -> list[int]:
        """Frames whose exact depth is kept."""
        return list(range(0, self.n_frames, self.depth_stride)) if self.depth_stride else []
