"""VMAF and ColorVideoVDP against outside runs of their programs, and what happens where these are
absent.
"""

import sys

import cv2
import numpy as np
import pytest
from skimage import data

from ggvs_eval.contrib.more_metrics import colour_video_vdp as vdp
from ggvs_eval.contrib.more_metrics import vmaf as vmaf_module
from ggvs_eval.contrib.more_metrics.vmaf import vmaf
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.stream import score_view
from helpers.refusals import refused

FRAMES, HEIGHT, WIDTH = 6, 120, 160


def video(frames=FRAMES, height=HEIGHT, width=WIDTH):
    """A pan over a photograph, and the same blurred and with noise; pairs of uint8."""
    photograph, random = data.astronaut(), np.random.default_rng(0)
    pairs = []
    for t in range(frames):
        truth = np.ascontiguousarray(
            photograph[100 + t : 100 + t + height, 150 + 2 * t : 150 + 2 * t + width]
        )
        blurred = cv2.GaussianBlur(truth, (0, 0), 1.0) + random.normal(0, 6, truth.shape)
        pairs.append((round_levels(blurred), truth))
    return pairs


def test_vmaf_equals_a_run_of_ffmpeg_on_the_same_pictures():
    """The values per frame of a run by hand, November 2026, on the frames below as PNG files, read
    by ffmpeg itself.

    ffmpeg of imageio-ffmpeg 0.8.1 (libvmaf 3): ``ffmpeg -i r%03d.png -i t%03d.png -lavfi
    "[0:v]C[a];[1:v]C[b];[a][b]libvmaf= log_fmt=csv:log_path=v.csv" -f null -`` with ``C`` for
    ``scale=out_color_matrix=bt709:out_range=tv,format=yuv420p``.
    """
    pytest.importorskip("imageio_ffmpeg")
    pairs = video()
    by_hand = [70.069538, 79.177140, 78.509543, 78.456714, 79.103893, 78.698894]

    scores = score_view(pairs, ["VMAF_v0"])

    assert scores.not_computed == {}
    assert [frame for _, frame, _ in scores.values] == list(range(FRAMES))
    assert [value for _, _, value in scores.values] == pytest.approx(by_hand, abs=1e-4)


def test_the_model_of_2026_is_a_column_of_its_own(monkeypatch):
    """As a run of ffmpeg by hand on the same frames; where libvmaf lacks the model, that column
    alone has a reason.
    """
    pytest.importorskip("imageio_ffmpeg")
    pairs = video(3, 180, 240)
    by_hand = [73.453350, 73.833751, 74.913046]
    scores = score_view(pairs, ["VMAF_v1", "VMAF_v0"])
    assert [value for name, _, value in scores.values if name == "VMAF_v1"] == pytest.approx(
        by_hand, abs=1e-4
    )

    monkeypatch.setattr(vmaf_module.VmafV1Scorer, "model", "vmaf_v9.9.9")
    scores = score_view(pairs, ["VMAF_v1", "VMAF_v0"])
    assert set(scores.not_computed) == {"VMAF_v1"}
    assert "vmaf_v9.9.9" in scores.not_computed["VMAF_v1"]
    assert {name for name, _, _ in scores.values} == {"VMAF_v0"}


def test_vmaf_that_cannot_run_says_why(monkeypatch):
    """No package, a program that fails, frames that are too small: one reason each, and no
    traceback.
    """
    pairs = video(2)
    monkeypatch.setattr(vmaf_module, "find_ffmpeg", lambda: sys.executable)
    with refused(MetricError, "vmaf_v0.6.1", "ffmpeg failed"):
        vmaf(pairs)
    monkeypatch.undo()
    with refused(MetricError, "32 x 32", "(20, 160)"):
        vmaf([(truth[:20], truth[:20]) for _, truth in pairs])
    with refused(MetricError, "160 x 216", "(120, 160)"):
        vmaf(pairs, vmaf_module.MODEL_V1)
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    scores = score_view(pairs, ["VMAF_v0", "PSNR"])
    assert scores.not_computed == {
        "VMAF_v0": "VMAF needs the ffmpeg of imageio-ffmpeg; `pip install 'ggvs-eval[vmaf]'`"
    }
    assert {name for name, _, _ in scores.values} == {"PSNR"}


def test_colour_video_vdp_equals_its_package():
    """9.0416346 JOD of three frames.

    Outside run, November 2026: cvvdp 0.5.7 imported whole, with torchvision 0.28.0's own blur:
    ``pycvvdp.cvvdp(display_name="standard_4k").predict(rendered, truth, dim_order="FHWC",
    frames_per_second=30)``, which calls itself v0.5.7, 75.4 pix/deg, Lpeak=200, Lblack=0.2,
    Lrefl=0.3979 cd/m^2.
    """
    try:
        vdp.load_package()
    except MetricError as error:
        pytest.skip(str(error))
    scores = score_view(video(3), ["CVVDP"])
    assert scores.not_computed == {}
    ((name, frame, value),) = scores.values
    assert (name, frame) == ("CVVDP", None)
    assert value == pytest.approx(9.041634560, abs=1e-5)


def test_colour_video_vdp_that_is_absent_says_so(monkeypatch):
    """No package: not computed, with the extra that brings it."""
    monkeypatch.setattr(vdp, "find_spec", lambda name: None)
    vdp.load_package.cache_clear()
    scores = score_view(video(2), ["CVVDP"])
    vdp.load_package.cache_clear()
    assert scores.not_computed == {
        "CVVDP": "ColorVideoVDP needs cvvdp; `pip install 'ggvs-eval[cvvdp]'`"
    }


def test_the_substituted_blur_is_a_gaussian_one():
    """Against scipy's, mirrored at the border without repeating its edge."""
    import torch
    from scipy.ndimage import gaussian_filter

    image = np.random.default_rng(0).random((40, 50))
    blurred = vdp.GaussianBlur(13, 3.0).forward(torch.from_numpy(image)[None, None])
    np.testing.assert_allclose(
        blurred[0, 0].numpy(), gaussian_filter(image, 3.0, mode="mirror", radius=6), atol=1e-12
    )
