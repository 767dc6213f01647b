"""Flicker of a rendering beyond the change of the captured video: signed, and with a companion that
a frozen video cannot win.
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8
from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.inputs import check_pair
from ggvs_eval.metrics.metric import (
    CONSISTENCY,
    ColourMap,
    MetricOptions,
    TruthFrame,
    Value,
    ViewMetric,
)
from ggvs_eval.metrics.noise.blocks import (
    ENERGY_EDGES,
    N_ENERGIES,
    N_LEVELS,
    Field,
    block_means,
    check_frame,
    levels_of,
    static_limit,
)

MIN_BLOCKS = 8


@dataclass(frozen=True)
class Flicker:
    """Change from frame to frame of one rendered view against the captured one.

    Grey levels of 255, RMS over pixels and channels.

    Attributes:
        excess: signed root of (energy of the rendering's change - energy of the scene's change);
            above 0 the rendering flickers, below 0 it is frozen, blurred or smoothed over time; 0
            is ideal. The scene's change is the capture's without noise.
        error: root of the energy by which the rendering's change misses the scene's; 0 is ideal,
            both signs of `excess` raise it, and so does motion at the wrong time or place. No noise
            of the capture is in it.
        on_static: the rendering's change where the scene is static, 0 or more: flicker alone. None
            if nothing is static.
        on_moving: `excess` where the scene moves alone. None if nothing moves.
        with_noise: signed as `excess`, but against the capture's whole change, noise included; 0
            for a second recording.
        noise: the capture's change where the scene is static: its noise. None if nothing is static.
        static_share: share of the blocks that are static.
    """

    excess: float
    error: float
    on_static: float | None
    on_moving: float | None
    with_noise: float
    noise: float | None
    static_share: float
    n_pairs: int


class FlickerMeter:
    """Measures flicker from the frames of a view, one instant at a time; two instants are held.

    Reading:
        Where the capture is static, the scene's change is 0, so all change of the rendering is
        flicker, and the capture's is its noise: no estimate is needed. Where it moves, the energy
        of the noise of still blocks as bright is taken off the capture's. Blocks of 8 x 8 pixels
        are static if their change is in the peak that noise makes in the histogram of changes (of
        all frames so far) and no neighbour moves. Where nothing is static, the noise is assumed to
        be 0. Pixels beyond the last whole block are not measured.
    """

    def __init__(self) -> None:
        self._previous: tuple[Image8, Image8] | None = None
        self._histogram = np.zeros(N_ENERGIES)
        # by brightness: blocks, and the energies of the changes: rendered, true, difference
        self._static, self._moving = np.zeros((N_LEVELS, 4)), np.zeros((N_LEVELS, 4))
        self._pairs = 0

    def add(self, rendered: Image8, truth: Image8) -> None:
        """Take the frames of the next instant, both (H, W, 3) uint8.

        Raises:
            MetricError: not two frames (H, W, 3) uint8 of one size, at least 16 x 16 and as large
                as those before.
        """
        check_pair(rendered, truth)
        check_frame(truth, self._previous[1].shape if self._previous else ())
        previous, self._previous = self._previous, (rendered, truth)
        if previous is None:
            return
        rendered_change, true_change = _change(rendered, previous[0]), _change(truth, previous[1])
        energies = [
            _energy(rendered_change),
            _energy(true_change),
            _energy(cv2.subtract(rendered_change, true_change)),
        ]
        still = self._still(energies[1])
        level = levels_of(block_means(truth).mean(axis=-1))
        for sums, mask in ((self._static, still), (self._moving, ~still)):
            weights: list[NDArray] = [
                np.ones(int(mask.sum())),
                *(energy[mask] for energy in energies),
            ]
            sums += np.stack(
                [np.bincount(level[mask], weight, minlength=N_LEVELS) for weight in weights],
                axis=-1,
            )
        self._pairs += 1

    def finish(self) -> Flicker:
        """Return the measures of all instants."""
        if self._pairs < 1:
            raise MetricError(
                f"flicker is a change between frames: {int(self._previous is not None)} frame; "
                f"needs 2"
            )
        has_static = self._static[:, 0].sum() >= MIN_BLOCKS
        if not has_static:
            self._moving, self._static = self._moving + self._static, np.zeros((N_LEVELS, 4))
        static, moving, noise = (
            self._static.sum(axis=0),
            self._moving.sum(axis=0),
            self._noise_of_moving(),
        )
        excess, missed = moving[1] - (moving[2] - noise), max(moving[3] - noise, 0.0)
        blocks = static[0] + moving[0]
        return Flicker(
            excess=_signed_root((static[1] + excess) / blocks),
            error=_signed_root((static[1] + missed) / blocks),
            on_static=_signed_root(static[1] / static[0]) if has_static else None,
            on_moving=_signed_root(excess / moving[0]) if moving[0] else None,
            with_noise=_signed_root((static[1] + moving[1] - static[2] - moving[2]) / blocks),
            noise=_signed_root(static[2] / static[0]) if has_static else None,
            static_share=float(static[0] / blocks),
            n_pairs=self._pairs,
        )

    def _noise_of_moving(self) -> float:
        """Return the energy of the noise in all moving blocks: that of still ones as bright, or of
        all where too few are.
        """
        blocks, _, energy, _ = self._static.T
        overall = energy.sum() / max(blocks.sum(), 1)
        noise = np.where(blocks >= MIN_BLOCKS, energy / np.maximum(blocks, 1), overall)
        return float(noise @ self._moving[:, 0])

    def _still(self, energy: Field) -> NDArray[np.bool_]:
        """Return the blocks whose change is noise, and whose neighbours' is."""
        # half of a change's energy is the noise's variance
        bins = np.searchsorted(ENERGY_EDGES, energy / 2, side="right") - 1
        self._histogram += np.bincount(bins.ravel(), minlength=N_ENERGIES)
        moving = (bins > static_limit(self._histogram)).astype(np.uint8)
        return np.asarray(cv2.dilate(moving, np.ones((3, 3), np.uint8)) == 0)


def flicker(pairs: Iterable[tuple[Image8, Image8]]) -> Flicker:
    """Flicker of one view.

    Args:
        pairs: rendered and captured frame of each instant, in order, (H, W, 3) uint8; consumed as a
            stream.

    Raises:
        MetricError: see `FlickerMeter`.

    Example:
        >>> import numpy as np
        >>> still = np.full((16, 16, 3), 100, np.uint8)
        >>> flicker([(still, still), (still + 6, still)]).excess
        6.0
    """
    meter = FlickerMeter()
    for rendered, truth in pairs:
        meter.add(rendered, truth)
    return meter.finish()


def _change(later: Image8, earlier: Image8) -> NDArray[np.int16]:
    return np.asarray(cv2.subtract(later, earlier, dtype=cv2.CV_16S), dtype=np.int16)


def _energy(change: NDArray[np.int16]) -> Field:
    """Return the mean square of each block of 8 x 8 pixels over its pixels and channels."""
    squares = cv2.multiply(change, change, dtype=cv2.CV_32F)
    return np.asarray(block_means(squares).mean(axis=-1), dtype=np.float32)


def _signed_root(energy: float) -> float:
    return float(np.sign(energy) * np.sqrt(abs(energy)))


class FlickerScorer:
    """Flicker beyond the captured change."""

    def __init__(
        self, names: Sequence[str], _options: MetricOptions, _colour_map: ColourMap | None
    ) -> None:
        self.names = names
        self._meter = FlickerMeter()

    def add(self, index: int, rendered: Image8, truth: TruthFrame) -> list[Value]:
        """See `Scorer`."""
        self._meter.add(rendered, truth.image)
        return []

    def finish(self) -> list[Value]:
        """See `Scorer`."""
        flicker = self._meter.finish()
        scores = {"Flicker": flicker.error, "Flicker_excess": flicker.excess}
        return [(name, None, scores[name]) for name in self.names]


FLICKER = ViewMetric(
    name="Flicker",
    kind="view",
    function=flicker,
    unit="grey levels of 255",
    higher_is_better=False,
    group=CONSISTENCY,
    describe="change over time that the scene lacks, or missing change",
    reference="docs/metrics.md",
    scorer=FlickerScorer,
)
FLICKER_EXCESS = ViewMetric(
    name="Flicker_excess",
    kind="view",
    function=flicker,
    unit="grey levels of 255",
    higher_is_better=False,
    group=CONSISTENCY,
    describe="the same, signed: below 0 is frozen or blurred",
    reference="docs/metrics.md",
    scorer=FlickerScorer,
)
