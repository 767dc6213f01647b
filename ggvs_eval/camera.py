"""A calibrated pinhole camera.

Conventions (docs/conventions.md): OpenCV axes, world_to_camera, the centre of pixel (i, j) is at
(u, v) = (i + 0.5, j + 0.5), depth is z in the camera's frame, in world units.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import numpy as np

from ggvs_eval.arrays import Array
from ggvs_eval.errors import CameraError
from ggvs_eval.kernels.portable import length, transformed

ROUNDING = 1e-4  # of a rotation's products of axes: numbers as files keep them
RangeOrigin = Literal["given", "measured", "guessed"]
# how source cameras are chosen, see `geometry.source_views`
SourceChoice = Literal["nearest", "coverage", "triplet"]
# of a rotation's entries from the nearest rotation's, for one that is still meant to be a rotation
LARGEST_DEVIATION = 1e-2


@dataclass(frozen=True, eq=False)
class Camera:
    """One fixed camera of a rig, or one pose of a virtual one.

    Attributes:
        name: how the capture calls it, e.g. ``cam00``.
        K: intrinsics in pixels, (3, 3), zero skew.
        world_to_camera: rigid transform, (4, 4), OpenCV axes.
        width: image width in pixels.
        height: image height in pixels.
        near: smallest depth of the scene seen from here, world units.
        far: largest depth of the scene seen from here, world units.
        deviation: largest difference between the entries of the given matrix and those of the
            nearest rotation, which took its place; 0 if it is kept as it was given.
        range_origin: whether near and far are given by the capture or its user, measured on its
            pictures, or guessed from where its cameras look; nothing may be refused for a guess.

    Reading:
        Poses of public captures are orthonormal to 2e-4, some to less. What is within `ROUNDING` is
        kept bit by bit; up to `LARGEST_DEVIATION` the nearest rotation is taken (singular value
        decomposition), about the camera's centre -R^-1 t, which files of camera-to-world poses
        state exactly.

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> camera.size, camera.focal_px
        ((8, 6), 8.0)
        >>> camera.resized(16, 12).focal_px
        16.0
    """

    name: str
    K: Array
    world_to_camera: Array
    width: int
    height: int
    near: float
    far: float
    deviation: float = field(default=0.0, kw_only=True, repr=False)
    range_origin: RangeOrigin = field(default="given", kw_only=True, repr=False)

    def __post_init__(self) -> None:
        for name, shape in (("K", (3, 3)), ("world_to_camera", (4, 4))):
            matrix = np.ascontiguousarray(getattr(self, name), dtype=np.float64)
            if matrix.shape != shape or not np.isfinite(matrix).all():
                raise CameraError(
                    f"camera {self.name}: {name} must be {shape} finite numbers, got "
                    f"{matrix.shape} with {np.count_nonzero(~np.isfinite(matrix))} not finite; "
                    "recalibrate or drop this camera"
                )
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)
        with np.errstate(over="ignore", invalid="ignore"):  # of numbers that are no rotation by far
            self._check_values()
            if not _is_near(self.rotation @ self.rotation.T, np.eye(3), ROUNDING):
                self._straighten()

    def _check_values(self) -> None:
        if not _is_near(self.world_to_camera[3], np.array([0, 0, 0, 1]), 1e-8):
            last_row = self.world_to_camera[3].tolist()
            raise CameraError(
                f"camera {self.name}: world_to_camera must end with the row 0 0 0 1, got "
                f"{last_row}; transpose it"
            )
        determinant = np.linalg.det(self.rotation)
        if not determinant > 0:
            raise CameraError(
                f"camera {self.name}: the rotation must be orthonormal with determinant +1, got "
                f"determinant {determinant:.4f}; check axis order and handedness of the pose file"
            )
        if self.width < 1 or self.height < 1 or self.K[0, 0] <= 0 or self.K[1, 1] <= 0:
            raise CameraError(
                f"camera {self.name}: size and focal lengths must be positive, got {self.width} x "
                f"{self.height}, fx {self.K[0, 0]:g}, fy {self.K[1, 1]:g}"
            )
        if not 0 < self.near < self.far < np.inf:
            raise CameraError(
                f"camera {self.name}: depth range must satisfy 0 < near < far, got {self.near:g} "
                f".. {self.far:g}"
            )

    def _straighten(self) -> None:
        """Replace an almost orthonormal matrix by the nearest rotation."""
        rotation, deviation = nearest_rotation(self.rotation)
        if deviation > LARGEST_DEVIATION:
            raise CameraError(
                f"camera {self.name}: the rotation must be orthonormal, got entries "
                f"{deviation:.2g} off the nearest rotation's, "
                f"where {LARGEST_DEVIATION:g} can be corrected; scaled or rounded? export the pose "
                f"again"
            )
        world_to_camera = rigid(
            rotation, rotation @ np.linalg.solve(self.rotation, self.translation)
        )
        world_to_camera.setflags(write=False)
        object.__setattr__(self, "world_to_camera", world_to_camera)
        object.__setattr__(self, "deviation", deviation)

    def to_json(self) -> dict[str, Any]:
        """Return all except the name as values for a JSON file.

        `from_json` gives back the same camera, bit by bit.
        """
        return {
            "K": self.K.tolist(),
            "world_to_camera": self.world_to_camera.tolist(),
            "size": list(self.size),
            "near": float(self.near),
            "far": float(self.far),
        }

    @classmethod
    def from_json(cls, name: str, values: Mapping[str, Any]) -> "Camera":
        """Return the camera that `to_json` wrote.

        Raises:
            CameraError: a value is missing, or it is no camera.
        """
        try:
            width, height = values["size"]
            return cls(
                name,
                values["K"],
                values["world_to_camera"],
                width,
                height,
                values["near"],
                values["far"],
            )
        except (KeyError, TypeError, ValueError) as error:
            raise CameraError(
                f"camera {name}: wanted K, world_to_camera, size, near and far, got: {error}"
            ) from error

    @property
    def size(self) -> tuple[int, int]:
        """(width, height) in pixels."""
        return self.width, self.height

    @property
    def rotation(self) -> Array:
        """World-to-camera rotation, (3, 3)."""
        return self.world_to_camera[:3, :3]

    @property
    def translation(self) -> Array:
        """World-to-camera translation, (3,)."""
        return self.world_to_camera[:3, 3]

    @property
    def centre(self) -> Array:
        """Camera centre in the world, (3,)."""
        return self._centre.copy()

    @cached_property
    def _centre(self) -> Array:
        return transformed(-self.rotation.T, self.translation)

    @property
    def axis(self) -> Array:
        """Unit viewing direction in the world, (3,)."""
        return self.rotation[2]

    @property
    def focal_px(self) -> float:
        """Mean of the two focal lengths, pixels."""
        return float(self.K[0, 0] + self.K[1, 1]) / 2

    def project(self, points_world: Array) -> tuple[Array, Array]:
        """Project points into the image.

        Args:
            points_world: (..., 3).

        Returns:
            Image coordinates (..., 2) in pixels (pixel centres at halves) and depth (...); points
            behind the camera have depth <= 0 and meaningless coordinates.

        Examples:
            >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
            >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
            >>> uv, depth = camera.project(np.array([[0.5, 0.0, 2.0]]))
            >>> uv.tolist(), depth.tolist()
            ([[6.0, 3.0]], [2.0])
        """
        points_camera = transformed(self.rotation, points_world) + self.translation
        depth = points_camera[..., 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            uv = points_camera[..., :2] / depth[..., None]
        return uv * self.K[[0, 1], [0, 1]] + self.K[:2, 2], depth

    def unproject(self, uv: Array, depth: Array) -> Array:
        """Lift image coordinates to the world, the inverse of `project`.

        Args:
            uv: (..., 2) in pixels.
            depth: (...), z in world units.

        Returns:
            Points in the world, (..., 3).

        Examples:
            >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
            >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
            >>> camera.unproject(np.array([[6.0, 3.0]]), np.array([2.0])).tolist()
            [[0.5, 0.0, 2.0]]
        """
        rays = (uv - self.K[:2, 2]) / self.K[[0, 1], [0, 1]]
        points_camera = np.concatenate([rays * depth[..., None], depth[..., None]], axis=-1)
        return transformed(self.rotation.T, points_camera - self.translation)

    def pixel_centres(self) -> Array:
        """Return the image coordinates of every pixel, (H, W, 2).

        Examples:
            >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
            >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
            >>> camera.pixel_centres()[0, :2].tolist()
            [[0.5, 0.5], [1.5, 0.5]]
        """
        return np.stack(
            np.meshgrid(np.arange(self.width) + 0.5, np.arange(self.height) + 0.5), axis=-1
        )

    def shows_the_same_rays(self, camera: "Camera") -> bool:
        """Return whether two cameras have the same rays at the same pixels, regardless of their
        names.
        """
        same_pose = np.array_equal(self.world_to_camera, camera.world_to_camera)
        return same_pose and np.array_equal(self.K, camera.K) and self.size == camera.size

    def rays(self) -> Array:
        """Direction of each pixel's ray in the world, (H, W, 3), scaled so that centre + depth *
        ray has that depth.
        """
        return (
            self.unproject(self.pixel_centres(), np.ones((self.height, self.width))) - self.centre
        )

    @property
    def K_opencv(self) -> Array:
        """K for pixel centres at whole numbers, as OpenCV and most networks have them, (3, 3)."""
        return self.K - [[0, 0, 0.5], [0, 0, 0.5], [0, 0, 0]]

    def resized(self, width: int, height: int) -> "Camera":
        """Return the camera of the same image resampled to width x height."""
        K = self.K * np.array([[width / self.width], [height / self.height], [1.0]])
        return replace(self, K=K, width=width, height=height)

    def cropped(self, left: int, top: int, width: int, height: int) -> "Camera":
        """Return the camera of the window that starts at pixel (left, top).

        Examples:
            >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
            >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
            >>> camera.cropped(left=2, top=1, width=4, height=4).K[:2, 2].tolist()
            [2.0, 2.0]
        """
        K = self.K.copy()
        K[:2, 2] -= (left, top)
        return replace(self, K=K, width=width, height=height)


def rigid(rotation: Array, translation: Array) -> Array:
    """Return a transform, (4, 4), of a rotation (3, 3) and a translation (3,)."""
    transform = np.eye(4)
    transform[:3, :3], transform[:3, 3] = rotation, translation
    return transform


def pinhole_K(fx: float, fy: float, cx: float, cy: float) -> Array:
    """Return intrinsics without skew, pixels, (3, 3)."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def _is_near(values: Array, reference: Array, atol: float) -> bool:
    """`np.allclose` of its default rtol, in a tenth of the time: every step makes cameras."""
    return bool((np.abs(values - reference) <= atol + 1e-5 * np.abs(reference)).all())


def nearest_rotation(matrix: Array) -> tuple[Array, float]:
    """Return the rotation nearest to a matrix, by the sum of squared differences of their entries.

    Returns:
        The rotation, (3, 3), and the largest difference of an entry.

    Examples:
        >>> rotation, deviation = nearest_rotation(1.001 * np.eye(3))
        >>> rotation.tolist(), round(deviation, 6)
        ([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]], 0.001)
    """
    if np.abs(matrix).max() > 2:  # no rotation by far, and maybe too large to be squared
        return np.eye(3), float(np.abs(matrix).max())
    left, _, right = np.linalg.svd(matrix)
    rotation = left @ np.diag([1.0, 1.0, np.linalg.det(left @ right)]) @ right
    return rotation, float(np.abs(rotation - matrix).max())


def up_direction(cameras: Iterable[Camera]) -> Array:
    """Return the direction that is up for most cameras of a rig, a unit vector in the
    world, (3,).
    """
    up = -np.mean([camera.rotation[1] for camera in cameras], axis=0)
    return np.asarray(up / np.linalg.norm(up))


def nearest_cameras(target: Camera, cameras: Iterable[Camera], count: int) -> list[Camera]:
    """Return the `count` cameras whose centres are nearest to the target's, nearest first, without
    the target.

    Ties are broken by name, so that equal inputs give equal lists.

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> rig = translated_path(camera, span=1.0, count=5)
        >>> [each.name for each in nearest_cameras(rig[0], rig, 2)]
        ['path0001', 'path0002']
    """
    candidates = [camera for camera in cameras if camera.name != target.name]
    if len(candidates) < count:
        raise CameraError(
            f"camera {target.name}: wanted {count} source cameras, the capture has "
            f"{len(candidates)} others"
        )
    return sorted(
        candidates, key=lambda camera: (float(length(camera.centre - target.centre)), camera.name)
    )[:count]


def translated_path(camera: Camera, span: float, count: int) -> list[Camera]:
    """Return a camera path for epipolar plane images: the camera moves along its own horizontal
    axis and never turns.

    Args:
        span: length of the path in world units.
        count: number of poses, from left to right; they are called ``path0000``, ...

    Examples:
        >>> K = np.array([[8.0, 0, 4], [0, 8, 3], [0, 0, 1]])
        >>> camera = Camera("cam00", K, np.eye(4), width=8, height=6, near=1.0, far=9.0)
        >>> [float(pose.centre[0]) for pose in translated_path(camera, span=1.0, count=3)]
        [-0.5, 0.0, 0.5]
    """
    poses = []
    for index, shift in enumerate(np.linspace(-span / 2, span / 2, count)):
        world_to_camera = camera.world_to_camera.copy()
        world_to_camera[0, 3] -= shift  # moving the camera to the right moves the world to its left
        poses.append(replace(camera, name=f"path{index:04d}", world_to_camera=world_to_camera))
    return poses
