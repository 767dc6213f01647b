"""Further full-reference metrics of frames: each against its library or its authors' program, its
parts, and what is absent.
"""

import sys

import cv2
import numpy as np
import pytest
from skimage import data
from skimage.metrics import structural_similarity

from ggvs_eval.contrib.more_metrics import fetch_dists
from ggvs_eval.contrib.more_metrics.dists import dists, load_dists_weights
from ggvs_eval.contrib.more_metrics.flip import flip
from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.image.dssim import dssim
from ggvs_eval.metrics.image.lpips_network import weights_path
from ggvs_eval.metrics.image.ms_ssim import ms_ssim
from ggvs_eval.metrics.image.regions import moving_mask
from ggvs_eval.metrics.metric import FramePair, MetricOptions, TruthFrame, ViewMetric
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.metrics.stream import score_view
from helpers.photographs import noisy_pair
from helpers.refusals import refused

needs_dists = pytest.mark.skipif(
    not (fetch_dists.dists_weights_path().is_file() and weights_path("vgg").is_file()),
    reason=f"run `{fetch_dists.FETCH_COMMAND}`",
)
OF_PARTS = [
    metric
    for metric in METRICS.values()
    if isinstance(metric, ViewMetric) and metric.inside and metric.kind == "frame"
]


def skip_without(name):
    """Skip where a metric's package or weights are absent on this machine."""
    if name.startswith("FLIP"):
        pytest.importorskip("flip_evaluator")
    if name.startswith(("LPIPS", "DISTS")) and not all(
        path.is_file() for path in (weights_path("vgg"), fetch_dists.dists_weights_path())
    ):
        pytest.skip("no weights")


@pytest.mark.slow
@needs_dists
def test_dists_equals_its_authors_module():
    """0.1202973 and 0.2998802 for noise and blur.

    Outside run, November 2026: ``DISTS_pytorch.DISTS`` of DISTS-pytorch 0.1 with its weights.pt, on
    torchvision's VGG16 with the same convolutions, of the two frames below in [0, 1]. On
    images/r0.png and r1.png of its repository both give the 0.3347 that the authors print.
    """
    rendered, truth = noisy_pair(48, 64)

    assert dists(rendered, truth) == pytest.approx(0.1202973, abs=1e-5)
    assert dists(cv2.GaussianBlur(truth, (0, 0), 1.5), truth) == pytest.approx(0.2998802, abs=1e-6)
    assert dists(truth, truth) == pytest.approx(0, abs=1e-6)


def test_flip_equals_its_authors_program():
    """0.089073 as ``flip -r t000.png -t r000.png`` of flip-evaluator 1.7 prints it, November 2026;
    floats and 8 bit agree.
    """
    pytest.importorskip("flip_evaluator")
    truth = np.ascontiguousarray(data.astronaut()[100:220, 150:310])
    blurred = cv2.GaussianBlur(truth, (0, 0), 1.0) + np.random.default_rng(0).normal(
        0, 6, truth.shape
    )
    rendered = round_levels(blurred)

    assert flip(rendered, truth) == pytest.approx(0.089073, abs=5e-7)
    assert flip(rendered / 255, truth / 255) == pytest.approx(flip(rendered, truth), rel=1e-5)
    assert flip(truth, truth) == 0


def test_dssim_is_scikit_images_under_either_range():
    """Half of 1 - SSIM with data range 1, and with 2, which is what scikit-image takes for floats
    when nothing is said.
    """
    rendered, truth = (image / 255 for image in noisy_pair())
    for data_range in (1, 2):
        similarity = structural_similarity(
            rendered, truth, data_range=float(data_range), channel_axis=2
        )
        assert dssim(rendered, truth, data_range) == pytest.approx((1 - similarity) / 2, abs=1e-6)
    assert dssim(rendered, truth, 2) < 0.75 * dssim(rendered, truth, 1)


def test_frames_too_small_for_five_scales():
    """MS-SSIM says which size it needs."""
    rendered, truth = noisy_pair()
    with refused(MetricError, "MS-SSIM", "161 pixels", "90 x 110"):
        ms_ssim(rendered, truth)


@pytest.mark.parametrize(
    "metric",
    [
        pytest.param(
            metric.name, marks=pytest.mark.slow if metric.name in ("LPIPS", "DISTS") else ()
        )
        for metric in OF_PARTS
        if metric.name != "LPIPS_cc"
    ],
)
def test_a_part_is_the_whole_where_it_is_everything_and_blind_to_the_rest(metric):
    """With all pixels inside a part has the value of the whole; errors far outside it change
    nothing.
    """
    skip_without(metric)
    if metric.startswith("MS_SSIM"):  # its coarsest windows see 176 pixels around what is inside
        shape, inside = (192, 420), np.s_[:, :100]
    else:
        shape, inside = (32, 96), np.s_[:, :32]
    rendered, truth = noisy_pair(*shape)
    mask = np.zeros(shape, bool)
    mask[inside] = True
    colour_map = np.eye(3, 4)  # so that what lies outside has no say in the colours
    worse = rendered.copy()
    worse[:, -20:] = 255 - worse[:, -20:]

    captured = TruthFrame(truth)

    def part(frame, where):
        return METRICS[metric].inside(
            FramePair(0, frame, captured, None, MetricOptions(), colour_map), where
        )

    ((_, _, whole),) = score_view([(rendered, truth)], [metric], colour_map=colour_map).values
    assert part(rendered, np.ones(shape, bool)) == pytest.approx(whole, rel=2e-5)
    inner, outer = (abs(part(worse, where) - part(rendered, where)) for where in (mask, ~mask))
    # The deepest features of a network see a hundred pixels to either side.
    assert inner < (0.1 * outer if metric in ("LPIPS", "DISTS") else 1e-6)
    assert outer > 1e-3
    with pytest.raises(MetricError, match=r"the region|no window"):
        part(rendered, np.zeros(shape, bool))


def test_parts_are_scored_by_the_masks_of_the_paper():
    """Every metric of frames, and TCC, has a static and a moving part from the second frame on."""
    truth = [np.ascontiguousarray(data.astronaut()[100:292, 9 * t : 400 + 9 * t]) for t in range(3)]
    for t in range(3):
        truth[t][:, 190:] = truth[0][:, 190:]
    rendered = [round_levels(frame * 0.98 + 3) for frame in truth]
    names = [
        "PSNR",
        "SSIM",
        "L1",
        "IV_PSNR",
        "MS_SSIM",
        "DSSIM1",
        "DSSIM2",
        "PSNR_cc",
        "SSIM_cc",
        "TCC",
    ]
    parts = [f"{name}_{part}" for name in names for part in ("static", "moving")]
    scores = score_view(
        zip(rendered, truth, strict=True), parts, MetricOptions(colour_scope="frame")
    )

    assert scores.not_computed == {}
    frames = {name: [frame for each, frame, _ in scores.values if each == name] for name in parts}
    assert all(frames[name] == ([0, 1] if name.startswith("TCC") else [1, 2]) for name in parts)
    pair = FramePair(1, rendered[1], TruthFrame(truth[1], truth[0]), rendered[0], MetricOptions())
    expected = METRICS["MS_SSIM"].inside(pair, moving_mask(truth[1], truth[0]))
    assert ("MS_SSIM_moving", 1, expected) in scores.values


def test_what_is_absent_has_its_reason(monkeypatch, tmp_path):
    """Without package or weights a metric is not computed, its parts neither, and the
    others are.
    """
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path))
    monkeypatch.setitem(sys.modules, "flip_evaluator", None)
    load_dists_weights.cache_clear()
    rendered, truth = noisy_pair()
    hidden = [np.ones(truth.shape[:2], bool)]
    names = ["PSNR", "FLIP", "DISTS", "PSNR_disoccluded", "FLIP_disoccluded", "DISTS_disoccluded"]
    scores = score_view([(rendered, truth)], names, disoccluded=hidden)
    load_dists_weights.cache_clear()

    assert {name for name, _, _ in scores.values} == {"PSNR", "PSNR_disoccluded"}
    assert (
        scores.not_computed["FLIP"] == "FLIP needs flip-evaluator; `pip install 'ggvs-eval[flip]'`"
    )
    assert scores.not_computed["DISTS"].startswith("DISTS: no weights at")
    assert fetch_dists.FETCH_COMMAND in scores.not_computed["DISTS"]
    assert set(scores.not_computed) == {"FLIP", "DISTS", "FLIP_disoccluded", "DISTS_disoccluded"}
    assert scores.not_computed["FLIP_disoccluded"].startswith("in no frame: FLIP needs")


def test_only_the_authors_file_becomes_weights(tmp_path):
    """A wheel with another hash is refused before anything in it is read, and nothing is kept."""
    wheel = tmp_path / "DISTS_pytorch-0.1-py3-none-any.whl"
    wheel.write_bytes(b"something else")
    with pytest.raises(WeightsError, match=r"wanted sha256 73e54ce1.*move it away and run"):
        fetch_dists.keep_dists_weights(wheel, tmp_path / "weights.safetensors")
    assert list(tmp_path.iterdir()) == [wheel]
