"""The views of one instant of a capture as a method is shown them, with the depth of a sensor or of stereo."""

from collections.abc import Sequence

from ggvs_eval.arrays import Image8
from ggvs_eval.camera import Camera
from ggvs_eval.capture import Capture, DepthSource
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions, check_depth, check_measured_depth
from ggvs_eval.pipelines.offline.sensor.sensor_depth import SensorDepthEstimator


class SampleMaker:
    """Views of one instant of a capture, depth as `prepare` makes it; what several targets share is computed once.

    Args:
        options: how depth is computed by a matcher, or filtered where the camera has a sensor. The target takes no part in it.
    """

    def __init__(self, capture: Capture, options: DepthOptions, frame: int = 0) -> None:
        self.capture = capture
        self._options = options
        self._frame = frame
        self._images: dict[str, Image8] = {}
        self._depths: dict[tuple[str, ...], DepthMap] = {}

    def instant(self, target: Camera, sources: Sequence[Camera]) -> Instant:
        """Return what a method is shown of a target and its K source cameras, the target none of them."""
        depths = [(source, self._depth(source, target)) for source in sources]
        views = tuple(self._view(source, depth, depths[:k] + depths[k + 1 :]) for k, (source, depth) in enumerate(depths))
        return Instant(self._frame, target, views, self.capture.units_per_metre)

    def image(self, camera: Camera) -> Image8:
        """Return the image that a camera took."""
        if camera.name not in self._images:
            self._images[camera.name] = self.capture.frame(camera.name, self._frame)
        return self._images[camera.name]

    def _depth(self, source: Camera, target: Camera) -> DepthMap:
        """Depth of a source camera, measured or found without the target."""
        sensor = self._sensor(source)
        partners = [] if sensor else self._options.choose_partners(source, self.capture.cameras, {target.name})
        key = (source.name, *(partner.name for partner in partners))
        if key not in self._depths:
            if sensor is not None and self._options.sensor is not None:
                measured = SensorDepthEstimator(source, sensor, self._options.sensor)
                self._depths[key] = measured.at(self._frame, self.image(source))
            else:
                estimator = DepthEstimator(source, partners, self._options)
                self._depths[key] = estimator.estimate(self.image(source), [self.image(partner) for partner in partners])
        return self._depths[key]

    def _view(self, source: Camera, depth_map: DepthMap, others: Sequence[tuple[Camera, DepthMap]]) -> SourceView:
        """A source, its depth held against that of the others, as it is prepared for a view."""
        image = self.image(source)
        if self._sensor(source) is None:
            checked = check_depth(source, depth_map, others, self._options)
        else:
            checked = check_measured_depth(source, image, depth_map, others, self._options)
        return SourceView(source, image, checked.depth, checked.confidence)

    def _sensor(self, source: Camera) -> DepthSource | None:
        return None if self._options.sensor is None else self.capture.extras_of(source.name).depth
