"""Copies of captured frames among the rendered ones: bit by bit, in each patch, or by their sensor
noise.

The noise of the truth is its fingerprint: no method can guess it, so a rendering that has it took
it from the truth.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import cv2
import numpy as np

from ggvs_eval.arrays import Array32, Image8
from ggvs_eval.files.images import mean_of_channels
from ggvs_eval.finding import Finding, Verdict, verdict_of
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames, named_frames, spread
from ggvs_eval.scoring import FrameReader

FineReader = Callable[[int], Array32]
# The middle of a large picture says as much as is needed.
CROP_PX = 640
CELL_PX = 16
# The cells that change most move, and are left out: what moves within a cell is in a good rendering
# too.
STEADY_SHARE = 0.5
QUESTION = "truth copied in"
# Instants of a clip from which the noise is estimated.
NOISE_INSTANTS = 48
# Share of the truth: 0.01 at most in honest renders of several methods, 0.05 in a perfect one
# without noise, where the scene changes within a cell; 0.06 and more, by 12 and more standard
# errors, where a tenth is blended in. It is less well known of a single frame. Below NO_COPY
# nothing was copied.
LEAST_SHARE, CERTAIN_SHARE, LEAST_DEVIATIONS, NO_COPY = 0.05, 0.07, 10.0, 0.2
FRAME_SHARE, FRAME_DEVIATIONS = 0.3, 8.0
# White share of the noise of a coded static scene, as codecs repeat a frame's noise in the next
# one: 0.7 at crf 12.
WHITE_SHARE, NOISE_DEVIATIONS = 0.65, 2.0
# Without noise to compare (codecs take it out): a rendering fails somewhere, a copy nowhere.
# Correlation of fine detail in the worst twentieth of the textured patches: 0.5 for a rendering of
# 24 dB, 0.82 for ghosted truth,
# 0.98 for JPEG of quality 80.
WORST_SHARE, SUSPICIOUS_CORRELATION, USUAL_CORRELATION = 0.05, 0.97, 0.9
# Errors of depth and poses grow with the picture, patches do not: in the worst patches of five
# rooms no rendering fitted better than the truth displaced by 1/640 of the width does. A third of
# its misfit is no rendering's.
DISPLACED_WIDTHS, SUSPICIOUS_MISFIT = 1 / 640, 1 / 3
# Frames that are looked at together.
WINDOW = 8
TEXTURE_255, FEWEST_PATCHES = 3.0, 20


@dataclass(frozen=True)
class TruthShare:
    """Share of the captured frames' noise in their rendering.

    Attributes:
        share: 1 for a copy, the weight of the truth in a blend, 0 for a rendering.
        error: standard error of `share`; infinite where the truth has no noise.
        motion: share that a perfect rendering can have, as changes of the scene pass for noise, 0
            to 1; small pictures of moving scenes have much of it.
    """

    share: float
    error: float
    motion: float

    @property
    def excess(self) -> float:
        """Share that no rendering can have."""
        return self.share - self.motion

    @property
    def deviations(self) -> float:
        """The excess in its standard errors."""
        return self.excess / max(self.error, 1e-9)

    @property
    def reveals_copies(self) -> bool:
        """Return whether a copy would be noticed."""
        return 1 - self.motion > LEAST_DEVIATIONS * self.error

    @property
    def most(self) -> float:
        """Upper bound that the share hardly exceeds."""
        return self.share + 5 * self.error


@dataclass(frozen=True)
class Fit:
    """Fit of a rendered frame where it is worst.

    Attributes:
        correlation: of fine detail in the worst of the textured patches.
        displaced_misfit: 1 - correlation of the truth that is displaced by what any rendering errs
            by.
    """

    correlation: float
    displaced_misfit: float

    @property
    def reveals_copies(self) -> bool:
        """Return whether a rendering would fit worse than a copy."""
        return SUSPICIOUS_MISFIT * self.displaced_misfit > 1 - SUSPICIOUS_CORRELATION


@dataclass(frozen=True, eq=False)
class NoiseSums:
    """Products with the truth's noise, summed over each cell of an instant, (cells,).

    Attributes:
        captured: of the captured frame; its noise, and what changes of the scene pass for noise.
        rendered: of the rendered frame.
        noise: of the noise of the neighbouring instants, as it would be of the captured frame if
            that had nothing but noise.
    """

    captured: Array32
    rendered: Array32
    noise: Array32


def pooled_share(instants: Iterable[NoiseSums]) -> TruthShare:
    """Return the ratio of the sums over some instants.

    The scatter of the cells gives its uncertainty.
    """
    sums = list(instants)
    captured, rendered, noise = (
        np.concatenate([np.zeros(0), *(getattr(instant, part) for instant in sums)])
        for part in ("captured", "rendered", "noise")
    )
    total = float(captured.sum())
    if total <= NOISE_DEVIATIONS * np.sqrt(np.square(captured).sum()):
        return TruthShare(share=0.0, error=np.inf, motion=0.0)
    share, white = (float(values.sum()) / total for values in (rendered, noise))
    errors = [
        float(np.sqrt(np.square(values - ratio * captured).sum())) / total
        for values, ratio in ((rendered, share), (noise, white))
    ]
    least_noise = (white - NOISE_DEVIATIONS * errors[1]) / WHITE_SHARE
    return TruthShare(share=share, error=errors[0], motion=float(np.clip(1 - least_noise, 0, 1)))


def noise_sums(view: ViewFrames, rendered: FineReader, truth: FineReader, index: int) -> NoiseSums:
    """Sum products of an instant's captured and rendered frame with the noise of the captured one.

    The noise n is what the captured frame has beyond its neighbours' mean, brightness and a shift
    fitted to each cell, so that neither lights nor slow motion count. A rendering r = (1 - a) r0 +
    a c of the captured frame c has <r, n> = a <c, n> where the method's own r0 knows nothing of n:
    n is an instrument (in the sense of econometrics) for a. Both r and c are taken beyond the mean
    of the frames two instants away, whose noise is not in n, so that static content does not drown
    it. Cells in which the rendering changes much, on its own account, count less.

    Noise differs from the scene's changes by its covariance with that of a neighbouring instant,
    computed in the same way: white noise of variance v has -v there, as it is in both means with
    the other sign, and smooth changes have nothing or more.

    Args:
        rendered: fine detail of its rendered frames, as `_fine` gives it; so `truth` of the
            captured ones.
        index: frame number of which `has_far_frames` holds; two to either side make the answer
            sharp.
    """
    near, far = (_beside(view, index, lag) for lag in (1, 2))
    around = _mean(truth, near)
    design = _design(around)
    noise = _beyond(truth(index) - around, design)
    truth_residual, rendered_residual = (
        _beyond(read(index) - _mean(read, far), design) for read in (truth, rendered)
    )
    beside = [
        _beyond(truth(neighbour) - _mean(truth, (index, 2 * neighbour - index)), design)
        for neighbour in near
        if 2 * neighbour - index in far
    ]
    energy, rendered_energy = (np.square(image).sum(axis=1) for image in (noise, rendered_residual))
    steady = energy <= np.quantile(energy, STEADY_SHARE)
    weights = 1 / (rendered_energy + np.median(rendered_energy) + 1)
    return NoiseSums(
        *(
            (weights * (image * noise).sum(axis=1))[steady]
            for image in (truth_residual, rendered_residual, -np.mean(beside, axis=0))
        )
    )


def has_far_frames(view: ViewFrames, index: int) -> bool:
    """Return whether a frame is two instants away.

    Without one static content would count as noise.
    """
    return bool(_beside(view, index, 2))


def _beside(view: ViewFrames, index: int, lag: int) -> list[int]:
    return [instant for instant in (index - lag, index + lag) if instant in view.frames]


def _mean(read: FineReader, indices: Sequence[int]) -> Array32:
    return (
        np.mean([read(index) for index in indices], axis=0) if indices else np.zeros((), np.float32)
    )


def _fine(read: FrameReader, index: int) -> Array32:
    """Fine detail of the mean of the channels, in the middle of the picture, whole cells of it."""
    image = read(index)
    top, left = (max(size - CROP_PX, 0) // 2 for size in image.shape[:2])
    height, width = (min(size, CROP_PX) // CELL_PX * CELL_PX for size in image.shape[:2])
    grey = mean_of_channels(image[top : top + height, left : left + width])
    return np.asarray(grey - cv2.blur(grey, (5, 5)), dtype=np.float32)


def _cells(image: Array32) -> Array32:
    """Whole squares of a picture, (cells, pixels)."""
    rows, columns = (size // CELL_PX for size in image.shape)
    squares = (
        image[: rows * CELL_PX, : columns * CELL_PX]
        .reshape(rows, CELL_PX, columns, CELL_PX)
        .swapaxes(1, 2)
    )
    return squares.reshape(rows * columns, CELL_PX**2)


def _design(image: Array32) -> Array32:
    """Orthonormal changes of each cell by brightness and shift, (cells, pixels, 4)."""
    slopes = (cv2.Sobel(image, cv2.CV_32F, dx, dy, ksize=3) for dx, dy in ((1, 0), (0, 1)))
    parts = np.stack([_cells(part) for part in (np.ones_like(image), image, *slopes)], axis=-1)
    return np.linalg.qr(parts)[0]


def _beyond(image: Array32, design: Array32) -> Array32:
    """Return the cells without what the changes of a design explain."""
    cells = _cells(image)
    return cells - np.einsum("cpk,ck->cp", design, np.einsum("cpk,cp->ck", design, cells))


def find_copied(name: str, view: ViewFrames) -> list[Finding]:
    """Look for frames that are copies, each compared with the others, and for a share of the truth
    in all others.

    Returns:
        Findings; the only one is "unknown" where a copy looks like a rendering.
    """
    view = replace(
        view, rendered=lru_cache(WINDOW)(view.rendered), truth=lru_cache(WINDOW)(view.truth)
    )
    fits: dict[int, Fit] = {}
    identical: list[int] = []
    for index, (rendered, truth) in zip(view.frames, view.pairs(list(view.frames)), strict=True):
        fit = worst_patches(rendered, truth)
        if np.array_equal(rendered, truth):
            identical.append(index)
        elif fit is not None:
            fits[index] = fit
    instants = [
        index for index in spread(view.frames, NOISE_INSTANTS) if has_far_frames(view, index)
    ]
    rendered_fine, truth_fine = (
        lru_cache(WINDOW)(partial(_fine, read)) for read in (view.rendered, view.truth)
    )
    noise = {
        index: noise_sums(view, rendered_fine, truth_fine, index)
        for index in instants
        if index not in identical
    }
    copies = _written_again(fits, noise)
    findings = [
        *(
            [
                _finding(
                    name,
                    "certain",
                    f"{_named(identical, view)} captured, bit by bit",
                    {"n_frames": len(identical)},
                )
            ]
            if identical
            else []
        ),
        *_copies(name, view, copies, fits, [noise[index] for index in copies if index in noise]),
        *_blend(name, [sums for index, sums in noise.items() if index not in copies]),
    ]
    if (
        findings
        or pooled_share(noise.values()).reveals_copies
        or any(fit.reveals_copies for fit in fits.values())
    ):
        return findings
    reason = "too few pixels, texture and sensor noise to tell a copy from a rendering"
    return [
        Finding(
            subject=name,
            question=QUESTION,
            verdict="unknown",
            measured=reason,
            values={},
            advice="ask frames of a larger size",
        )
    ]


def _written_again(fits: Mapping[int, Fit], noise: Mapping[int, NoiseSums]) -> list[int]:
    """Return the frames that fit everywhere, all alike or much better than others, and those with
    much more of the truth's noise.

    What fits but has nothing of that noise is a very good rendering.
    """
    shares = {index: pooled_share([sums]) for index, sums in noise.items()}
    usual = float(np.median([share.excess for share in shares.values()])) if shares else 0.0
    misfit = 1 - float(np.median([fit.correlation for fit in fits.values()] or [0.0]))
    displaced_misfit = float(np.median([fit.displaced_misfit for fit in fits.values()] or [0.0]))
    most = 1 - SUSPICIOUS_CORRELATION
    are_alike = misfit < min(most, SUSPICIOUS_MISFIT * displaced_misfit)
    most = most if are_alike else min(most, SUSPICIOUS_MISFIT * misfit)
    close = {index for index, fit in fits.items() if 1 - fit.correlation < most}
    close -= {index for index in close if index in shares and shares[index].most < NO_COPY}
    least = max(FRAME_SHARE, 2 * usual)
    noisy = {
        index
        for index, share in shares.items()
        if share.excess > least and share.deviations > FRAME_DEVIATIONS
    }
    return sorted(close | noisy)


def _copies(
    name: str,
    view: ViewFrames,
    copies: Sequence[int],
    fits: Mapping[int, Fit],
    noise: Sequence[NoiseSums],
) -> list[Finding]:
    """Return the frames that are hardly anything else.

    Proved by their noise, or by the other frames that are not like them.
    """
    if not copies:
        return []
    least, other_fits = (
        [fit.correlation for index, fit in fits.items() if (index in copies) == is_written]
        for is_written in (True, False)
    )
    share = pooled_share(noise)
    values: dict[str, float] = {"n_frames": len(copies), "share": share.share}
    text = f"{_named(copies, view)} captured, written again"
    if least:
        values |= {
            "worst_patches": min(least),
            "worst_patches_others": float(np.median(other_fits or [1.0])),
        }
        text += f": fine detail correlates {values['worst_patches']:.3f} in the worst patches"
        text += f", {values['worst_patches_others']:.2f} in the other frames" if other_fits else ""
    text += (
        f"; they have {100 * share.share:.0f} % of its noise"
        if share.deviations > LEAST_DEVIATIONS
        else ""
    )
    is_proved = share.excess > CERTAIN_SHARE and share.deviations > LEAST_DEVIATIONS
    is_unlike = bool(least) and values["worst_patches_others"] < USUAL_CORRELATION
    return [_finding(name, verdict_of(is_proved or is_unlike), text, values)]


def _blend(name: str, noise: Sequence[NoiseSums]) -> list[Finding]:
    """Return a share of the truth in all frames that are no copies."""
    share = pooled_share(noise)
    if share.excess < LEAST_SHARE or share.deviations < LEAST_DEVIATIONS:
        return []
    text = (
        f"{100 * share.share:.0f} % of the truth's sensor noise is in the rendering, "
        f"{share.deviations:.0f} standard errors from none: the reference was blended in, or "
        "copied and changed"
    )
    return [
        _finding(
            name,
            verdict_of(share.excess > CERTAIN_SHARE),
            text,
            {"share": share.share, "share_error": share.error},
        )
    ]


def _named(frames: Sequence[int], view: ViewFrames) -> str:
    return (
        f"{'all frames are' if len(frames) == len(view.frames) else named_frames(list(frames))} as"
    )


def worst_patches(rendered: Image8, truth: Image8) -> Fit | None:
    """Compare the fine detail of textured patches; None where too few have texture."""
    rendered_grey, truth_grey = (mean_of_channels(image) for image in (rendered, truth))
    whole_px, part_px = divmod(DISPLACED_WIDTHS * truth.shape[1], 1)
    near, far = (np.roll(truth_grey, int(whole_px) + step, axis=1) for step in (0, 1))
    patches = [
        _patches(grey) for grey in (truth_grey, rendered_grey, (1 - part_px) * near + part_px * far)
    ]
    textured = patches[0].std(axis=1) > TEXTURE_255
    if np.count_nonzero(textured) < FEWEST_PATCHES:
        return None
    reference, *compared = (flat[textured] for flat in patches)
    worst = []
    for flat in compared:
        energy = np.sqrt(np.square(flat).sum(axis=1) * np.square(reference).sum(axis=1)) + 1e-6
        worst.append(float(np.quantile((flat * reference).sum(axis=1) / energy, WORST_SHARE)))
    return Fit(correlation=worst[0], displaced_misfit=1 - worst[1])


def _patches(grey: Array32) -> Array32:
    """Fine detail of a picture in squares, each without its mean, (patches, pixels)."""
    flat = _cells(
        np.asarray(
            cv2.GaussianBlur(grey, (0, 0), 0.8) - cv2.GaussianBlur(grey, (0, 0), 3.0), np.float32
        )
    )
    return np.asarray(flat - flat.mean(axis=1, keepdims=True), dtype=np.float32)


def _finding(name: str, verdict: Verdict, text: str, values: Mapping[str, float]) -> Finding:
    advice = (
        "exclude the test view from the method's inputs; are reference and render folders swapped?"
    )
    return Finding(
        subject=name,
        question=QUESTION,
        verdict=verdict,
        measured=text,
        values=values,
        advice=advice,
    )
