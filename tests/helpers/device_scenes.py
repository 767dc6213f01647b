"""Instants of the demo room that ships, a few small frames with depth by stereo: what the online
step is made for.
"""

from functools import cache

from ggvs_eval.camera import nearest_cameras
from ggvs_eval.datasets import open_capture
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.synthetic.shipped import packed_room

SIZE = (112, 84)
COUNT = 3


@cache
def room_instants() -> list[Instant]:
    """Three instants of one camera's view, by its four nearest; the depth of each by its nearest
    partner, wrong in places.
    """
    capture = open_capture(packed_room("demo")).resized(*SIZE, "area")
    target = capture.camera("cam05")
    cameras = nearest_cameras(target, capture.cameras, 4)
    partners = [nearest_cameras(camera, capture.cameras, 1)[0] for camera in cameras]
    names = {camera.name for camera in (*cameras, *partners)}
    frames = {name: list(capture.frames(name, 0, COUNT)) for name in names}
    estimators = [
        DepthEstimator(*pair, DepthOptions())
        for pair in zip(cameras, ([each] for each in partners), strict=True)
    ]
    instants = []
    for index in range(COUNT):
        views = []
        for camera, partner, estimator in zip(cameras, partners, estimators, strict=True):
            found = estimator.estimate(frames[camera.name][index], [frames[partner.name][index]])
            views.append(
                SourceView(camera, frames[camera.name][index], found.depth, found.confidence)
            )
        instants.append(Instant(index, target, tuple(views), capture.units_per_metre))
    return instants
