"""What perfect renderings could score, estimated from a noisy recording alone, against their true scores."""

import tracemalloc

import numpy as np
import pytest

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.ceilings import ceilings
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.metrics.image.ssim import ssim
from ggvs_eval.metrics.registry import ceiling_metrics
from ggvs_eval.metrics.time.flicker import flicker
from ggvs_eval.metrics.time.strred import strred
from ggvs_eval.metrics.time.tcc import tcc
from helpers.noise_scenes import clean_video, encoded, flickering, noisy, panned_video, shot_noise

pytestmark = pytest.mark.slow

FRAMES = 30


def scores(rendered, truth):
    """True scores of one view."""
    pairs = list(zip(rendered, truth, strict=True))
    means = {"PSNR": np.mean([psnr(*pair) for pair in pairs]), "SSIM": np.mean([ssim(*pair) for pair in pairs])}
    return {**means, "TCC": tcc(rendered, truth), "STED": strred(rendered, truth).strred}


@pytest.mark.parametrize("sigma", [1.3, shot_noise], ids=["white", "shot"])
def test_ceilings_are_the_scores_of_perfect_renderings(sigma):
    """From a noisy recording alone: what its clean video and what another recording score, TCC within 0.02, STED within 20 %,
    PSNR within 0.25 dB, SSIM within 0.003.
    """
    clean = clean_video(FRAMES)
    captured, again = noisy(clean, sigma, seed=1), noisy(clean, sigma, seed=2)
    found = ceilings(lambda: iter(captured), ceiling_metrics())
    for estimated, rendered in ((found.noise_free, clean), (found.second_recording, again)):
        actual = scores(rendered, captured)
        assert set(estimated) >= set(ceiling_metrics())
        assert estimated["TCC"] == pytest.approx(actual["TCC"], abs=0.02)
        assert estimated["STED"] == pytest.approx(actual["STED"], rel=0.2)
        assert estimated["PSNR"] == pytest.approx(actual["PSNR"], abs=0.25)
        assert estimated["SSIM"] == pytest.approx(actual["SSIM"], abs=0.003)
    assert found.averaged_share > 0.75
    assert found.not_computed == {}


def test_ceilings_of_a_camera_that_stores_h264(tmp_path):
    """TCC within 0.03 and STED of a second recording within 35 % where a codec has smoothed and held the noise (crf 12)."""
    clean = clean_video(FRAMES)
    captured, again = (encoded(noisy(clean, 2.0, seed), tmp_path / f"{seed}.mp4", crf=12) for seed in (1, 2))
    found = ceilings(lambda: iter(captured), ceiling_metrics())
    assert found.noise_free["TCC"] == pytest.approx(tcc(clean, captured), abs=0.03)
    assert found.second_recording["TCC"] == pytest.approx(tcc(again, captured), abs=0.03)
    assert found.second_recording["STED"] == pytest.approx(strred(again, captured).strred, rel=0.35)


def test_flicker_as_strong_as_noise_raises_tcc_and_the_ceiling_shows_it():
    """A rendering that flickers by 1 % beats the perfect one in TCC; beside the ceiling it is farther off, and flicker tells."""
    clean = clean_video(FRAMES)
    captured, unsteady = noisy(clean, 2.0, seed=1), flickering(clean, 0.01)
    perfect_tcc, unsteady_tcc = tcc(clean, captured), tcc(unsteady, captured)
    assert unsteady_tcc > perfect_tcc + 0.1
    ceiling = ceilings(lambda: iter(captured), metrics=["TCC"]).noise_free["TCC"]
    assert abs(perfect_tcc - ceiling) < 0.02
    assert unsteady_tcc - ceiling > 0.1
    perfect_flicker, unsteady_flicker = (flicker(zip(video, captured, strict=True)) for video in (clean, unsteady))
    assert perfect_flicker.error < 0.1 < 1.5 < unsteady_flicker.error
    assert abs(perfect_flicker.excess) < 0.3 < 1.5 < unsteady_flicker.excess


def test_equal_seeds_give_equal_bits_in_two_passes():
    """The frames are read twice, the result is a function of frames and seed, and another seed moves only what is drawn."""
    captured, passes = noisy(clean_video(8)[:, :97, :131], 2.0, seed=1), []

    def frames():
        passes.append(1)
        return iter(captured)

    first, again, other = (ceilings(frames, metrics=["PSNR", "TCC"], seed=seed) for seed in (3, 3, 4))
    assert len(passes) == 6
    assert (first.noise_free, first.second_recording) == (again.noise_free, again.second_recording)
    assert first.second_recording != other.second_recording
    assert first.second_recording["TCC"] == pytest.approx(other.second_recording["TCC"], abs=0.02)


def test_a_capture_without_noise_can_be_matched():
    """Where nothing is noisy and nothing moves, both perfect renderings reach the best score of every metric."""
    found = ceilings(lambda: iter([clean_video(1)[0]] * 5), ceiling_metrics())
    for perfect in (found.noise_free, found.second_recording):
        assert {name: perfect[name] for name in ceiling_metrics()} == {"PSNR": 100.0, "SSIM": 1.0, "TCC": 1.0, "STED": 0.0}


def test_what_cannot_be_computed_has_a_reason():
    """Frames too small for STED leave the other ceilings; a moving camera and a single frame are refused, with the reason."""
    small = noisy(clean_video(6)[:, :40, :88], 1.5, seed=1)
    found = ceilings(lambda: iter(small), ceiling_metrics())
    assert "48" in found.not_computed["STED"]
    assert set(found.noise_free) == {"PSNR", "SSIM", "TCC"}
    with pytest.raises(MetricError, match="to stand still"):
        ceilings(lambda: iter(panned_video()), ceiling_metrics())
    with pytest.raises(MetricError, match="1 frame; needs 2"):
        ceilings(lambda: iter(clean_video(1)), ceiling_metrics())


def test_memory_does_not_grow_with_the_length_of_the_video():
    """Four times as many frames, made one by one, need no more memory."""
    still = clean_video(1)[0]

    def peak(count):
        tracemalloc.start()
        random = np.random.default_rng(1)
        ceilings(
            lambda: (np.clip(still + random.normal(0, 2, still.shape), 0, 255).astype(np.uint8) for _ in range(count)), ["TCC"]
        )
        _, most = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        return most

    peak(4)  # loads what is loaded once
    assert peak(16) < 1.2 * peak(4)
