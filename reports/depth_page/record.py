"""Record of the depth page, kept beside it in ``index.json``."""

from dataclasses import dataclass

from ggvs_eval.depth_store import DepthJob
from ggvs_eval.reports.depth_page.pairs import PairErrors
from ggvs_eval.reports.depth_page.pictures import InstantPictures, PictureOfPair
from ggvs_eval.reports.depth_page.statistics import DepthStatistics


@dataclass(frozen=True)
class StoredDepth:
    """Depth maps of one job that are looked at.

    Attributes:
        job: the camera and the partners it was matched with.
        frames: instants to look at, ascending; the first one's features tell about the calibration.
        registration: what was done to a sensor's depth, in words; empty where nothing was.
    """

    job: DepthJob
    frames: tuple[int, ...]
    registration: str = ""

    @property
    def key(self) -> str:
        """Of the depth store."""
        return self.job.key


@dataclass(frozen=True)
class CameraPictures:
    """All pictures of one camera.

    Attributes:
        partners: of the job that is pictured; where a camera has several, the one that measured least.
        depth_range: nearest and farthest depth of the colours, world units.
        again_from: the camera that images are made again from, the nearest partner; empty where there is none.
        pairs: one per partner that the camera can be rectified with.
    """

    partners: tuple[str, ...]
    depth_range: tuple[float, float]
    again_from: str
    instants: tuple[InstantPictures, ...]
    pairs: tuple[PictureOfPair, ...]


@dataclass(frozen=True)
class CameraRecord:
    """One source camera.

    Attributes:
        jobs: every job that computed its depth, with what came out at each instant.
    """

    name: str
    jobs: tuple[tuple[StoredDepth, tuple[DepthStatistics, ...]], ...]
    pictures: CameraPictures

    def label(self, stored: StoredDepth) -> str:
        """The camera's name, with the partners where it has several jobs."""
        return self.name if len(self.jobs) == 1 else f"{self.name} with {', '.join(stored.job.partner_names)}"


@dataclass(frozen=True)
class DepthRecord:
    """Everything on the page.

    Attributes:
        units_origin: where that number comes from.
        cameras: source cameras in the order of the capture.
        pairs: every pair of a camera and a partner, measured at the first instant.
        unmatched: cameras of the capture that no camera is matched with.
        registrations: what was done to sensor depth before it was used, in words.
    """

    scene: str
    units_per_metre: float
    units_origin: str
    cameras: tuple[CameraRecord, ...]
    pairs: tuple[PairErrors, ...]
    unmatched: tuple[str, ...]
    registrations: tuple[str, ...] = ()

    def pair(self, camera: str, partner: str) -> PairErrors:
        """The errors of two cameras, in whichever order they were measured."""
        return next(pair for pair in self.pairs if {pair.camera, pair.partner} == {camera, partner})

    @property
    def frames(self) -> tuple[int, ...]:
        """All instants that are shown."""
        return tuple(sorted({frame for camera in self.cameras for stored, _ in camera.jobs for frame in stored.frames}))
