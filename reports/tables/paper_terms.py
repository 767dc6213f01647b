"""On which terms the paper measured each data set, and where a run departs from them."""

from dataclasses import dataclass
from typing import Any

from ggvs_eval.datasets.units import DEMO_NOTES
from ggvs_eval.files.images import read_image
from ggvs_eval.reports.model.measured import MeasuredRun
from ggvs_eval.reports.tables.published import read_published
from ggvs_eval.run_folder import frame_path


@dataclass(frozen=True)
class PaperTerms:
    """What the paper says of its protocol on one data set.

    Attributes:
        dataset: name in its tables.
        scenes: names of the scenes; empty where it names none.
        layouts: in which the data set lies on disk.
        test_views: how many; it does not say which.
        k: number of source views.
        frames: number of instants.
        size: width and height of the rendered images, pixels.
        metric_size: width and height at which is measured.
    """

    dataset: str
    scenes: tuple[str, ...]
    layouts: tuple[str, ...]
    test_views: int
    k: int
    frames: int
    size: tuple[int, int]
    metric_size: tuple[int, int]

    def relation(self, run: MeasuredRun) -> str:
        """How a run belongs to this data set: ``whole`` by its name, ``part`` of it (``DyNeRF, one instant``), or ``other``."""
        name, wanted = run.protocol.dataset.lower(), self.dataset.lower()
        if is_demo(run.folder.capture_record()):
            return "other"
        return "whole" if name == wanted else "part" if name.startswith(f"{wanted},") else "other"

    def departures(self, run: MeasuredRun) -> tuple[str, ...]:
        """Where a run is not what the paper did, in words; empty where it is, as far as the paper says what it did."""
        capture, protocol = run.folder.capture_record(), run.protocol
        size, layout = rendered_size(run), capture.get("layout", "unknown")
        measured = (protocol.measurement.width, protocol.measurement.height) if protocol.measurement.width else size
        views, frames = len(protocol.views.test), protocol.frames.count
        scenes = " and ".join(self.scenes)
        found = {
            f"layout {layout}, not {' or '.join(self.layouts)}": layout not in self.layouts,
            f"scene {run.scene}, not {scenes}": bool(self.scenes) and run.scene not in self.scenes,
            f"{_count(frames, 'frame')}, not {self.frames}": frames != self.frames,
            f"{_count(views, 'test view')}, not {self.test_views}": views != self.test_views,
            f"K = {protocol.synthesis.k}, not {self.k}": protocol.synthesis.k != self.k,
            "source views chosen by coverage, not the nearest": protocol.synthesis.sources != "nearest",
            f"{_size(size)} pixels, not {_size(self.size)}": size != self.size,
            f"measured at {_size(measured)}, not {_size(self.metric_size)}": size == self.size and measured != self.metric_size,
            "a frame held still or noise added": bool(capture.get("edit")),
        }
        return tuple(words for words, applies in found.items() if applies)

    def missing_scenes(self, scenes: set[str]) -> tuple[str, ...]:
        """Scenes of the paper that are not among these."""
        return tuple(scene for scene in self.scenes if scene not in scenes)


def read_terms(dataset: str) -> PaperTerms:
    """The terms of one of the paper's data sets, see ``data/protocol.csv``."""
    published = read_published("protocol")
    values = published["all"]["protocol"] | published[dataset]["protocol"]
    width, height = int(values["render_width"]), int(values["render_height"])
    return PaperTerms(
        dataset,
        tuple(values.get("scenes", "").split()),
        tuple(values["layouts"].split()),
        int(values["test_views"]),
        int(values["K"]),
        int(values["frames"]),
        (width, height),
        (int(values.get("metric_width", width)), int(values.get("metric_height", height))),
    )


def is_demo(capture: dict[str, Any]) -> bool:
    """Whether a capture was written by ``ggvs-eval demo``, in whatever layout and under whatever name."""
    return capture.get("units_origin") == DEMO_NOTES


def rendered_size(run: MeasuredRun) -> tuple[int, int]:
    """Width and height of the run's images: the protocol's, or those of a captured frame where it keeps the capture's."""
    synthesis = run.protocol.synthesis
    if synthesis.width:
        return synthesis.width, synthesis.height
    height, width = read_image(frame_path(run.folder.truth(run.protocol.views.test[0]), run.frames[0])).shape[:2]
    return width, height


def _size(size: tuple[int, int]) -> str:
    return f"{size[0]} × {size[1]}"


def _count(number: int, noun: str) -> str:
    return f"{number} {noun}{'' if number == 1 else 's'}"
