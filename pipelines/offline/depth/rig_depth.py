"""Depth of the source cameras of an instant from the pictures of a rig, as they arrive: for live
synthesis and its timing.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from time import perf_counter
from typing import TYPE_CHECKING, Any

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.pinhole import as_image8
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    ERROR_PX,
    DepthEstimator,
    DepthOptions,
    check_depth,
    finish,
)

if TYPE_CHECKING:
    import torch


@dataclass(frozen=True, eq=False)
class DeviceDepth:
    """Depth of one image where it was computed.

    Attributes:
        depth: see `DepthMap`, (H, W) float32, on the device.
        confidence: same shape.
    """

    depth: "torch.Tensor"
    confidence: "torch.Tensor"

    def download(self) -> DepthMap:
        """As arrays; the host waits for the device."""
        return DepthMap(self.depth.cpu().numpy(), self.confidence.cpu().numpy())


class RigDepth:
    """Depth of any cameras of a rig, instant by instant.

    Everything that does not depend on the images is prepared once.

    IterMVS computes all maps of an instant in one batch, finish and check included, and leaves them
    on its device. The live matcher shares its pairs between the maps; any other computes one map
    after the other.

    Args:
        cameras: the rig.
        options: how depth is found. Maps of an instant are checked against each other if they
            include consistency.
        partners: of each camera the names of those that it is matched with; chosen among the rig,
            see `DepthOptions.choose_partners`, where a camera is not named.
    """

    def __init__(
        self,
        cameras: Sequence[Camera],
        options: DepthOptions,
        partners: Mapping[str, Sequence[str]] | None = None,
    ) -> None:
        self._cameras, self.options = {camera.name: camera for camera in cameras}, options
        self._partners = {name: tuple(names) for name, names in (partners or {}).items()}
        self._estimators: dict[str, DepthEstimator] = {}
        self._rigs: dict[tuple[str, ...], Any] = {}
        if options.matcher.batch:
            from ggvs_eval.pipelines.offline.depth.device_maps import finisher

            self._batch = options.matcher.batch(finisher(options))

    def clock_s(self) -> float:
        """Return the time, seconds, when the depth that was asked for is found: a device works on
        while Python goes ahead.
        """
        device = self.options.matcher.device
        if device == "cpu":
            return perf_counter()
        from ggvs_eval.compute_device import clock_s, compute_device

        return clock_s(compute_device(device))

    def partners(self, name: str) -> tuple[str, ...]:
        """Return the names of the cameras that one is matched with.

        Raises:
            DepthError: no other camera of the rig sees what it sees.
        """
        if name not in self._partners:
            partners = self.options.choose_partners(
                self._cameras[name], list(self._cameras.values())
            )
            self._partners[name] = tuple(camera.name for camera in partners)
        return self._partners[name]

    def needed(self, names: Sequence[str]) -> list[str]:
        """Return the names of the cameras whose pictures the depth of some is found from, theirs
        included.
        """
        return list(
            dict.fromkeys(camera for name in names for camera in (name, *self.partners(name)))
        )

    def estimate(
        self, names: Sequence[str], images: Mapping[str, Image8]
    ) -> dict[str, DepthMap] | dict[str, DeviceDepth]:
        """Return the depth at one instant.

        Args:
            names: of the cameras whose depth is wanted.
            images: what each camera sees, RGB uint8 (H, W, 3), at least of those `needed`.

        Returns:
            Depth of each; on the device where IterMVS finds it, which may still be computing.

        Raises:
            DepthError: a picture that is missing or does not fit its camera.
        """
        needed = self.needed(names)
        pictures = {
            name: as_image8(images.get(name), self._cameras[name], DepthError) for name in needed
        }
        if self.options.matcher.batch:
            at = {name: index for index, name in enumerate(needed)}
            matched = [
                tuple(at[camera] for camera in (name, *self.partners(name))) for name in names
            ]
            device_maps = self._batch.estimate(
                [self._cameras[name] for name in needed], matched, list(pictures.values())
            )
            return {
                name: DeviceDepth(*device_map)
                for name, device_map in zip(names, device_maps, strict=True)
            }
        maps = dict(zip(names, self._found_here(names, pictures), strict=True))
        return (
            maps
            if not self.options.consistency or len(names) == 1
            else {name: self._checked(name, maps) for name in maps}
        )

    def _found_here(self, names: Sequence[str], pictures: Mapping[str, Image8]) -> list[DepthMap]:
        """Return the maps as the CPU's matchers find them, finished."""
        if self.options.matcher.rig:
            if (key := tuple(names)) not in self._rigs:
                matched = [(name, *self.partners(name)) for name in names]
                cameras = [self._cameras[name] for name in self.needed(names)]
                # the last alone
                self._rigs = {key: self.options.matcher.rig(cameras, matched, ERROR_PX)}
            return [
                finish(depth_map, self.options) for depth_map in self._rigs[key].estimate(pictures)
            ]
        for name in names:
            if name not in self._estimators:
                partners = [self._cameras[partner] for partner in self.partners(name)]
                self._estimators[name] = DepthEstimator(self._cameras[name], partners, self.options)
        inputs = ((name, [pictures[partner] for partner in self.partners(name)]) for name in names)
        return [
            self._estimators[name].estimate(pictures[name], partner_images)
            for name, partner_images in inputs
        ]

    def _checked(self, name: str, maps: Mapping[str, DepthMap]) -> DepthMap:
        """Return a map after its check against those of the other sources."""
        views = [
            (self._cameras[partner], depth_map)
            for partner, depth_map in maps.items()
            if partner != name
        ]
        return check_depth(self._cameras[name], maps[name], views, self.options)
