"""Ways of measuring: frames prepared as published evaluators prepare them, checked against
scikit-image.
"""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from skimage.metrics import peak_signal_noise_ratio, structural_similarity

from ggvs_eval.measured_frames import measured_frame, measured_mask
from ggvs_eval.metrics.stream import score_view
from ggvs_eval.pipelines.run.score_view import metric_options
from ggvs_eval.protocol import Measurement, load_protocol, packaged_protocols
from ggvs_eval.reports.tables.published import community_beside

SIZE = (1008, 756)


def measured_as(way):
    return Measurement(("PSNR", "SSIM"), as_=way)


def pictures(count, size=SIZE):
    """Smooth random frames and noisy copies of them, 8 bit."""
    random = np.random.default_rng(5)
    width, height = size
    for _ in range(count):
        truth = cv2.resize(
            random.random((height // 12, width // 12, 3)), size, interpolation=cv2.INTER_CUBIC
        ).clip(0, 1)
        rendered = (truth + random.normal(0, 0.03, truth.shape)).clip(0, 1)
        yield np.rint(255 * rendered).astype(np.uint8), np.rint(255 * truth).astype(np.uint8)


def by_hand(rendered, truth, resized):
    """PSNR and SSIM as the evaluators write them: float frames, a tenth cut, scikit-image without a
    range, which was 2.
    """
    frames = [image.astype(np.float64) / 255 for image in (rendered, truth)]
    if resized:
        frames = [cv2.resize(image, (960, 640)) for image in frames]
    rows, columns = frames[0].shape[0] // 10, frames[0].shape[1] // 10
    first, second = (image[rows:-rows, columns:-columns] for image in frames)
    return {
        "PSNR": peak_signal_noise_ratio(second, first, data_range=1),
        "SSIM": structural_similarity(first, second, channel_axis=2, data_range=2.0),
    }


@pytest.mark.parametrize(("way", "resized"), [("mvsnerf", True), ("enerf", False)])
def test_pictures_have_the_values_of_the_authors_steps(way, resized):
    """PSNR to 1e-6 dB and SSIM to 1e-5 of the same steps by scikit-image."""
    measurement = measured_as(way)
    for rendered, truth in pictures(1):
        pair = measured_frame(rendered, measurement), measured_frame(truth, measurement)
        scored = score_view(iter([pair]), ("PSNR", "SSIM"), metric_options(measurement))
        known = by_hand(rendered, truth, resized)
        for metric, _, value in scored.values:
            assert value == pytest.approx(known[metric], abs=1e-6 if metric == "PSNR" else 1e-5)


def test_the_range_of_ssim_is_two():
    """SSIM of range 2 is that of frames at half the brightness with range 1, and higher than that
    of range 1.
    """
    (rendered, truth), *_ = pictures(1)
    both = [
        structural_similarity(
            rendered / (255 * scale), truth / (255 * scale), channel_axis=2, data_range=1
        )
        for scale in (2, 1)
    ]
    pair = (
        measured_frame(rendered, measured_as("as-is")),
        measured_frame(truth, measured_as("as-is")),
    )
    value = score_view(iter([pair]), ("SSIM",), metric_options(measured_as("enerf"))).values[0][2]
    assert value == pytest.approx(both[0], abs=1e-5)
    assert value > both[1] + 0.01


def test_a_tenth_is_cut_rounded_down():
    """Of 1008 x 756 pixels 100 columns and 75 rows go: an error in row 75 counts, one in row 74
    does not.
    """
    truth = np.zeros((756, 1008, 3), np.uint8)
    for row, counts in ((74, False), (75, True)):
        rendered = truth.copy()
        rendered[row] = 200
        assert measured_frame(rendered, measured_as("enerf")).any() == counts
    assert measured_frame(truth, measured_as("enerf")).shape == (606, 808, 3)
    assert measured_frame(truth, measured_as("mvsnerf")).shape == (512, 768, 3)
    assert measured_mask(truth[..., 0], measured_as("mvsnerf")).shape == (512, 768)


def test_frames_are_not_rounded_after_resizing():
    """What is resized stays in floats in [0, 1]; frames that are not resized stay 8 bit."""
    (rendered, _), *_ = pictures(1)
    resized = measured_frame(rendered, measured_as("mvsnerf"))
    assert resized.dtype == np.float64
    assert 0 <= resized.min() <= resized.max() <= 1
    assert np.abs(255 * resized - np.rint(255 * resized)).max() > 0.1
    assert measured_frame(rendered, measured_as("as-is")) is rendered
    assert measured_frame(rendered, measured_as("enerf")).dtype == np.uint8


def test_the_way_is_part_of_the_protocol():
    """Another way is another hash; a protocol without one keeps its own, and the key of a file is
    `as`.
    """
    protocol = load_protocol("llff_3view_fern")
    assert protocol.measurement.as_ == "mvsnerf"
    assert '\nas = "mvsnerf"\n' in protocol.to_toml()
    plain = replace(protocol, measurement=replace(protocol.measurement, as_="as-is"))
    assert plain.sha256 != protocol.sha256
    assert "\nas =" not in plain.to_toml()


@pytest.mark.parametrize(
    "name", [name for name in packaged_protocols() if name.startswith("llff_3view")]
)
def test_published_values_are_shown_under_their_way_alone(name):
    """IBRNet's row is there where frames are measured as the notebook does, and gone by another
    way.
    """
    protocol, scene = load_protocol(name), name.removeprefix("llff_3view_")
    assert (len(protocol.views.test), len(protocol.views.sources), protocol.synthesis.k) == (
        4,
        16,
        3,
    )
    assert not set(protocol.views.test) & set(protocol.views.sources)
    run = SimpleNamespace(protocol=protocol, scene=scene, is_demo=False)
    rows, _ = community_beside("quality", protocol.dataset, ("PSNR", "SSIM", "LPIPS"), [run])
    names = [row.name for row in rows]
    assert f"IBRNet, fitted to the scene (published, {scene})" in names
    other = replace(protocol, measurement=replace(protocol.measurement, as_="as-is"))
    run.protocol = other
    assert community_beside("quality", protocol.dataset, ("PSNR",), [run])[0] == ()
