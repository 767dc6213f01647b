"""Identity of a rendered picture: the captured one that it shows, of which camera, mirrored or not.

Frames of a view, rendered and captured, are read on request.
"""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.coverage import frame_reader
from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import mean_of_channels
from ggvs_eval.finding import Finding, verdict_of
from ggvs_eval.run_folder import RunFolder, as_ranges, missing_frames, require_frames
from ggvs_eval.scoring import FrameReader
from ggvs_eval.transforms import mirrored

# Everything but registration and coding is decided on pictures of this size, so that a dozen of
# them are a few megabytes.
SMALL_SIDE_PX = 192
LARGEST_OFFSET = 8
INSTANTS = 4
MIRRORS = {
    "as it is": (),
    "left and right swapped": (1,),
    "upside down": (0,),
    "turned by 180 degrees": (0, 1),
}
# Structure left unexplained, 1 - correlation, relative to the view's own upright picture. Blur,
# ghosts and casts spoil both hypotheses alike; honest renders of 18 dB had 1.7 or more here,
# pictures of the wrong camera 0.6 or less.
CERTAIN_RATIO, LIKELY_RATIO = 0.6, 0.8
# A shift by some pixels leaves 0.35 of the own picture's mirror image; other pictures have 0.1.
LEAST_CORRELATION = 0.3


@dataclass(frozen=True)
class ViewFrames:
    """One view: rendered and captured frames by their number.

    Attributes:
        rendered: frame number -> rendered frame, (H, W, 3) uint8 RGB.
        truth: frame number -> captured frame of the same view, (H, W, 3) uint8 RGB.
        frames: numbers of the rendered frames, in order.
        truth_frames: numbers that `truth` can give, where these are more than `frames`; offsets at
            the ends need them.
    """

    rendered: FrameReader
    truth: FrameReader
    frames: range
    truth_frames: range | None = None

    def __post_init__(self) -> None:
        """Refuse a view without frames."""
        if len(self.frames) == 0:
            raise RenderError("a view without frames; render it first")

    @property
    def truth_range(self) -> range:
        """Numbers of the captured frames that can be read."""
        return self.truth_frames or self.frames

    def pairs(self, indices: list[int]) -> Iterator[tuple[Image8, Image8]]:
        """Rendered and captured frame of some instants, one by one."""
        return ((self.rendered(index), self.truth(index)) for index in indices)

    def with_rendered(self, change: Callable[[Image8], Image8]) -> "ViewFrames":
        """Return the same view with every rendered frame changed."""
        original = self.rendered
        return replace(self, rendered=lambda index: change(original(index)))

    def with_truth(self, truth: FrameReader) -> "ViewFrames":
        """Return the same renders with another camera's frames."""
        return replace(self, truth=truth)

    def moved(self, offset: int) -> "ViewFrames":
        """Return the same renders as frames of the instants `offset` later, as far as the truth has
        them.
        """
        original, captured = self.rendered, self.truth_range
        instants = [index for index in self.frames if index + offset in captured]
        frames = range(instants[0] + offset, instants[-1] + offset + 1)
        return replace(self, rendered=lambda index: original(index - offset), frames=frames)

    def reversed(self, offset: int) -> "ViewFrames":
        """Return the same renders in reversed order, as frames of instants `offset` later, as far
        as the truth has them.
        """
        original, turning = self.rendered, self.frames.start + self.frames[-1]
        instants = sorted(
            turning - index + offset
            for index in self.frames
            if turning - index + offset in self.truth_range
        )
        return replace(
            self,
            rendered=lambda index: original(turning - index + offset),
            frames=range(instants[0], instants[-1] + 1),
        )


@dataclass(frozen=True, eq=False)
class Sample:
    """A burst of neighbouring instants at small size.

    Attributes:
        indices: frame numbers of the rendered frames.
        rendered: small rendered frames, (n, h, w, 3) float32 on the scale 0..255.
        truth_indices: frame numbers of the captured frames, `LARGEST_OFFSET` more at either end if
            there are any.
        truth: small captured frames, (m, h, w, 3) float32 on the scale 0..255.
    """

    indices: range
    rendered: Array32
    truth_indices: range
    truth: Array32

    @property
    def truth_now(self) -> Array32:
        """The captured frames of the same instants, (n, h, w, 3)."""
        first = self.indices.start - self.truth_indices.start
        return self.truth[first : first + len(self.indices)]


def take_sample(view: ViewFrames, count: int) -> Sample:
    """Read a burst out of the middle of a view, one full-sized frame in memory at a time."""
    indices, captured = middle_of(view.frames, count), view.truth_range
    around = range(
        max(captured.start, indices.start - LARGEST_OFFSET),
        min(captured.stop, indices.stop + LARGEST_OFFSET),
    )
    rendered = np.stack([shrink(view.rendered(index)) for index in indices])
    return Sample(
        indices=indices,
        rendered=rendered,
        truth_indices=around,
        truth=np.stack([shrink(view.truth(index)) for index in around]),
    )


def shrink(image: Image8, longest_side_px: int = SMALL_SIDE_PX) -> Array32:
    """Return a picture reduced by box averages to a longest side, float32 on the scale 0..255.

    Small ones stay as they are.
    """
    height, width = image.shape[:2]
    factor = longest_side_px / max(height, width)
    pixels = image.astype(np.float32)
    if factor >= 1:
        return pixels
    size = max(round(width * factor), 1), max(round(height * factor), 1)
    return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.float32)


def spread(indices: range, count: int) -> list[int]:
    """At most `count` numbers, evenly over a range."""
    positions = np.linspace(0, len(indices) - 1, min(count, len(indices)))
    return [indices[round(position)] for position in positions]


def middle_of(indices: range, count: int) -> range:
    """At most `count` numbers in a row, from the middle of a range."""
    start = indices.start + max(len(indices) - count, 0) // 2
    return range(start, min(start + count, indices.stop))


def longest_run(indices: list[int]) -> range:
    """Return the longest run of consecutive numbers, which is what can be compared over time."""
    longest, start = range(0), 0
    for end in range(1, len(indices) + 1):
        if end == len(indices) or indices[end] != indices[end - 1] + 1:
            longest = max(longest, range(indices[start], indices[end - 1] + 1), key=len)
            start = end
    return longest


def views_of_run(run: RunFolder, label: str, as_measured: bool = False) -> dict[str, ViewFrames]:
    """Rendered and captured frames of one method in every test view.

    Args:
        label: ``method`` or ``method+variant``.
        as_measured: at the size at which the protocol measures frames; else as they are there.
    """
    if label not in run.labels():
        raise RenderError(
            f"{run.root}: no renders of {label!r}; there are {', '.join(run.labels()) or 'none'}"
        )
    protocol = run.protocol()
    frames = protocol.frames.numbers
    require_frames(
        {f"{label} in {view}": run.renders(label, view) for view in protocol.views.test}, frames
    )
    require_frames({f"truth of {view}": run.truth(view) for view in protocol.views.test}, frames)
    measurement = protocol.measurement if as_measured else None
    return {
        view: ViewFrames(
            frame_reader(run.renders(label, view), measurement),
            frame_reader(run.truth(view), measurement),
            frames,
        )
        for view in protocol.views.test
    }


def views_there(run: RunFolder, label: str) -> tuple[dict[str, ViewFrames], list[Finding]]:
    """Return the views of renders that may be incomplete, each with its longest run of frames, and
    what is missing.
    """
    frames = run.protocol().frames.numbers
    views: dict[str, ViewFrames] = {}
    findings: list[Finding] = []
    for view in run.protocol().views.test:
        require_frames({f"truth of {view}": run.truth(view)}, frames)
        lacking = missing_frames(run.renders(label, view), frames)
        if stretch := longest_run([index for index in frames if index not in set(lacking)]):
            views[view] = ViewFrames(
                rendered=frame_reader(run.renders(label, view)),
                truth=frame_reader(run.truth(view)),
                frames=stretch,
                truth_frames=frames,
            )
        if lacking:
            text = f"lacks {as_ranges(lacking)}; " + (
                f"only {as_ranges(list(stretch))} examined" if stretch else "no frame"
            )
            findings.append(
                Finding(
                    subject=view,
                    question="missing frames",
                    verdict="certain",
                    measured=text,
                    values={"n_frames": len(lacking)},
                    advice="render these too",
                )
            )
    return views, findings


def named_frames(frames: list[int]) -> str:
    """Return frames as the beginning of a sentence."""
    return f"frame {frames[0]} is" if len(frames) == 1 else f"frames {as_ranges(frames)} are"


def cameras_of_run(run: RunFolder) -> dict[str, FrameReader]:
    """Return the captured frames of every camera whose truth the run folder holds whole, source
    cameras among them.
    """
    protocol = run.protocol()
    frames = protocol.frames.numbers
    root = run.root / "truth"
    folders = (
        sorted(folder for folder in root.iterdir() if folder.is_dir()) if root.is_dir() else []
    )
    return {
        folder.name: frame_reader(folder)
        for folder in folders
        if not missing_frames(folder, frames)
    }


@dataclass(frozen=True)
class CameraPictures:
    """Captured frames of one camera.

    Attributes:
        read: frame number -> frame at full size.
        outlines: frame number -> `structure` of the frame at small size; keeps the last few.
    """

    read: FrameReader
    outlines: Callable[[int], Array32]


def remember(read: FrameReader) -> CameraPictures:
    """Return a camera whose pictures are compared with every view at the same few instants."""
    return CameraPictures(
        read, lru_cache(maxsize=INSTANTS)(lambda index: structure(shrink(read(index))))
    )


def find_identity(
    name: str, view: ViewFrames, cameras: Mapping[str, CameraPictures]
) -> tuple[list[Finding], ViewFrames]:
    """Compare with every camera's picture and its mirror images.

    Args:
        cameras: captured frames of all cameras, the view's own among them.

    Returns:
        Return the findings, and the view with them corrected.
    """
    instants = spread(view.frames, INSTANTS)
    upright = [structure(shrink(view.rendered(index))) for index in instants]
    scores: dict[tuple[str, str], list[float]] = {}
    for camera, pictures in cameras.items():
        truths = [pictures.outlines(index) for index in instants]
        for mirror, axes in MIRRORS.items():
            pairs = (
                (np.flip(rendered, axes), truth)
                for rendered, truth in zip(upright, truths, strict=True)
            )
            scores[camera, mirror] = [correlation(rendered, truth) for rendered, truth in pairs]
    return _evaluate(name, view, cameras, scores)


def structure(image: Array32) -> Array32:
    """Return the outlines of a picture: mean of the channels, band-passed, (h, w).

    No cast or tone curve undoes them.
    """
    grey = mean_of_channels(image)
    wide_px = max(grey.shape) / 20
    return np.asarray(
        cv2.GaussianBlur(grey, (0, 0), wide_px / 12) - cv2.GaussianBlur(grey, (0, 0), wide_px),
        dtype=np.float32,
    )


def correlation(first: Array32, second: Array32) -> float:
    """Return the normalised correlation of two arrays of one shape.

    0 if they differ in shape or nothing varies.
    """
    if first.shape != second.shape:
        return 0.0
    first, second = first - first.mean(), second - second.mean()
    energy = float(
        np.sqrt((first * first).sum(dtype=np.float64) * (second * second).sum(dtype=np.float64))
    )
    return float((first * second).sum(dtype=np.float64)) / energy if energy > 0 else 0.0


def _evaluate(
    name: str,
    view: ViewFrames,
    cameras: Mapping[str, CameraPictures],
    scores: Mapping[tuple[str, str], list[float]],
) -> tuple[list[Finding], ViewFrames]:
    straight = np.array(scores[name, "as it is"])
    camera, mirror = max(scores, key=lambda key: float(np.mean(scores[key])))
    best = np.array(scores[camera, mirror])
    ratios = (1 - best) / np.maximum(1 - straight, 1e-6)
    # Every instant has to agree: one that does not is a different picture.
    ratio = float(ratios.max())
    if (
        (camera, mirror) == (name, "as it is")
        or ratio > LIKELY_RATIO
        or best.min() < LEAST_CORRELATION
    ):
        return [], view
    verdict = verdict_of(ratio < CERTAIN_RATIO)
    values = {
        "correlation": float(best.mean()),
        "own_correlation": float(straight.mean()),
        "instants": float(len(straight)),
    }
    text = (
        f"structure correlates {best.mean():.2f}, without the change {straight.mean():.2f}, at "
        f"all {len(straight)} instants"
    )
    findings: list[Finding] = []
    if camera != name:
        advice = f"check names and order of the cameras: render {name}, or score these as {camera}"
        findings.append(
            Finding(
                subject=name,
                question="wrong camera",
                verdict=verdict,
                measured=f"shows {camera}: {text}",
                values=values,
                advice=advice,
            )
        )
        view = view.with_truth(cameras[camera].read)
    if axes := MIRRORS[mirror]:
        advice = "flip the frames before writing, or correct the sign of the camera's axes"
        findings.append(
            Finding(
                subject=name,
                question="mirrored",
                verdict=verdict,
                measured=f"{mirror}: {text}",
                values={**values, "axes": axes},
                advice=advice,
            )
        )
        view = view.with_rendered(mirrored({"axes": axes}).inverse)
    return findings, view
