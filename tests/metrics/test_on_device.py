"""Metrics on a device give what they give on the CPU: ``cpu:0`` is a device like any other to them,
and the one that is here.
"""

from typing import Any

import numpy as np
import pytest
import torch
from skimage import data
from skimage.metrics import structural_similarity

from ggvs_eval.metrics import on_device
from ggvs_eval.metrics.image.ssim import SSIM_VARIANTS, device_ssim, ssim_map
from ggvs_eval.metrics.metric import MetricOptions, TruthFrame, ViewMetric
from ggvs_eval.metrics.registry import METRICS
from ggvs_eval.metrics.stream import score_views
from ggvs_eval.metrics.time.strred import device_band, luma, spatial_band
from ggvs_eval.pipelines.run.score_view import _metric_inputs

HERE = "cpu:0"
COMPUTED = ("PSNR", "SSIM", "L1", "TCC", "STED", "STED_ssn", "SDT")


def clip(height: int, width: int, frames: int = 4) -> list[tuple[np.ndarray, np.ndarray]]:
    """A photograph that moves, noisy as rendered and as captured."""
    random, photograph = np.random.default_rng(height), data.astronaut()
    moving = [
        photograph[40 : 40 + height, 60 + t : 60 + t + width].astype(int) for t in range(frames)
    ]
    return [
        tuple(
            np.clip(image + random.integers(-9, 10, image.shape), 0, 255).astype(np.uint8)
            for _ in range(2)
        )
        for image in moving
    ]


def uploaded(image: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(image).to(HERE)


@pytest.mark.parametrize("name", SSIM_VARIANTS)
# of one window, of a frame
@pytest.mark.parametrize(("size", "tolerance"), [((11, 11), 1e-4), ((90, 110), 2e-6)])
def test_every_ssim_is_that_of_the_cpu(name, size, tolerance):
    """Each channel, as near as single precision on the CPU lets it be."""
    ((rendered, truth),) = clip(*size, frames=1)
    values = device_ssim(uploaded(rendered), uploaded(truth), name)
    expected = ssim_map(rendered, truth, name).mean(axis=(0, 1), dtype=np.float64)
    np.testing.assert_allclose(values, expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize(
    ("name", "options"),
    [
        (
            "gaussian-valid",
            {
                "gaussian_weights": True,
                "sigma": 1.5,
                "use_sample_covariance": False,
                "data_range": 255,
            },
        ),
        ("uniform7", {"data_range": 255}),
        ("uniform7-range2", {"data_range": 2 * 255}),
    ],
)
def test_ssim_is_that_of_scikit_image(name, options):
    """Both in double precision, so to its rounding."""
    ((rendered, truth),) = clip(40, 53, frames=1)
    expected = structural_similarity(truth, rendered, channel_axis=2, **options)
    value = device_ssim(uploaded(rendered), uploaded(truth), name).mean()
    assert value == pytest.approx(expected, abs=1e-12)


@pytest.mark.parametrize("size", [(48, 48), (97, 131)])
def test_bands_are_those_of_the_cpu(size):
    """Sizes that no halving divides, and the smallest."""
    ((image, _),) = clip(*size, frames=1)
    np.testing.assert_allclose(
        device_band(uploaded(image)), spatial_band(luma(image)), rtol=0, atol=1e-4
    )


def scores(
    device: str, frames: list[tuple[np.ndarray, np.ndarray]]
) -> tuple[dict[Any, float], dict[str, str]]:
    """Values by metric and frame, and the reasons for those that are missing."""
    (scored,) = score_views(
        [([rendered], truth) for rendered, truth in frames], COMPUTED, MetricOptions(device=device)
    )
    return {(name, index): value for name, index, value in scored.values}, scored.not_computed


def test_a_view_has_the_scores_of_the_cpu():
    """All metrics side by side, value by value."""
    frames = clip(64, 80)
    there, reasons = scores(HERE, frames)
    here, _ = scores("cpu", frames)
    assert reasons == {}
    assert there == pytest.approx(here, rel=1e-4)


def test_too_small_or_too_few_is_told_as_on_the_cpu():
    """The reasons are the same words."""
    for frames in (clip(10, 40), clip(64, 80, frames=1)):
        assert scores(HERE, frames)[1] == scores("cpu", frames)[1] != {}


def test_each_frame_is_uploaded_once(monkeypatch):
    """SSIM, TCC and STED share the upload of a rendering, and all renderings that of the captured
    frame.
    """
    uploads, upload = [], on_device.upload
    monkeypatch.setattr(
        on_device,
        "upload",
        lambda image, device: uploads.append(id(image)) or upload(image, device),
    )
    frames = [
        ([rendered, rendered[::-1].copy()], truth) for rendered, truth in clip(48, 48, frames=3)
    ]
    score_views(frames, ("SSIM", "TCC", "STED"), MetricOptions(device=HERE))
    assert len(uploads) == len(set(uploads)) == 9


def test_an_upload_lives_as_long_as_its_frame():
    """Another rendering never gets the tensor of one that is gone."""
    truth = TruthFrame(np.zeros((4, 4, 3), np.uint8))
    for level in range(5):
        ours, _ = on_device.upload_pair(np.full((4, 4, 3), level, np.uint8), truth, HERE)
        assert (ours == level).all()


def test_values_of_a_device_are_told_from_those_of_the_cpu():
    """A metric that computes there goes stale when the device changes, and no other does."""
    metrics = [metric for metric in METRICS.values() if isinstance(metric, ViewMetric)]
    moved = {
        metric.name
        for metric in metrics
        if _metric_inputs(metric, MetricOptions(device="cuda"))
        != _metric_inputs(metric, MetricOptions())
    }
    networks = {
        f"{name}{part}"
        for name in ("LPIPS", "LPIPS_cc", "DISTS")
        for part in ("", "_static", "_moving", "_disoccluded")
    }
    assert moved == networks | {"SSIM", "TCC", "STED", "STED_ssn", "CVVDP"}
    assert "device" not in _metric_inputs(METRICS["LPIPS"], MetricOptions())


@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here")
def test_a_gpu_gives_the_same_scores():
    """The same values as on the CPU, and the same bits twice."""
    frames = clip(200, 300)
    first, second = (scores("cuda", frames)[0] for _ in range(2))
    assert first == second
    assert first == pytest.approx(scores("cpu", frames)[0], rel=1e-4)
