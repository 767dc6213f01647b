"""IV-PSNR against values of the reference software and recorded ones, its kernel against its twin,
and its laws.
"""

import json

import numpy as np
import pytest

from ggvs_eval import kernels
from ggvs_eval.contrib.more_metrics.iv_psnr import iv_psnr, psnr_ycbcr
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.kernels import _iv_psnr
from helpers.places import DATA_FOLDER
from helpers.twins.iv_psnr import iv_psnr_twin, ycbcr_twin

ROWS, COLUMNS = np.mgrid[:60, :80]
CHECKER = (COLUMNS // 10 + ROWS // 10) % 2 == 0
HASH_NOISE = ((7919 * COLUMNS + 104729 * ROWS + 31 * COLUMNS * ROWS) % 17 - 8)[..., None]


def recorded_frame():
    """The YCbCr frame that the recorded values are of."""
    luma = 128 + 90 * np.sin(COLUMNS / 7) * np.cos(ROWS / 5)
    return round_levels(
        np.stack([luma, 128 + 40 * np.sin(COLUMNS / 11 + 1), 128 + 40 * np.cos(ROWS / 9)], axis=-1)
    )


RENDERED = {
    "identical": lambda frame: frame,
    "shift_1_0": lambda frame: np.roll(frame, 1, axis=1),
    "shift_2_2": lambda frame: np.roll(frame, (2, 2), axis=(0, 1)),
    "shift_3_0": lambda frame: np.roll(frame, 3, axis=1),
    "offset_plus2": lambda frame: round_levels(frame + 2.0),
    "offset_plus5": lambda frame: round_levels(frame + 5.0),
    "hash_noise": lambda frame: round_levels(frame + HASH_NOISE.astype(float)),
}


@pytest.mark.parametrize("case", RENDERED)
def test_recorded_values(case):
    """Shifts, offsets and noise have the values of an implementation that gives the reference
    software's printed numbers.
    """
    recorded = json.loads((DATA_FOLDER / "ivpsnr_oracle.json").read_text())["cases"]
    frame = recorded_frame()
    rendered = RENDERED[case](frame)

    assert iv_psnr(rendered, frame, colours="ycbcr") == pytest.approx(
        recorded[case]["ivpsnr"], abs=1e-5
    )
    if case == "hash_noise":
        masked = iv_psnr(rendered, frame, CHECKER, colours="ycbcr")
        assert masked == pytest.approx(recorded["hash_noise_checker_mask"]["ivpsnr"], abs=1e-5)


def test_rgb_frames_have_the_reference_softwares_value():
    """RGB through the reference software's own conversion: 39.042608 dB, and 33.983025 for
    PSNR-YCbCr.

    Version 26c88e7, built here with g++, on the two frames below as PNG: ``IVPSNR -ff PNG -i0
    r{:04d}.png -i1 t{:04d}.png -ps 80x60 -bd 8 -cf 444 -csi RGB -csm YCbCr_BT709 -ml "PSNR,
    IVPSNR"``, November 2026. With YCbCr from float arithmetic it would be 39.0427.
    """
    luma = 128 + 90 * np.sin(COLUMNS / 7) * np.cos(ROWS / 5)
    truth = round_levels(
        np.stack([luma, 128 + 70 * np.sin(COLUMNS / 11 + 1), 128 + 70 * np.cos(ROWS / 9)], axis=-1)
    )
    rendered = round_levels(np.roll(truth, 1, axis=1) + HASH_NOISE + np.array([0.0, 2.0, -1.0]))

    assert iv_psnr(rendered, truth) == pytest.approx(39.042608, abs=1e-6)
    assert psnr_ycbcr(rendered, truth) == pytest.approx(33.983025, abs=1e-6)
    assert iv_psnr(rendered / 255, truth / 255) == iv_psnr(rendered, truth)


@pytest.mark.usefixtures("kernel_settings")
@pytest.mark.parametrize(
    "shape", [(1, 1), (3, 300), pytest.param((70, 523), marks=pytest.mark.slow)]
)
@pytest.mark.parametrize("is_rgb", [False, True])
@pytest.mark.parametrize("masked", [False, True])
def test_the_kernel_equals_its_twin(shape, is_rgb, masked):
    """Every size, with and without a mask, gives the twin's integers from any number of threads on
    any instruction set.
    """
    random = np.random.default_rng(shape[1])
    truth = random.integers(0, 256, (*shape, 3), dtype=np.uint8)
    rendered = round_levels(truth + random.integers(-9, 7, truth.shape).astype(float))
    mask = random.random(shape) < 0.4 if masked else None
    expected = iv_psnr_twin(
        *((ycbcr_twin(image) if is_rgb else image) for image in (rendered, truth)), mask
    )

    for level in range(len(kernels.available_levels())):
        for threads in (1, 2):
            chosen = None if mask is None else mask.astype(np.uint8)
            measured = _iv_psnr.matched_errors(rendered, truth, chosen, is_rgb, threads, level)
            for part, value in zip(measured, expected, strict=True):
                np.testing.assert_array_equal(part, value)


def test_regions_that_cannot_be_measured_say_so():
    """A mask of another size or kind, or an empty one."""
    truth = np.zeros((20, 30, 3), np.uint8)
    for mask, reason in [
        (np.ones((20, 31), bool), "wanted \\(20, 30\\) bool"),
        (np.ones((20, 30), np.uint8), "got \\(20, 30\\) uint8"),
        (np.zeros((20, 30), bool), "0 pixels; needs 64"),
    ]:
        with pytest.raises(MetricError, match=reason):
            iv_psnr(truth, truth, mask)
