"""TCC, SDT and SDV against recorded values and their laws; the stream that scores a view with all metrics in one pass."""

import json
import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage import data
from skimage.metrics import structural_similarity

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image import l1, psnr, psnr_colour_corrected, ssim
from ggvs_eval.metrics.registry import METRICS, select_metrics
from ggvs_eval.metrics.stream import MetricOptions, score_view
from ggvs_eval.metrics.strred import strred
from ggvs_eval.metrics.temporal import sdt, tcc, temporal_change_ssim
from ggvs_eval.metrics.views import sdv

DATA = Path(__file__).parent / "data"
ALL_BUT_LPIPS = [name for name in METRICS if name != "LPIPS"]
SKIMAGE = {"gaussian_weights": True, "sigma": 1.5, "use_sample_covariance": False, "data_range": 1, "channel_axis": 2}


def moving_view(frames=5, size=64, noise=6.0, seed=0):
    """Rendered and true frames of a photograph that moves by two pixels per frame; the rendering has noise."""
    photograph = data.astronaut()
    truth = np.stack([photograph[30 : 30 + size, 150 + 2 * t : 150 + 2 * t + size] for t in range(frames)])
    rendered = truth + np.random.default_rng(seed).normal(0, noise, truth.shape)
    return np.rint(np.clip(rendered, 0, 255)).astype(np.uint8), truth


def values_of(scores, metric):
    return {frame: value for name, frame, value in scores.values if name == metric}


def test_tcc_and_sdt_equal_recorded_values():
    """A recorded pair of clips has the recorded TCC (valid 11 x 11 window), per-frame L1, and SDT under both ddof."""
    clips, wanted = np.load(DATA / "ssim_tcc_inputs.npz"), json.loads((DATA / "ssim_tcc_oracles.json").read_text())
    rendered, truth = clips["rendered_video"], clips["gt_video"]
    errors = [l1(*frames) for frames in zip(rendered, truth, strict=True)]
    assert tcc(rendered, truth) == pytest.approx(wanted["tcc"]["valid_11x11_gauss"], abs=1e-6)
    assert errors == pytest.approx(wanted["l1_255_per_frame"], abs=1e-6)
    assert sdt([errors]) == pytest.approx(wanted["sdt_ddof1"], abs=1e-6)
    assert sdt([errors], ddof=0) == pytest.approx(wanted["sdt_ddof0"], abs=1e-6)


def test_change_of_8_bit_frames_does_not_wrap_around():
    """8-bit frames give scikit-image's SSIM of the absolute differences taken in floats, in either direction of change."""
    (r0, r1), (t0, t1) = (clip[[0, 3]] for clip in moving_view())
    changes = (np.abs(first / 255 - second / 255) for first, second in ((r0, r1), (t0, t1)))
    assert temporal_change_ssim(r0, r1, t0, t1) == pytest.approx(structural_similarity(*changes, **SKIMAGE), abs=1e-6)
    assert temporal_change_ssim(r1, r0, t1, t0) == temporal_change_ssim(r0, r1, t0, t1)


def test_negative_similarity_of_a_channel_counts_as_zero():
    """A channel whose changes are opposed contributes 0, not a negative number, to the mean of the channels."""
    stripes = np.arange(40) // 2 % 2 * np.ones((40, 1))
    still, change, opposed = (np.zeros((40, 40, 3)) for _ in range(3))
    change[..., 0], opposed[..., 0] = stripes, 1 - stripes
    assert structural_similarity(change[..., :1], opposed[..., :1], **SKIMAGE) < 0
    assert temporal_change_ssim(still, change, still, opposed) == pytest.approx(2 / 3)


def test_tcc_laws():
    """Equal clips and clips that differ by a constant score 1, swapped ones the same, and temporal noise costs."""
    rendered, truth = moving_view()
    assert tcc(truth, truth) == 1.0
    assert tcc(truth // 2 + 40, truth // 2) == 1.0
    assert tcc(rendered, truth) == tcc(truth, rendered)
    assert np.all(np.diff([tcc(*moving_view(noise=noise)) for noise in (1, 3, 9, 27)]) < 0)


def test_tcc_refuses_what_it_cannot_compare():
    """One frame, different lengths and different sizes are refused with their numbers."""
    rendered, truth = moving_view()
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        tcc(rendered[:1], truth[:1])
    with pytest.raises(MetricError, match="4 rendered frames, 5 true frames"):
        tcc(rendered[:4], truth)
    with pytest.raises(MetricError, match=r"rendered is \(60, 64, 3\), truth is \(64, 64, 3\)"):
        tcc(rendered[:, :60], truth)


@settings(max_examples=50, deadline=None)
@given(
    bias=st.lists(st.floats(0, 50), min_size=2, max_size=6),
    flicker=st.lists(st.floats(0, 50), min_size=2, max_size=6),
)
def test_constant_bias_and_common_flicker_are_seen_by_one_margin_only(bias, flicker):
    """Errors that differ between views only have SDT 0 and the views' SDV; between frames only, the reverse."""
    views, frames = np.array(bias)[:, None], np.array(flicker)[None, :]
    assert sdt(views + 0 * frames) == pytest.approx(0, abs=1e-9)
    assert sdv(views + 0 * frames) == pytest.approx(np.std(bias, ddof=1))
    assert sdt(frames + 0 * views) == pytest.approx(np.std(flicker, ddof=1))
    assert sdv(frames + 0 * views) == pytest.approx(0, abs=1e-9)


def test_sdt_and_sdv_average_after_the_deviation():
    """SDT is the mean over views of the deviation over frames, SDV the mean over frames of the deviation over views."""
    errors = np.array([[1.0, 3.0, 5.0], [2.0, 2.0, 8.0]])
    assert sdt(errors) == pytest.approx((2 + np.sqrt(12)) / 2)
    assert sdv(errors) == pytest.approx((1 + 1 + 3) / np.sqrt(2) / 3)
    assert sdv(errors, ddof=0) == pytest.approx((1 + 1 + 3) / 2 / 3)


def test_sdt_and_sdv_refuse_a_single_frame_or_view():
    """One frame has no SDT and one view no SDV; the message has the shape."""
    with pytest.raises(MetricError, match=r"at least 2 frames, got \(3, 1\)"):
        sdt(np.ones((3, 1)))
    with pytest.raises(MetricError, match=r"at least 2 views, got \(1, 3\)"):
        sdv(np.ones((1, 3)))


def test_stream_equals_the_metrics_called_by_hand():
    """Each streamed value is what the metric's own function gives on those frames."""
    rendered, truth = moving_view()
    scores = score_view(zip(rendered, truth, strict=True), ALL_BUT_LPIPS)
    for name, metric in (("PSNR", psnr), ("SSIM", ssim), ("L1", l1), ("PSNR_cc", psnr_colour_corrected)):
        assert values_of(scores, name) == {t: metric(rendered[t], truth[t]) for t in range(5)}
    changes = {t: temporal_change_ssim(rendered[t], rendered[t + 1], truth[t], truth[t + 1]) for t in range(4)}
    assert values_of(scores, "TCC") == changes
    assert values_of(scores, "SDT") == {None: sdt([list(values_of(scores, "L1").values())])}
    assert values_of(scores, "SDV") == {}
    assert scores.not_computed == {}


@pytest.mark.parametrize(("pairing", "first_frames"), [("disjoint", [0, 2]), ("consecutive", [0, 1, 2, 3])])
def test_streamed_sted_can_be_pooled_again_from_its_parts(pairing, first_frames):
    """STED is one value per view, and the means of its parts, kept at each pair's first frame, multiply to it."""
    rendered, truth = moving_view()
    scores = score_view(zip(rendered, truth, strict=True), ["STED", "STED_ssn"], MetricOptions(sted_pairing=pairing))
    whole = strred(rendered, truth, pairing)
    spatial, temporal = values_of(scores, "STED_spatial"), values_of(scores, "STED_temporal")
    assert values_of(scores, "STED") == {None: whole.strred}
    assert values_of(scores, "STED_ssn") == {None: whole.strred_ssn}
    assert list(spatial) == list(temporal) == first_frames
    assert np.mean(list(spatial.values())) * np.mean(list(temporal.values())) == pytest.approx(whole.strred)


def test_a_single_frame_has_no_temporal_metrics():
    """With one frame the frame metrics are there and each temporal one gives the reason."""
    rendered, truth = moving_view(frames=1)
    scores = score_view(zip(rendered, truth, strict=True), ALL_BUT_LPIPS)
    assert {name for name, _, _ in scores.values} == {"PSNR", "SSIM", "L1", "PSNR_cc"}
    assert scores.not_computed == dict.fromkeys(("TCC", "STED", "STED_ssn", "SDT"), "1 frame; needs 2")


def test_two_frames_have_all_metrics():
    """Two frames are enough for every metric of a view."""
    rendered, truth = moving_view(frames=2)
    scores = score_view(zip(rendered, truth, strict=True), ALL_BUT_LPIPS)
    assert {name for name, _, _ in scores.values} == {*ALL_BUT_LPIPS, "STED_spatial", "STED_temporal"} - {"SDV"}


def test_frames_too_small_for_one_metric_keep_the_others():
    """Below 48 pixels STED gives its reason and the rest is measured."""
    rendered, truth = moving_view(size=40)
    scores = score_view(zip(rendered, truth, strict=True), ["PSNR", "STED", "STED_ssn"])
    assert len(values_of(scores, "PSNR")) == 5
    assert set(scores.not_computed) == {"STED", "STED_ssn"}
    assert "48 x 48 pixels, got (40, 40)" in scores.not_computed["STED"]


def test_lpips_without_weights_is_reported_once_and_never_nan(tmp_path, monkeypatch):
    """Without weights LPIPS has one reason and no value, and the other metrics are measured."""
    from ggvs_eval.metrics.lpips import load_weights

    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path))
    load_weights.cache_clear()
    rendered, truth = moving_view(frames=3)
    scores = score_view(zip(rendered, truth, strict=True), ["LPIPS", "PSNR"])
    assert scores.not_computed["LPIPS"].startswith("LPIPS-vgg: no weights at")
    assert [name for name, _, _ in scores.values] == ["PSNR"] * 3


def test_stream_keeps_two_frames_and_no_more():
    """Scoring 40 frames needs no more memory than scoring 4 of them: nothing of a frame is kept beyond the next one."""

    def peak(frames):
        rng = np.random.default_rng(0)
        pairs = ((rng.integers(0, 255, (64, 512, 3), np.uint8),) * 2 for _ in range(frames))
        tracemalloc.start()
        score_view(pairs, ["PSNR", "SSIM", "TCC", "STED", "SDT"])
        peak_bytes = tracemalloc.get_traced_memory()[1]
        tracemalloc.stop()
        return peak_bytes

    peak(2)
    assert peak(40) < peak(4) + 64 * 512 * 3 // 2


def test_views_that_cannot_be_scored_are_refused():
    """No frames, a frame of another size, and a rendered frame that does not fit its truth are errors of the view."""
    rendered, truth = moving_view(frames=2)
    with pytest.raises(MetricError, match="no frames to score"):
        score_view([], ["PSNR"])
    with pytest.raises(MetricError, match=r"frame 1 is \(60, 64, 3\), the frames before are \(64, 64, 3\)"):
        score_view([(rendered[0], truth[0]), (rendered[1, :60], truth[1, :60])], ["PSNR"])
    with pytest.raises(MetricError, match=r"rendered is \(60, 64, 3\), truth is \(64, 64, 3\)"):
        score_view([(rendered[0, :60], truth[0])], ["TCC"])


def test_unknown_metric_names_the_nearest_known_one():
    """A misspelt metric is refused with the nearest known name."""
    with pytest.raises(MetricError, match="no metric 'SIM'; nearest is 'SSIM'"):
        score_view([], ["PSNR", "SIM"])


def test_every_metric_says_what_it_is():
    """Each metric stands under its own name and has a description and a reference; selection keeps the order asked for."""
    assert all(name == spec.name and spec.describe and spec.reference for name, spec in METRICS.items())
    assert [spec.name for spec in select_metrics(["TCC", "PSNR"])] == ["TCC", "PSNR"]
