"""ST-RRED against scikit-video's recorded intermediate and final values, and its laws."""

import json
from pathlib import Path

import numpy as np
import pytest
from skimage import data

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.strred import (
    block_entropies,
    luma,
    pair_difference,
    pool,
    reduced_references,
    spatial_band,
    strred,
)

DATA = Path(__file__).parent / "data"
RECORDED = json.loads((DATA / "strred_oracles.json").read_text())
CLIPS = ["carphone12", "synth_noise5", "synth_blur1p5", "synth_flicker5pct", "synth_oddsize_97x131", "const_ref_vs_noise"]


def clip(name):
    """Distorted and pristine grey frames of a recorded clip, (T, H, W) uint8."""
    recorded = np.load(DATA / f"strred_{name}.npz")
    return recorded["dis"], recorded["ref"]


def moving_clip(frames=4, size=96):
    """A photograph that moves by two pixels per frame, (T, H, W, 3) uint8."""
    photograph = data.astronaut()
    return np.stack([photograph[40 : 40 + size, 60 + 2 * t : 60 + 2 * t + size] for t in range(frames)])


def with_noise(frames, strength, seed=0):
    noise = np.random.default_rng(seed).normal(0, strength, frames.shape)
    return np.rint(np.clip(frames + noise, 0, 255)).astype(np.uint8)


def test_pyramid_taps_equal_recorded_ones():
    """The filters that pyrtools holds are those of the recorded reference."""
    from ggvs_eval.metrics.strred import _pyramid_kernels

    recorded = np.load(DATA / "sp5_filters.npz")
    wanted = (recorded["lo0"], recorded["lo"], recorded["bands_as_correlation_kernels"][0])
    first_lowpass, lowpass, band = _pyramid_kernels()
    np.testing.assert_allclose(first_lowpass, wanted[0], atol=1e-7)
    np.testing.assert_allclose(lowpass, wanted[1], atol=1e-7)
    np.testing.assert_allclose(band, wanted[2], atol=1e-7)


def test_bands_scales_and_entropies_equal_recorded_ones():
    """The band is within 1e-3, the block scales within 1e-4 and the entropies within 1e-3 of the recorded ones."""
    recorded = np.load(DATA / "strred_intermediate.npz")
    first, second = spatial_band(recorded["frame1"]), spatial_band(recorded["frame2"])
    np.testing.assert_allclose(first, recorded["y1"], atol=1e-3)
    np.testing.assert_allclose(second, recorded["y2"], atol=1e-3)
    for band, scale_name, entropy_name in ((first, "ss", "q"), (first - second, "ss_diff", "q_diff")):
        entropy, scale = block_entropies(band)
        np.testing.assert_allclose(scale, recorded[scale_name], atol=1e-4)
        np.testing.assert_allclose(entropy, recorded[entropy_name], atol=1e-3)


@pytest.mark.parametrize("name", CLIPS)
def test_scores_equal_scikit_video(name):
    """Both scores and every pair's four differences equal scikit-video's within its float32 accuracy."""
    scores, wanted = strred(*clip(name)), RECORDED[name]
    assert scores.strred == pytest.approx(wanted["strred"], rel=5e-4)
    assert scores.strred_ssn == pytest.approx(wanted["strredssn"], rel=5e-3)
    np.testing.assert_allclose(scores.pairs, wanted["array"], atol=2e-3)


@pytest.mark.parametrize(("frames", "name"), [(2, "carphone_T2"), (5, "carphone_T5_odd")])
def test_disjoint_pairs_leave_a_last_odd_frame_out(frames, name):
    """The first 2 and the first 5 frames score as recorded; of 5 frames the last one has no partner."""
    rendered, truth = (frames_of_clip[:frames] for frames_of_clip in clip("carphone12"))
    scores = strred(rendered, truth)
    assert scores.strred == pytest.approx(RECORDED[name]["strred"], rel=5e-4)
    assert len(scores.pairs) == frames // 2


def test_consecutive_pairs_equal_netflix_port():
    """Every neighbouring pair with the later frame first gives the recorded per-pair values and their product of means."""
    scores, wanted = strred(*clip("carphone12"), "consecutive"), RECORDED["carphone12"]["netflix_pairing"]
    np.testing.assert_allclose(scores.pairs[:, 0], wanted["per_frame_srred"], atol=2e-3)
    np.testing.assert_allclose(scores.pairs[:, 1], wanted["per_frame_trred"], atol=2e-3)
    assert scores.strred == pytest.approx(wanted["product_of_means"], rel=5e-4)


def test_luma_is_weighted_and_not_rounded():
    """Luma is 0.2989 R + 0.5870 G + 0.1140 B on the scale 0..255, fractions kept."""
    rgb = np.array([[[255, 0, 0], [0, 255, 0], [0, 0, 255], [10, 20, 30]]], np.uint8)
    np.testing.assert_allclose(luma(rgb)[0], [76.2195, 149.685, 29.07, 18.149], rtol=1e-6)


def test_colour_frames_score_as_their_luma():
    """RGB clips are compared on luma."""
    truth = moving_clip()
    rendered = with_noise(truth, 5)
    assert strred(rendered, truth).strred == strred([luma(f) for f in rendered], [luma(f) for f in truth]).strred


def test_streamed_parts_equal_the_whole():
    """Bands, references, differences and pooling taken two frames at a time give the score of the clip."""
    rendered, truth = clip("synth_noise5")
    differences = [
        pair_difference(*(reduced_references(spatial_band(side[t]), spatial_band(side[t + 1])) for side in (rendered, truth)))
        for t in range(0, len(truth), 2)
    ]
    assert pool(differences).strred == strred(rendered, truth).strred


def test_identical_and_static_clips_score_zero():
    """Equal clips score 0; so do static ones, whose changes are nothing, even where the pictures differ."""
    truth = moving_clip()
    assert strred(truth, truth).strred == 0.0
    still, noisy_still = np.stack([truth[0]] * 4), np.stack([with_noise(truth[0], 9)] * 4)
    scores = strred(noisy_still, still)
    assert scores.strred == 0.0
    assert scores.pairs[:, 0].min() > 0


@pytest.mark.parametrize("level", [0, 128, 255])
def test_content_without_variance_is_finite_and_zero(level):
    """Flat frames have neither scale nor entropy: no singular matrix, no rounding noise taken for content."""
    flat = np.full((2, 64, 64), level, np.uint8)
    scores = strred(flat, flat + np.uint8(1 if level < 255 else 0))
    assert scores.strred == scores.strred_ssn == 0.0


def test_content_of_low_rank_is_finite():
    """Stripes, which vary along one direction only and leave the covariance singular, score finite numbers."""
    stripes = np.tile((np.arange(128) // 8 % 2 * 200).astype(np.uint8)[:, None], (1, 128))
    truth = np.stack([stripes, np.roll(stripes, 3, axis=0)])
    scores = strred(with_noise(truth, 3), truth)
    assert np.isfinite(scores.pairs).all()
    assert scores.strred > 0


def test_more_noise_and_more_flicker_score_worse():
    """STED rises with independent noise per frame and with brightness flicker."""
    truth = moving_clip(size=200)
    noise = [strred(with_noise(truth, strength), truth).strred for strength in (2, 6, 18, 50)]
    gains = [1 + strength * np.array([1, -1, 1, -1])[:, None, None, None] for strength in (0.02, 0.06, 0.2)]
    flicker = [strred(np.clip(truth * gain, 0, 255).astype(np.uint8), truth).strred for gain in gains]
    assert np.all(np.diff(noise) > 0)
    assert np.all(np.diff(flicker) > 0)


def test_what_cannot_be_scored_is_refused():
    """One frame, frames below 48 pixels, different lengths and different sizes are refused with their numbers."""
    truth = moving_clip()
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        strred(truth[:1], truth[:1])
    with pytest.raises(MetricError, match=r"at least 48 x 48 pixels, got \(96, 47\)"):
        strred(truth[:, :, :47], truth[:, :, :47])
    with pytest.raises(MetricError, match="3 rendered frames, 4 true frames"):
        strred(truth[:3], truth)
    with pytest.raises(MetricError, match="sizes must agree"):
        strred(truth[:, :72], truth)


def test_smallest_frames_score():
    """48 pixels are enough for two by two blocks."""
    truth = moving_clip(size=48)
    assert strred(with_noise(truth, 9), truth).strred > 0
