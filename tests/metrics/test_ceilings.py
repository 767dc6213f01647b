"""What perfect renderings could score, estimated from a noisy recording alone, against their true
scores.
"""

import tracemalloc
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval.contrib.study import frame_ladders
from ggvs_eval.errors import MetricError
from ggvs_eval.files.coding import Coding, read_coding
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.ceilings import ceilings
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.metrics.registry import METRICS, ceiling_metrics
from ggvs_eval.metrics.time.flicker import flicker
from ggvs_eval.metrics.time.strred import strred
from ggvs_eval.metrics.time.tcc import tcc
from helpers.noise_scenes import FLICKER_SEED, clean_video, encoded, noisy, panned_video, shot_noise

FRAMES = 30


def scores(rendered, truth):
    """True scores of one view."""
    pairs = list(zip(rendered, truth, strict=True))
    means = {
        "PSNR": np.mean([psnr(*pair) for pair in pairs]),
        "SSIM": np.mean([ssim(*pair) for pair in pairs]),
    }
    return {**means, "TCC": tcc(rendered, truth), "STED": strred(rendered, truth).strred}


@pytest.mark.parametrize(
    ("sigma", "shape", "sted_share"),
    [
        (1.3, (16, 3.3, 144, 192), 0.4),
        pytest.param(shot_noise, (FRAMES,), 0.2, marks=pytest.mark.slow),
    ],
    ids=["white", "shot"],
)
def test_ceilings_are_the_scores_of_perfect_renderings(sigma, shape, sted_share):
    """From a noisy recording alone: what its clean video and what another recording score; STED
    best where much stands still.
    """
    clean = clean_video(*shape)
    captured, again = noisy(clean, sigma, seed=1), noisy(clean, sigma, seed=2)
    found = ceilings(lambda: iter(captured), ceiling_metrics())
    for estimated, rendered in ((found.noise_free, clean), (found.second_recording, again)):
        actual = scores(rendered, captured)
        assert set(estimated) >= set(ceiling_metrics())
        assert estimated["TCC"] == pytest.approx(actual["TCC"], abs=0.02)
        assert estimated["STED"] == pytest.approx(actual["STED"], rel=sted_share)
        assert estimated["PSNR"] == pytest.approx(actual["PSNR"], abs=0.25)
        assert estimated["SSIM"] == pytest.approx(actual["SSIM"], abs=0.003)
    assert found.averaged_share > 0.55
    assert (found.not_computed, found.bounds) == ({}, {})


@pytest.fixture(scope="module")
def accuracy():
    """The benchmark of ceilings, whose films and comparisons these tests share: it is no part of
    the wheel.
    """
    return pytest.importorskip(
        "benchmarks.ceiling_accuracy", reason="benchmarks lie beside the package"
    )


@pytest.fixture(scope="module")
def filmed_twice():
    """Clean frames, and recordings of them with noise of two seeds: strength -> pair."""
    clean = clean_video(16, height=192, width=256)
    return clean, {sigma: [noisy(clean, sigma, seed) for seed in (1, 2)] for sigma in (0.5, 2, 4)}


@pytest.mark.slow
@pytest.mark.parametrize(("crf", "sigma"), [(0, 4), (12, 2)])
def test_ceilings_of_a_room_filmed_twice_and_coded(accuracy, filmed_twice, crf, sigma):
    """From one coded film alone: within what the benchmark tells; behind a codec with loss TCC and
    STED are bounds.
    """
    clean, recordings = filmed_twice
    names = ceiling_metrics() if crf else ("PSNR", "SSIM")
    for kind, comparison in accuracy.compare(clean, *recordings[sigma], crf).items():
        assert set(comparison.bounds) == (
            set() if crf == 0 else {"noise-free": {"TCC", "STED"}, "second": {"STED"}}[kind]
        )
        assert all(comparison.holds(name) for name in names), (kind, comparison)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("crf", "sigma"), [(12, 0.5), pytest.param(23, 2, marks=pytest.mark.proof)]
)
def test_noise_that_the_codec_hides_leaves_bounds(accuracy, filmed_twice, crf, sigma):
    """What is lost cannot be lost again: the noise-free row is a bound that holds, and no second
    recording is predicted.
    """
    clean, recordings = filmed_twice
    compared = accuracy.compare(clean, *recordings[sigma], crf)
    bounded = compared["noise-free"]
    assert bounded.bounds == {
        name: "at most" if METRICS[name].higher_is_better else "at least"
        for name in ceiling_metrics()
    }
    assert all(bounded.holds(name) for name in ceiling_metrics()), bounded
    assert bounded.estimate["PSNR"] < 45  # without the codec 54 and 62 were predicted
    assert compared["second"].estimate == {}


@pytest.mark.slow
def test_noise_of_another_kind_leaves_bounds(filmed_twice, tmp_path):
    """Noise that is smooth in space, as of a camera that denoises, is not filmed again as white
    noise: bounds, and the reason.
    """
    random = np.random.default_rng(1)
    grain = [
        cv2.GaussianBlur(random.normal(size=frame.shape), (0, 0), 1.0) for frame in filmed_twice[0]
    ]
    noisy_frames = [
        round_levels(frame + 2 * one / one.std())
        for frame, one in zip(filmed_twice[0], grain, strict=True)
    ]
    captured = encoded(np.stack(noisy_frames), tmp_path / "coded.mp4", crf=0)
    found = ceilings(
        lambda: iter(captured),
        ["PSNR"],
        coding=read_coding(tmp_path / "coded.mp4", range(len(captured))),
    )
    assert found.bounds == {"PSNR": "at most"}
    assert "not white" in found.second_unknown
    assert found.second_recording == {}


def test_a_coded_view_that_cannot_be_filmed_again_is_unknown(filmed_twice, tmp_path):
    """Another encoder, another size, and frames of a video that come without it: one line each, and
    no number.
    """
    captured = encoded(np.stack(filmed_twice[1][2][0]), tmp_path / "coded.mp4", crf=12)
    coding = read_coding(tmp_path / "coded.mp4", range(len(captured)))
    for unknown, reason in (
        (Coding(unknown="coded by another encoder than x264"), "another encoder than x264"),
        (replace(coding, size=(512, 384)), "coded at 512 x 384, measured at 256 x 192"),
        (None, "give the video itself"),
    ):
        with pytest.raises(MetricError, match=reason):
            ceilings(lambda: iter(captured), ceiling_metrics(), coding=unknown)


@pytest.mark.slow
def test_flicker_as_strong_as_noise_raises_tcc_and_the_ceiling_shows_it():
    """A rendering that flickers by 1 % beats the perfect one in TCC; beside the ceiling it is
    farther off, and flicker tells.
    """
    clean = clean_video(FRAMES)
    captured, unsteady = noisy(clean, 2.0, seed=1), frame_ladders.flicker(clean, 1.0, FLICKER_SEED)
    perfect_tcc, unsteady_tcc = tcc(clean, captured), tcc(unsteady, captured)
    assert unsteady_tcc > perfect_tcc + 0.1
    ceiling = ceilings(lambda: iter(captured), metrics=["TCC"]).noise_free["TCC"]
    assert abs(perfect_tcc - ceiling) < 0.02
    assert unsteady_tcc - ceiling > 0.1
    perfect_flicker, unsteady_flicker = (
        flicker(zip(video, captured, strict=True)) for video in (clean, unsteady)
    )
    assert perfect_flicker.error < 0.1 < 1.5 < unsteady_flicker.error
    assert abs(perfect_flicker.excess) < 0.3 < 1.5 < unsteady_flicker.excess


def test_equal_seeds_give_equal_bits_in_two_passes():
    """The frames are read twice, the result is a function of frames and seed, and another seed
    moves only what is drawn.
    """
    captured, passes = noisy(clean_video(8)[:, :97, :131], 2.0, seed=1), []

    def frames():
        passes.append(1)
        return iter(captured)

    first, again, other = (
        ceilings(frames, metrics=["PSNR", "TCC"], seed=seed) for seed in (3, 3, 4)
    )
    assert len(passes) == 6
    assert (first.noise_free, first.second_recording) == (again.noise_free, again.second_recording)
    assert first.second_recording != other.second_recording
    assert first.second_recording["TCC"] == pytest.approx(other.second_recording["TCC"], abs=0.02)


def test_a_capture_without_noise_can_be_matched():
    """Where nothing is noisy and nothing moves, both perfect renderings reach the best score of
    every metric.
    """
    found = ceilings(lambda: iter([clean_video(1)[0]] * 5), ceiling_metrics())
    for perfect in (found.noise_free, found.second_recording):
        assert {name: perfect[name] for name in ceiling_metrics()} == {
            "PSNR": 100.0,
            "SSIM": 1.0,
            "TCC": 1.0,
            "STED": 0.0,
        }


def test_what_cannot_be_computed_has_a_reason():
    """Frames too small for STED leave the other ceilings; a moving camera and a single frame are
    refused, with the reason.
    """
    small = noisy(clean_video(6)[:, :40, :88], 1.5, seed=1)
    found = ceilings(lambda: iter(small), ceiling_metrics())
    assert "48" in found.not_computed["STED"]
    assert set(found.noise_free) == {"PSNR", "SSIM", "TCC"}
    with pytest.raises(MetricError, match="to be static"):
        ceilings(lambda: iter(panned_video()), ceiling_metrics())
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        ceilings(lambda: iter(clean_video(1)), ceiling_metrics())


@pytest.mark.slow
def test_memory_does_not_grow_with_the_length_of_the_video():
    """Four times as many frames, made one by one, need no more memory."""
    still = clean_video(1)[0]

    def peak(count):
        tracemalloc.start()
        random = np.random.default_rng(1)
        ceilings(
            lambda: (
                np.clip(still + random.normal(0, 2, still.shape), 0, 255).astype(np.uint8)
                for _ in range(count)
            ),
            ["TCC"],
        )
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(4)  # loads what is loaded once
    assert peak(16) < 1.2 * peak(4)
