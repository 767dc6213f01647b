"""Conventions of IV-PSNR, D-SSIM, FLIP, DISTS, VMAF and ColorVideoVDP."""

import cv2
import numpy as np
import pytest
from PIL import Image
from skimage import data
from skimage.metrics import structural_similarity

from ggvs_eval.contrib.explain.explain import explain
from ggvs_eval.contrib.more_metrics.colour_video_vdp import load_package
from ggvs_eval.contrib.more_metrics.dists import dists
from ggvs_eval.contrib.more_metrics.fetch_dists import dists_weights_path
from ggvs_eval.contrib.more_metrics.iv_psnr import WEIGHTS
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics.image.lpips_network import weights_path
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from helpers.twins.iv_psnr import iv_psnr_twin

N_FRAMES, SHAPE = 3, (64, 80)


TRUTH = [
    np.ascontiguousarray(data.astronaut()[60 + t : 60 + t + SHAPE[0], 80 : 80 + SHAPE[1]])
    for t in range(N_FRAMES)
]
RENDERED = [round_levels(cv2.GaussianBlur(frame, (0, 0), 0.7) * (1.03, 1, 0.98)) for frame in TRUTH]


def view_of(rendered=RENDERED, truth=TRUTH) -> dict[str, ViewFrames]:
    return {"cam00": ViewFrames(lambda t: rendered[t], lambda t: truth[t], range(len(truth)))}


def mean_over_frames(measure) -> float:
    return float(np.mean([measure(*pair) for pair in zip(RENDERED, TRUTH, strict=True)]))


def matching(metric: str, value: float, digits: int = 4) -> dict[str, bool]:
    """Name of each convention that gives a value, and whether it is the tables' own."""
    return {
        one.name: one.is_ours
        for one in explain(metric, f"{value:.{digits}f}", view_of())
        if one.matches
    }


def iv_psnr_of_jpegs_colours(rendered, truth) -> float:
    first, second = (
        np.asarray(Image.fromarray(image).convert("YCbCr")) for image in (rendered, truth)
    )
    errors, _, _, count = iv_psnr_twin(first, second)
    return float((10 * np.log10(255**2 * count / np.maximum(errors, 1)) @ WEIGHTS).min())


def test_iv_psnr_of_the_older_matrix_is_told():
    """On Pillow's YCbCr, which is JPEG's: BT.601 without headroom."""
    assert "YCbCr of BT.601 without headroom, full chroma" in matching(
        "iv-psnr", mean_over_frames(iv_psnr_of_jpegs_colours), 1
    )


@pytest.mark.slow
def test_either_dssim_is_ours():
    """D-SSIM 1 and 2 are told apart, and both stand in our tables."""
    for data_range in (1, 2):

        def dissimilarity(rendered, truth, levels=float(data_range)):
            return (
                1
                - structural_similarity(
                    rendered / 255, truth / 255, data_range=levels, channel_axis=2
                )
            ) / 2

        names = matching("dssim", mean_over_frames(dissimilarity), 6)
        assert list(names.values()) == [True]
        assert f"uniform 7 x 7, range {data_range}" in next(iter(names))


def test_flips_median_is_told_from_its_mean():
    """What the library's own map gives."""
    flip_evaluator = pytest.importorskip("flip_evaluator")

    def middle(rendered, truth):
        images = (
            np.ascontiguousarray(image / 255, dtype=np.float32) for image in (truth, rendered)
        )
        return float(np.median(flip_evaluator.evaluate(*images, "LDR", applyMagma=False)[0]))

    conventions = explain(
        "flip", f"{middle(RENDERED[0], TRUTH[0]):.4f}", view_of(RENDERED[:1], TRUTH[:1])
    )
    assert [one.name for one in conventions if one.matches] == ["median, 67 pixels per degree"]


@pytest.mark.skipif(
    not (dists_weights_path().is_file() and weights_path("vgg").is_file()),
    reason="no weights of DISTS",
)
@pytest.mark.proof
def test_dists_of_half_size_is_told():
    """A number of smaller frames is recognised as that."""
    halves = [
        [cv2.resize(frame, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA) for frame in pair]
        for pair in (RENDERED, TRUTH)
    ]
    value = float(np.mean([dists(*pair) for pair in zip(*halves, strict=True)]))
    assert "both at half size" in matching("dists", value, 5)


def test_vmafs_models_and_averages_are_told_apart():
    """The harmonic mean of the values that one frame after another gets."""
    pytest.importorskip("imageio_ffmpeg")
    from ggvs_eval.contrib.more_metrics.vmaf import vmaf

    values = np.array(vmaf(zip(RENDERED, TRUTH, strict=True)))
    assert matching("vmaf", values.mean())["vmaf_v0.6.1, BT.709, mean over frames"]
    harmonic = len(values) / (1 / (values + 1)).sum() - 1
    assert "vmaf_v0.6.1, BT.709, harmonic mean over frames" in matching("vmaf", harmonic)


def test_the_display_of_colour_video_vdp_is_told():
    """Ours is the 4K display at 30 frames per second; the others have other values."""
    try:
        load_package()
    except MetricError as error:
        pytest.skip(str(error))
    rows = {one.name: one for one in explain("cvvdp", "9.9", view_of(RENDERED[:2], TRUTH[:2]))}
    assert [name for name, one in rows.items() if one.is_ours] == [
        "standard_4k, 30 frames per second"
    ]
    assert len(rows) == 4
    assert (
        rows["standard_fhd, 30 frames per second"].value
        < rows["standard_4k, 30 frames per second"].value - 0.01
    )
