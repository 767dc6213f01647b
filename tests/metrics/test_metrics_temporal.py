"""TCC, SDT and SDV against recorded values and their laws; the stream that scores a view with all
metrics in one pass.
"""

import json
import tracemalloc

import numpy as np
import pytest
from skimage import data
from skimage.metrics import structural_similarity

from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.image.corrected import (
    apply_colour_map,
    fit_colour_map,
    psnr_colour_corrected,
    unit_range,
)
from ggvs_eval.metrics.image.l1 import l1, masked_l1
from ggvs_eval.metrics.image.psnr import masked_psnr, psnr
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.image.ssim import masked_ssim, ssim, ssim_variant
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.registry import METRICS, select_metrics
from ggvs_eval.metrics.stream import fit_colour_maps, score_view, score_views
from ggvs_eval.metrics.time.deviations import sdt, sdv
from ggvs_eval.metrics.time.strred import strred
from ggvs_eval.metrics.time.tcc import tcc, temporal_change_ssim
from helpers.places import DATA_FOLDER
from helpers.refusals import refused

# with a truth, view by view
ALL_BUT_LPIPS = ["PSNR", "SSIM", "L1", "PSNR_cc", "TCC", "STED", "STED_ssn", "SDT", "SDV"]
STED_PARTS = {f"{name}_{part}" for name in ("STED", "STED_ssn") for part in ("spatial", "temporal")}
EACH_FRAME = MetricOptions(colour_scope="frame")
SKIMAGE = {
    "gaussian_weights": True,
    "sigma": 1.5,
    "use_sample_covariance": False,
    "data_range": 1,
    "channel_axis": 2,
}


def moving_view(frames=5, size=64, noise=6.0, seed=0):
    """Rendered and true frames of a photograph that moves by two pixels per frame; the rendering
    has noise.
    """
    photograph = data.astronaut()
    truth = np.stack(
        [photograph[30 : 30 + size, 150 + 2 * t : 150 + 2 * t + size] for t in range(frames)]
    )
    rendered = truth + np.random.default_rng(seed).normal(0, noise, truth.shape)
    return round_levels(rendered), truth


def values_of(scores, metric):
    return {frame: value for name, frame, value in scores.values if name == metric}


def test_tcc_and_sdt_equal_recorded_values():
    """A recorded pair of clips has the recorded TCC (valid 11 x 11 window), per-frame L1, and SDT
    under both ddof.
    """
    clips, wanted = (
        np.load(DATA_FOLDER / "ssim_tcc_inputs.npz"),
        json.loads((DATA_FOLDER / "ssim_tcc_oracles.json").read_text()),
    )
    rendered, truth = clips["rendered_video"], clips["gt_video"]
    errors = [l1(*frames) for frames in zip(rendered, truth, strict=True)]
    assert tcc(rendered, truth) == pytest.approx(wanted["tcc"]["valid_11x11_gauss"], abs=1e-6)
    assert errors == pytest.approx(wanted["l1_255_per_frame"], abs=1e-6)
    assert sdt([errors]) == pytest.approx(wanted["sdt_ddof1"], abs=1e-6)
    assert sdt([errors], ddof=0) == pytest.approx(wanted["sdt_ddof0"], abs=1e-6)


def test_change_of_8_bit_frames_does_not_wrap_around():
    """8-bit frames give scikit-image's SSIM of the absolute differences taken in floats, in either
    direction of change.
    """
    (r0, r1), (t0, t1) = (clip[[0, 3]] for clip in moving_view())
    changes = (np.abs(first / 255 - second / 255) for first, second in ((r0, r1), (t0, t1)))
    assert temporal_change_ssim(r0, r1, t0, t1) == pytest.approx(
        structural_similarity(*changes, **SKIMAGE), abs=1e-6
    )
    assert temporal_change_ssim(r1, r0, t1, t0) == temporal_change_ssim(r0, r1, t0, t1)


def test_negative_similarity_of_a_channel_counts_as_zero():
    """A channel whose changes are opposed contributes 0, not a negative number, to the mean of the
    channels.
    """
    stripes = np.arange(40) // 2 % 2 * np.ones((40, 1))
    still, change, opposed = (np.zeros((40, 40, 3)) for _ in range(3))
    change[..., 0], opposed[..., 0] = stripes, 1 - stripes
    assert structural_similarity(change[..., :1], opposed[..., :1], **SKIMAGE) < 0
    assert temporal_change_ssim(still, change, still, opposed) == pytest.approx(2 / 3)


def test_tcc_laws():
    """Equal clips and clips that differ by a constant score 1, swapped ones the same, and temporal
    noise costs.
    """
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
    with refused(MetricError, "4 rendered", "5 true"):
        tcc(rendered[:4], truth)
    with refused(MetricError, "(60, 64, 3)", "(64, 64, 3)"):
        tcc(rendered[:, :60], truth)


def test_static_clips_score_one_and_errors_that_are_not_finite_are_refused():
    """Two still clips change alike, by nothing, whatever they show; NaN in a frame or in an error
    is an error.
    """
    rendered, truth = moving_view(frames=2)
    assert tcc(rendered[[0, 0]], truth[[0, 0]]) == 1.0
    assert tcc(np.full((2, 20, 20, 3), 9, np.uint8), np.full((2, 20, 20, 3), 200, np.uint8)) == 1.0
    broken = rendered / 255
    broken[1, 5, 5, 0] = np.nan
    with refused(MetricError, "TCC", "not finite"):
        tcc(broken, truth / 255)
    with refused(MetricError, "SDT", "not finite"):
        sdt([[1.0, np.nan]])


def test_sdt_and_sdv_average_after_the_deviation():
    """SDT is the mean over views of the deviation over frames, SDV the mean over frames of the
    deviation over views.
    """
    errors = np.array([[1.0, 3.0, 5.0], [2.0, 2.0, 8.0]])
    assert sdt(errors) == pytest.approx((2 + np.sqrt(12)) / 2)
    assert sdv(errors) == pytest.approx((1 + 1 + 3) / np.sqrt(2) / 3)
    assert sdv(errors, ddof=0) == pytest.approx((1 + 1 + 3) / 2 / 3)


def test_sdt_and_sdv_refuse_a_single_frame_or_view():
    """One frame has no SDT and one view no SDV; the message has the shape."""
    with refused(MetricError, "2 frames", "(3, 1)"):
        sdt(np.ones((3, 1)))
    with refused(MetricError, "2 views", "(1, 3)"):
        sdv(np.ones((1, 3)))


def test_stream_equals_the_metrics_called_by_hand():
    """Each streamed value is what the metric's own function gives on those frames."""
    rendered, truth = moving_view()
    scores = score_view(zip(rendered, truth, strict=True), ALL_BUT_LPIPS, EACH_FRAME)
    for name, metric in (
        ("PSNR", psnr),
        ("SSIM", ssim),
        ("L1", l1),
        ("PSNR_cc", psnr_colour_corrected),
    ):
        assert values_of(scores, name) == {t: metric(rendered[t], truth[t]) for t in range(5)}
    changes = {
        t: temporal_change_ssim(rendered[t], rendered[t + 1], truth[t], truth[t + 1])
        for t in range(4)
    }
    assert values_of(scores, "TCC") == changes
    assert values_of(scores, "SDT") == {None: sdt([list(values_of(scores, "L1").values())])}
    assert values_of(scores, "SDV") == {}
    assert scores.not_computed == {}


def test_stream_scores_odd_small_and_flat_views_without_nan():
    """Through the stream too, views below 48 and below 11 pixels, flat and static ones have finite
    values or reasons.
    """
    for size, names_refused in (
        ((47, 53), {"STED", "STED_ssn"}),
        ((10, 64), {"SSIM", "TCC", "STED", "STED_ssn"}),
        ((49, 51), set()),
    ):
        for level in (0, 255):
            frames = [
                (np.full((*size, 3), level, np.uint8), np.full((*size, 3), 255 - level, np.uint8))
            ] * 3
            scores = score_view(frames, ALL_BUT_LPIPS, EACH_FRAME)
            assert np.isfinite([value for _, _, value in scores.values]).all()
            assert names_refused <= set(scores.not_computed)
            assert {"PSNR", "L1", "SDT"} & set(scores.not_computed) == set()


def test_colours_are_corrected_by_the_map_of_the_view():
    """With maps fitted over the view first, each frame is changed by that map; without them it is
    an error, not a guess.
    """
    rendered, truth = moving_view()
    rendered = np.stack(
        [frame // 2 if t == 2 else frame // 4 * 3 + 20 for t, frame in enumerate(rendered)]
    )
    frames = [((rendered[t], truth[t]), truth[t]) for t in range(5)]
    maps = fit_colour_maps(frames)
    np.testing.assert_allclose(maps[0], fit_colour_map(rendered, truth), atol=1e-12)
    ours, perfect = score_views(frames, ["PSNR_cc", "SSIM_cc"], colour_maps=maps)
    corrected = [apply_colour_map(maps[0], frame) for frame in rendered]
    for name, metric in (("PSNR_cc", psnr), ("SSIM_cc", ssim)):
        assert values_of(ours, name) == {
            t: metric(corrected[t], unit_range(truth[t])) for t in range(5)
        }
    assert np.mean(list(values_of(ours, "PSNR_cc").values())) == pytest.approx(
        psnr_colour_corrected(rendered, truth)
    )
    assert min(values_of(perfect, "PSNR_cc").values()) > 90
    with refused(MetricError, "colours", "fit the maps"):
        score_views(frames, ["SSIM_cc"])


def test_streamed_variants_are_those_that_were_asked_for():
    """SSIM of each name, pooling by products and ddof 0 are what the metrics give when
    called so.
    """
    rendered, truth = moving_view()
    for name in ("gaussian-valid", "gaussian-zero", "uniform7", "uniform7-range2"):
        scores = score_view(zip(rendered, truth, strict=True), ["SSIM"], MetricOptions(ssim=name))
        assert values_of(scores, "SSIM") == {
            t: ssim_variant(rendered[t], truth[t], name) for t in range(5)
        }
    options = MetricOptions(sted_pairing="consecutive", sted_pooling="products", ddof=0)
    scores = score_view(zip(rendered, truth, strict=True), ["STED", "L1", "SDT"], options)
    assert values_of(scores, "STED") == {
        None: strred(rendered, truth, "consecutive", "products").strred
    }
    assert values_of(scores, "SDT") == {None: sdt([list(values_of(scores, "L1").values())], ddof=0)}


def test_streamed_regions_are_the_masks_of_the_captured_frames():
    """What moves is taken from the captured frame and the one before, the rest is static, and the
    first frame has neither.
    """
    rendered, truth = (frames.copy() for frames in moving_view(frames=4, size=96))
    truth[:, :, 40:], rendered[:, :, 40:] = truth[0, :, 40:], rendered[0, :, 40:]
    hidden = np.zeros((96, 96), bool)
    hidden[10:40, 10:60] = True
    names = [
        f"{name}_{region}"
        for name in ("PSNR", "SSIM", "L1")
        for region in ("static", "moving", "disoccluded")
    ]
    scores = score_view(zip(rendered, truth, strict=True), names, disoccluded=[hidden] * 4)
    assert scores.not_computed == {}
    for name, metric in (("PSNR", masked_psnr), ("SSIM", masked_ssim), ("L1", masked_l1)):
        moving = {t: moving_mask(truth[t], truth[t - 1]) for t in (1, 2, 3)}
        assert values_of(scores, f"{name}_moving") == {
            t: metric(rendered[t], truth[t], mask) for t, mask in moving.items()
        }
        assert values_of(scores, f"{name}_static") == {
            t: metric(rendered[t], truth[t], ~mask) for t, mask in moving.items()
        }
        assert values_of(scores, f"{name}_disoccluded") == {
            t: metric(rendered[t], truth[t], hidden) for t in range(4)
        }


def test_regions_without_a_pixel_have_a_reason():
    """A view in which nothing moves has no score of what moves, and says why; its static part is
    scored.
    """
    rendered, truth = moving_view(frames=1)
    scores = score_view(
        [(rendered[0], truth[0])] * 3, ["PSNR_moving", "PSNR_static", "PSNR_disoccluded"]
    )
    assert list(values_of(scores, "PSNR_static")) == [1, 2]
    assert set(scores.not_computed) == {"PSNR_moving", "PSNR_disoccluded"}
    assert "the region has 0 pixels" in scores.not_computed["PSNR_moving"]


def test_what_the_truth_decides_is_computed_once_for_all_methods(monkeypatch):
    """Three methods cost three bands per frame and entropies per pair of their own and one of the
    truth, not six.
    """
    from ggvs_eval.metrics.time import strred as module

    calls, pairs = [], []
    plain, plain_references = module.spatial_band, module.reduced_references
    monkeypatch.setattr(module, "spatial_band", lambda image: calls.append(1) or plain(image))
    monkeypatch.setattr(
        module, "reduced_references", lambda *given: pairs.append(1) or plain_references(*given)
    )
    rendered, truth = moving_view(frames=2)
    scores = score_views(
        [((rendered[t], truth[t], rendered[t]), truth[t]) for t in range(2)], ["STED"]
    )
    assert (len(calls), len(pairs)) == (2 * (3 + 1), 3 + 1)
    wanted = strred(rendered, truth).strred
    assert [values_of(one, "STED")[None] for one in scores] == [wanted, 0.0, wanted]


@pytest.mark.parametrize(
    ("pairing", "first_frames"), [("disjoint", [0, 2]), ("consecutive", [0, 1, 2, 3])]
)
def test_streamed_sted_can_be_pooled_again_from_its_parts(pairing, first_frames):
    """STED is one value per view, and the means of its parts, kept at each pair's first frame,
    multiply to it.
    """
    rendered, truth = moving_view()
    scores = score_view(
        zip(rendered, truth, strict=True), ["STED", "STED_ssn"], MetricOptions(sted_pairing=pairing)
    )
    whole = strred(rendered, truth, pairing)
    spatial, temporal = values_of(scores, "STED_spatial"), values_of(scores, "STED_temporal")
    assert values_of(scores, "STED") == {None: whole.strred}
    assert values_of(scores, "STED_ssn") == {None: whole.strred_ssn}
    assert list(spatial) == list(temporal) == first_frames
    assert np.mean(list(spatial.values())) * np.mean(list(temporal.values())) == pytest.approx(
        whole.strred
    )


def test_a_single_frame_has_no_temporal_metrics():
    """With one frame the frame metrics are there and each temporal one gives the reason."""
    rendered, truth = moving_view(frames=1)
    scores = score_view(zip(rendered, truth, strict=True), ALL_BUT_LPIPS, EACH_FRAME)
    assert {name for name, _, _ in scores.values} == {"PSNR", "SSIM", "L1", "PSNR_cc"}
    assert scores.not_computed == dict.fromkeys(
        ("TCC", "STED", "STED_ssn", "SDT"), "1 frame; needs 2"
    )


def test_lpips_without_weights_is_reported_once_and_never_nan(tmp_path, monkeypatch):
    """Without weights LPIPS has one reason and no value, and the other metrics are measured."""
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path))
    rendered, truth = moving_view(frames=3)
    scores = score_view(zip(rendered, truth, strict=True), ["LPIPS", "PSNR"])
    assert scores.not_computed["LPIPS"].startswith("LPIPS-vgg: no weights at")
    assert [name for name, _, _ in scores.values] == ["PSNR"] * 3


def test_stream_keeps_two_frames_and_no_more():
    """Scoring 40 frames needs no more memory than scoring 4 of them: nothing of a frame is kept
    beyond the next one.
    """

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
    """No frames, a frame of another size, and a rendered frame that does not fit its truth are
    errors of the view.
    """
    rendered, truth = moving_view(frames=2)
    with refused(MetricError, "no frames"):
        score_view([], ["PSNR"])
    with refused(MetricError, "frame 1", "(60, 64, 3)", "(64, 64, 3)"):
        score_view([(rendered[0], truth[0]), (rendered[1, :60], truth[1, :60])], ["PSNR"])
    with refused(MetricError, "(60, 64, 3)", "(64, 64, 3)"):
        score_view([(rendered[0, :60], truth[0])], ["TCC"])


def test_unknown_metric_names_the_nearest_known_one():
    """A misspelt metric is refused with the nearest known name."""
    with refused(MetricError, "'SIM'", "did you mean SSIM"):
        score_view([], ["PSNR", "SIM"])


def test_every_metric_says_what_it_is():
    """Each metric stands under its own name and has a description and a reference; selection keeps
    the order asked for.
    """
    assert all(
        name == spec.name and spec.describe and spec.reference for name, spec in METRICS.items()
    )
    assert [spec.name for spec in select_metrics(["TCC", "PSNR"])] == ["TCC", "PSNR"]
