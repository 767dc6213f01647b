"""ST-RRED against scikit-video's recorded intermediate and final values, Netflix's port, a real
clip, and its laws.
"""

import json

import numpy as np
import pytest
from skimage import data

from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.time.strred import (
    PairDifference,
    block_entropies,
    luma,
    pool,
    spatial_band,
    strred,
)
from helpers.places import DATA_FOLDER, SHARED
from helpers.refusals import refused

REAL_CLIP = SHARED / "data/video_carphone"
RECORDED = json.loads((DATA_FOLDER / "strred_oracles.json").read_text())
CLIPS = [
    "carphone12",
    "synth_noise5",
    "synth_blur1p5",
    "synth_flicker5pct",
    "synth_oddsize_97x131",
    "const_ref_vs_noise",
]


def clip(name):
    """Distorted and pristine grey frames of a recorded clip, (T, H, W) uint8."""
    recorded = np.load(DATA_FOLDER / f"strred_{name}.npz")
    return recorded["dis"], recorded["ref"]


def moving_clip(frames=4, size=96):
    """A photograph that moves by two pixels per frame, (T, H, W, 3) uint8."""
    photograph = data.astronaut()
    return np.stack(
        [photograph[40 : 40 + size, 60 + 2 * t : 60 + 2 * t + size] for t in range(frames)]
    )


def with_noise(frames, strength, seed=0):
    noise = np.random.default_rng(seed).normal(0, strength, frames.shape)
    return round_levels(frames + noise)


def test_pyramid_taps_equal_recorded_ones():
    """The filters that pyrtools holds are those of the recorded reference."""
    from ggvs_eval.metrics.time.strred import _pyramid_kernels

    recorded = np.load(DATA_FOLDER / "sp5_filters.npz")
    wanted = (recorded["lo0"], recorded["lo"], recorded["bands_as_correlation_kernels"][0])
    first_lowpass, lowpass, band = _pyramid_kernels()
    np.testing.assert_allclose(first_lowpass, wanted[0], atol=1e-7)
    np.testing.assert_allclose(lowpass, wanted[1], atol=1e-7)
    np.testing.assert_allclose(band, wanted[2], atol=1e-7)


def test_bands_scales_and_entropies_equal_recorded_ones():
    """The band is within 1e-3, the block scales within 1e-4 and the entropies within 1e-3 of the
    recorded ones.
    """
    recorded = np.load(DATA_FOLDER / "strred_intermediate.npz")
    first, second = spatial_band(recorded["frame1"]), spatial_band(recorded["frame2"])
    np.testing.assert_allclose(first, recorded["y1"], atol=1e-3)
    np.testing.assert_allclose(second, recorded["y2"], atol=1e-3)
    for band, scale_name, entropy_name in (
        (first, "ss", "q"),
        (first - second, "ss_diff", "q_diff"),
    ):
        entropy, scale = block_entropies(band)
        np.testing.assert_allclose(scale, recorded[scale_name], atol=1e-4)
        np.testing.assert_allclose(entropy, recorded[entropy_name], atol=1e-3)


@pytest.mark.parametrize("name", CLIPS)
def test_scores_equal_scikit_video(name):
    """Both scores and every pair's four differences equal scikit-video's within its float32
    accuracy.
    """
    scores, wanted = strred(*clip(name)), RECORDED[name]
    assert scores.strred == pytest.approx(wanted["strred"], rel=5e-4)
    assert scores.strred_ssn == pytest.approx(wanted["strredssn"], rel=5e-3)
    np.testing.assert_allclose(scores.pairs, wanted["array"], atol=2e-3)


# Both scores of the first 4 carphone frames cut to odd and small sizes: scikit-video 1.1.11, numpy
# 2.4.6, np.int and its like put back, float32. At 48 pixels 16 patches make a 9 x 9 covariance,
# almost singular, and float32 keeps three digits.
CROPS = {
    (48, 48): (1421.95068, 1294.53345, 1e-3),
    (64, 64): (1986.78833, 1739.68127, 5e-4),
    (49, 95): (727.935913, 433.167603, 5e-4),
    (144, 51): (319.975586, 61.1671219, 5e-4),
    (143, 175): (186.976547, 7.20104504, 5e-4),
}


@pytest.mark.parametrize("size", CROPS)
def test_small_and_odd_sizes_equal_scikit_video(size):
    """Crops of the real clip, down to the smallest size that has a score, equal scikit-video's
    values on them.
    """
    rendered, truth = (frames[:4, : size[0], : size[1]] for frames in clip("carphone12"))
    scores, (wanted, wanted_single, tolerance) = strred(rendered, truth), CROPS[size]
    assert scores.strred == pytest.approx(wanted, rel=tolerance)
    assert scores.strred_ssn == pytest.approx(wanted_single, rel=5e-3)


@pytest.mark.parametrize("name", ["carphone_identical", "static_video", "const_vs_const"])
def test_clips_without_a_difference_in_time_score_as_recorded(name):
    """Equal, static and flat clips have the recorded parts, zero where nothing differs, and the
    score 0.
    """
    rendered, truth = (frames[:4] for frames in clip("carphone12"))
    clips = {
        "carphone_identical": (truth, truth),
        "static_video": (rendered[[0] * 4], truth[[0] * 4]),
        "const_vs_const": (np.full((4, 96, 96), 90, np.uint8), np.full((4, 96, 96), 60, np.uint8)),
    }
    scores = strred(*clips[name])
    assert scores.strred == scores.strred_ssn == RECORDED[name]["strred"] == 0.0
    np.testing.assert_allclose(scores.pairs, RECORDED[name]["array"], atol=2e-3)


@pytest.mark.skipif(
    not REAL_CLIP.is_dir(), reason="no ../shared/data/video_carphone beside this checkout"
)
def test_real_clip_scores_as_recorded():
    """All 120 frames of the carphone pair, decoded from the real files, have the recorded scores
    and 60 pairs.
    """
    import av

    def grey(name):
        with av.open(str(REAL_CLIP / f"carphone_{name}.mp4")) as file:
            return [frame.to_ndarray(format="gray") for frame in file.decode(video=0)]

    scores, wanted = strred(grey("distorted"), grey("pristine")), RECORDED["carphone120_full"]
    assert scores.strred == pytest.approx(wanted["strred"], rel=5e-4)
    assert scores.strred_ssn == pytest.approx(wanted["strredssn"], rel=5e-3)
    np.testing.assert_allclose(scores.pairs, wanted["array"], atol=2e-3)


@pytest.mark.parametrize(("frames", "name"), [(2, "carphone_T2"), (5, "carphone_T5_odd")])
def test_disjoint_pairs_leave_a_last_odd_frame_out(frames, name):
    """The first 2 and the first 5 frames score as recorded; of 5 frames the last one has no
    partner.
    """
    rendered, truth = (frames_of_clip[:frames] for frames_of_clip in clip("carphone12"))
    scores = strred(rendered, truth)
    assert scores.strred == pytest.approx(RECORDED[name]["strred"], rel=5e-4)
    assert len(scores.pairs) == frames // 2


def test_consecutive_pairs_equal_netflix_port():
    """Every neighbouring pair with the later frame first gives the recorded per-pair values and
    their product of means.
    """
    scores, wanted = (
        strred(*clip("carphone12"), "consecutive"),
        RECORDED["carphone12"]["netflix_pairing"],
    )
    np.testing.assert_allclose(scores.pairs[:, 0], wanted["per_frame_srred"], atol=2e-3)
    np.testing.assert_allclose(scores.pairs[:, 1], wanted["per_frame_trred"], atol=2e-3)
    assert scores.strred == pytest.approx(wanted["product_of_means"], rel=5e-4)
    products = strred(*clip("carphone12"), "consecutive", "products")
    assert products.strred == pytest.approx(wanted["mean_of_products"], rel=5e-4)


def test_products_are_averaged_after_multiplying():
    """Of two pairs, pooling by products gives the mean of both products, pooling by means the
    product of both means.
    """
    pairs = [PairDifference(1.0, 10.0, 0.5, 4.0), PairDifference(3.0, 30.0, 1.5, 8.0)]
    means, products = pool(pairs), pool(pairs, "products")
    assert (means.strred, means.strred_ssn) == (2 * 20, 1 * 6)
    assert (products.strred, products.strred_ssn) == ((10 + 90) / 2, (2 + 12) / 2)
    np.testing.assert_array_equal(means.pairs, products.pairs)


def test_luma_is_weighted_and_not_rounded():
    """Luma is 0.2989 R + 0.5870 G + 0.1140 B on the scale 0..255, fractions kept."""
    rgb = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 20, 30]]], np.uint8)
    np.testing.assert_allclose(luma(rgb)[0], [76.2195, 149.685, 29.07, 18.149], rtol=1e-6)


def test_colour_frames_score_as_their_luma():
    """RGB clips are compared on luma."""
    truth = moving_clip()
    rendered = with_noise(truth, 5)
    assert (
        strred(rendered, truth).strred
        == strred([luma(f) for f in rendered], [luma(f) for f in truth]).strred
    )


def test_content_of_low_rank_is_finite():
    """Stripes, which vary along one direction only and leave the covariance singular, score finite
    numbers.
    """
    stripes = np.tile((np.arange(128) // 8 % 2 * 200).astype(np.uint8)[:, None], (1, 128))
    truth = np.stack([stripes, np.roll(stripes, 3, axis=0)])
    scores = strred(with_noise(truth, 3), truth)
    assert np.isfinite(scores.pairs).all()
    assert scores.strred > 0


def test_what_cannot_be_scored_is_refused():
    """One frame, frames below 48 pixels, different lengths and different sizes are refused with
    their numbers.
    """
    truth = moving_clip()
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        strred(truth[:1], truth[:1])
    with refused(MetricError, "48 x 48", "(96, 47)"):
        strred(truth[:, :, :47], truth[:, :, :47])
    with refused(MetricError, "3 rendered", "4 true"):
        strred(truth[:3], truth)
    with pytest.raises(MetricError, match="sizes must agree"):
        strred(truth[:, :72], truth)


def test_values_that_are_not_finite_and_unknown_poolings_are_refused():
    """NaN or infinity in one pixel, an unknown pooling and an empty pool are errors, never a NaN
    score.
    """
    truth = moving_clip().astype(np.float64)[..., 0]
    for value in (np.nan, np.inf):
        broken = truth.copy()
        broken[1, 50, 60] = value
        with refused(MetricError, "STED", "not finite"):
            strred(broken, truth)
    with refused(MetricError, "uint8", "0..255", "(96, 96, 3) float64"):
        strred(moving_clip() / 255, moving_clip() / 255)
    with refused(MetricError, "'median'", "means, products"):
        strred(truth, truth, pooling="median")
    with refused(MetricError, "no pair"):
        pool([])
