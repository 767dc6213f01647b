"""IterMVS: names and shapes of the published checkpoint, outputs equal to the authors', and its
place in the depth of a rig.
"""

import json
from dataclasses import replace

import numpy as np
import pytest
import torch

from ggvs_eval.compute_device import rendering_on
from ggvs_eval.depth_options import DepthRunOptions, cached_weights
from ggvs_eval.depth_store import DepthMap, DepthStore
from ggvs_eval.errors import DepthError, WeightsError
from ggvs_eval.pipelines.offline.depth import consistency
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FILLED_CONFIDENCE,
    DepthEstimator,
    DepthOptions,
    check_depth,
    finish,
)
from ggvs_eval.pipelines.offline.depth.fill_store import plan_depth, prepare_depth
from ggvs_eval.pipelines.offline.itermvs.estimator import (
    MOST_RECORDINGS,
    IterMvs,
    IterMvsEstimator,
    IterMvsRig,
    load_network,
)
from ggvs_eval.pipelines.offline.itermvs.network import IterMvsNetwork, MatchedViews
from helpers.itermvs_weights import write_checkpoint
from helpers.places import DATA_FOLDER, SHARED
from helpers.recordable import forbidden_operations
from helpers.seeded_baselines import seed_weights, turned_rig
from helpers.stereo_scenes import look_from, plane_depth, see_plane, write_capture

PUBLISHED_FILE = SHARED / "weights" / "itermvs_blendedmvs_000015.ckpt"
MATCHED = [(0, 1, 2, 3), (2, 0, 1), (3, 2, 1, 0)]  # cameras of a rig of four and their partners


@pytest.fixture(scope="module")
def network():
    """The network with seeded weights."""
    return seed_weights(IterMvsNetwork()).requires_grad_(False)


@pytest.fixture(scope="module")
def weights(network, tmp_path_factory):
    """A checkpoint as the authors write it."""
    return write_checkpoint(tmp_path_factory.mktemp("itermvs") / "model.ckpt", network)


@pytest.fixture(scope="module")
def golden():
    """Outputs of the authors' code on the same weights (tests/data/ITERMVS_ORACLES.md)."""
    return np.load(DATA_FOLDER / "itermvs_golden.npz")


def rig_and_images():
    """The rig of the golden outputs, depth range 2 to 8."""
    sources = turned_rig(3).sources
    return [replace(each.camera, near=2.0, far=8.0) for each in sources], [
        each.image for each in sources
    ]


def rig_of_four(width=96, height=64):
    """Four cameras with ranges of their own, and what they see."""
    sources = turned_rig(4, width, height).sources
    return [
        replace(each.camera, near=2.0 + 0.1 * k, far=8.0 + k) for k, each in enumerate(sources)
    ], [s.image for s in sources]


def as_arrays(maps):
    """Depth and confidence of each map as copies."""
    return [tuple(each.numpy().copy() for each in both) for both in maps]


def alone(weights, cameras, images, matched=MATCHED):
    """Each map of a rig by an estimator of its own."""
    chosen = [
        ([cameras[index] for index in each], [images[index] for index in each]) for each in matched
    ]
    return [
        (found.depth, found.confidence) for found in (estimate(weights, *each) for each in chosen)
    ]


def assert_same_bits(maps, others):
    assert len(maps) == len(others)
    for there, here in zip(maps, others, strict=True):
        for one, other in zip(there, here, strict=True):
            np.testing.assert_array_equal(one, other)


def assert_alike(maps, others):
    """Within 1e-4, as the authors' own values: libraries cut convolutions of several images
    otherwise on each processor.
    """
    for there, here in zip(maps, others, strict=True):
        for one, other in zip(there, here, strict=True):
            assert one.shape == other.shape
            assert np.mean(np.abs(one - other) <= 1e-4 * np.maximum(other, 0.1)) > 0.999


def estimate(weights, cameras, images):
    """Depth of the first camera with the others as its partners."""
    return IterMvsEstimator(cameras[0], cameras[1:], IterMvs(weights, "")).estimate(
        images[0], images[1:]
    )


@pytest.mark.filterwarnings("ignore:for .* to a meta parameter")
def test_a_device_that_asks_first_leaves_the_cpu_its_own_network(weights):
    """One that was kept and moved would be computed with where it no longer lies."""
    with rendering_on(torch.device("meta")):
        load_network(weights, torch.device("meta"))
    assert {
        each.device.type for each in load_network(weights, torch.device("cpu")).parameters()
    } == {"cpu"}


def test_names_and_shapes_are_those_of_the_checkpoint():
    """Every parameter and buffer of the authors' network exists under its name with its shape, and
    no other.
    """
    oracle = json.loads((DATA_FOLDER / "itermvs_state_dict.json").read_text())
    network = IterMvsNetwork()
    assert {name: list(tensor.shape) for name, tensor in network.state_dict().items()} == oracle[
        "model"
    ]
    assert sum(parameter.numel() for parameter in network.parameters()) == oracle["n_params"]


def test_depth_is_the_authors(weights, golden):
    """Depth and confidence of a turned rig, by our cameras and images, agree with the authors' to
    1e-4.
    """
    cameras, images = rig_and_images()
    found = estimate(weights, cameras, images)
    np.testing.assert_allclose(found.depth[::2, ::2], golden["depth"], rtol=1e-4)
    np.testing.assert_allclose(found.confidence[::2, ::2], golden["confidence"], atol=1e-4)
    assert golden["depth"].std() > 0.3


@pytest.mark.slow
def test_a_batch_finds_what_its_maps_find_one_by_one(weights):
    """Three maps of three and two partners; then other pictures, cameras and partners on the same
    buffers, with equal bits.
    """
    rig, (cameras, images) = IterMvsRig(IterMvs(weights, "")), rig_of_four()
    first = as_arrays(rig.estimate(cameras, MATCHED, images))
    assert_alike(first, alone(weights, cameras, images))
    assert len({depth.tobytes() for depth, _ in first}) == len(MATCHED)
    (batch,) = rig._batches.values()
    buffers = [each.data_ptr() for each in (*batch._pictures, *vars(batch._views).values())]
    moved, dimmed = (
        [replace(each, near=1.5 * each.near) for each in cameras[::-1]],
        [each // 2 for each in images[::-1]],
    )
    other = [(1, 0), (0, 3, 2, 1), (2, 3)]
    second = as_arrays(rig.estimate(moved, other, dimmed))
    assert_alike(second, alone(weights, moved, dimmed, other))
    assert_same_bits(
        second, as_arrays(IterMvsRig(IterMvs(weights, "")).estimate(moved, other, dimmed))
    )
    assert_same_bits(as_arrays(rig.estimate(cameras, MATCHED, images)), first)
    assert list(rig._batches.values()) == [batch]
    assert [each.data_ptr() for each in (*batch._pictures, *vars(batch._views).values())] == buffers


def test_maps_are_the_callers_own(weights):
    """Depth of an instant outlives the next one, at the network's size and at another."""
    for size in ((96, 64), (90, 57)):
        rig, (cameras, images) = IterMvsRig(IterMvs(weights, "")), rig_of_four(*size)
        found = rig.estimate(cameras, MATCHED, images)
        before = as_arrays(found)
        rig.estimate(cameras, MATCHED, [255 - each for each in images])
        assert_same_bits(as_arrays(found), before)
        assert {each.shape for both in before for each in both} == {size[::-1]}


def test_cameras_of_several_sizes_are_batches_of_their_own(weights):
    """Each map as an estimator of its own finds it, at its camera's size."""
    cameras, images = rig_of_four()
    cameras[1] = cameras[1].cropped(0, 0, 40, 33)
    images[1] = np.ascontiguousarray(images[1][:33, :40])
    matched = [(1, 0, 2), (0, 1, 2)]
    found = as_arrays(IterMvsRig(IterMvs(weights, "")).estimate(cameras, matched, images))
    assert_same_bits(found, alone(weights, cameras, images, matched))
    assert [depth.shape for depth, _ in found] == [(33, 40), (64, 96)]


def test_the_oldest_buffers_are_given_up(weights):
    """Numbers of maps and partners that come again find theirs, up to a limit."""
    rig, (cameras, images) = IterMvsRig(IterMvs(weights, "", iterations=1)), rig_of_four()
    counts = [[(0, 1)] * maps for maps in range(1, MOST_RECORDINGS + 2)]
    for matched in (*counts, counts[1]):
        rig.estimate(cameras, matched, images)
    assert [key[0] for key in rig._batches] == [3, 4, 5, 2]


@pytest.mark.slow
def test_a_pass_can_be_recorded(network):
    """No number is uploaded, nor read by the host: on a device without memory the host could do
    neither.
    """
    there = IterMvsNetwork().eval().to("meta")
    views = MatchedViews(
        torch.zeros(3, 4, dtype=torch.int64), torch.zeros(3, 3, 13), torch.zeros(3, 3)
    )
    views = MatchedViews(**{name: each.to("meta") for name, each in vars(views).items()})
    pictures = [torch.zeros(5, 64, 96, 3, dtype=torch.uint8, device="meta")]
    with forbidden_operations() as forbidden:
        depth, confidence = there(pictures, views)
    assert depth.shape == confidence.shape == (3, 64, 96)
    assert not forbidden


@pytest.mark.slow
def test_half_precision_is_close(weights):
    """Convolutions in half precision move the median depth by less than 1e-3 of itself; weights of
    noise amplify the rest.
    """
    cameras, images = rig_of_four()
    whole, half = (
        IterMvsRig(IterMvs(weights, "", precision=precision)).estimate(cameras, MATCHED, images)
        for precision in ("float32", "float16")
    )
    off = [((h - w).abs() / w).numpy() for (w, _), (h, _) in zip(whole, half, strict=True)]
    assert all(h.dtype == torch.float32 for both in half for h in both)
    assert 0 < np.median(off) < 1e-3


@pytest.mark.slow
@pytest.mark.skipif(
    not PUBLISHED_FILE.is_file(), reason="no ../shared/weights beside this checkout"
)
def test_the_published_weights_find_the_plane():
    """By the authors' weights the median error on a slanted plane is below 2 %, in a batch, alone
    and in half precision.
    """
    cameras = [look_from(x, y, f"at{x},{y}") for x, y in ((0, 0), (1.2, 0), (-1.2, 0), (0, 1.2))]
    images = [see_plane(each) for each in cameras]
    whole, half = (
        as_arrays(
            IterMvsRig(IterMvs(PUBLISHED_FILE, "", precision=precision)).estimate(
                cameras, MATCHED, images
            )
        )
        for precision in ("float32", "float16")
    )
    assert_alike(whole, alone(PUBLISHED_FILE, cameras, images))
    for (depth, _), (rounded, _), (own, *_) in zip(whole, half, MATCHED, strict=True):
        assert np.median(np.abs(depth / plane_depth(cameras[own]) - 1)) < 0.02
        assert np.mean(np.abs(rounded / depth - 1) < 0.01) > 0.95


def test_units_and_sizes_do_not_matter(weights):
    """Depth grows with the unit of length; images whose sides are no multiples of 32 get depth of
    their size.
    """
    cameras, images = rig_and_images()
    large = []
    for camera in cameras:
        pose = camera.world_to_camera.copy()
        pose[:3, 3] *= 1000
        large.append(replace(camera, world_to_camera=pose, near=2000.0, far=8000.0))
    small, huge = (estimate(weights, rig, images) for rig in (cameras, large))
    np.testing.assert_allclose(huge.depth, 1000 * small.depth, rtol=1e-3)
    cameras[0] = cameras[0].cropped(0, 0, 90, 57)
    found = estimate(weights, cameras, [np.ascontiguousarray(images[0][:57, :90]), *images[1:]])
    assert found.depth.shape == found.confidence.shape == (57, 90)
    assert found.depth.min() >= 2 * 0.999
    assert found.depth.max() <= 8 * 1.001


def test_what_is_no_checkpoint_is_refused(network, tmp_path, monkeypatch):
    """Absent, without its state dict, or of another shape: refused in one line, as are misspelt
    matchers.
    """
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path / "cache"))
    state = network.state_dict()
    torch.save({"net": state}, tmp_path / "partial.ckpt")
    torch.save(
        {"model": {**state, "feature_net.conv1.bn.bias": torch.zeros(9)}}, tmp_path / "shape.ckpt"
    )
    cases = {
        "nowhere": r"nowhere\.ckpt: wanted weights of IterMVS.*github",
        "partial": "wanted a state dict under model, got net",
        "shape": r"1 tensors differ from IterMVS, first feature_net\.conv1\.bn\.bias: wanted "
        r"\(8,\), got \(9,\)",
    }
    for name, message in cases.items():
        for matcher in ("itermvs", "sgbm+itermvs"):
            with pytest.raises(WeightsError, match=message) as caught:
                DepthRunOptions(f"{matcher}:{tmp_path / name}.ckpt").options()
            assert "\n" not in str(caught.value)
    with pytest.raises(WeightsError, match=r"itermvs-blendedmvs\.ckpt"):
        DepthRunOptions("sgbm+itermvs").options()
    for matcher, message in (
        ("sgmb", "wanted a matcher, got 'sgmb'"),
        ("live", "wanted sgbm, sweep or raft before the ., got live"),
    ):
        with pytest.raises(DepthError, match=message):
            DepthRunOptions(f"{matcher}+itermvs").options()


def test_a_file_in_the_cache_is_taken(weights, tmp_path, monkeypatch):
    """Without a file's name the weights of the cache folder are taken, and a record of the run
    names no folder.
    """
    monkeypatch.setenv("GGVS_EVAL_CACHE", str(tmp_path))
    cached_weights().write_bytes(weights.read_bytes())
    options = DepthRunOptions("sgbm+itermvs")
    assert options.options().filler == IterMvs(
        cached_weights(), options.options().filler.weights_sha256
    )
    assert options.is_learned
    assert DepthRunOptions.from_record(options.record()) == options
    assert load_network(cached_weights()) is not None


def test_the_network_fills_what_is_not_confirmed(monkeypatch):
    """What the matcher has not found, and what others see through, gets the guess in place of the
    background's depth.
    """
    camera, others = look_from(0, 0, "camera"), [look_from(x, 0, f"at{x}") for x in (-0.4, 0.4)]
    truth, hole, wrong = (
        plane_depth(camera).astype(np.float32),
        np.s_[40:60, 60:90],
        np.s_[80:100, 60:90],
    )
    depth = truth.copy()
    depth[hole], depth[wrong] = 0, 0.6 * truth[wrong]
    guess = 1.25 * truth
    monkeypatch.setattr(consistency, "FILL_SUPPORT", 0)
    options = DepthOptions(filler_share=0.0)
    sure = [
        DepthMap(each, np.full_like(each, 0.8))
        for each in (depth, *(plane_depth(o).astype(np.float32) for o in others))
    ]
    found = finish(replace(sure[0], guess=guess), options)
    assert np.array_equal(found.depth[hole], guess[hole])
    checked = check_depth(camera, found, list(zip(others, sure[1:], strict=True)), options)
    for part in (hole, np.s_[82:98, 62:88]):
        assert np.array_equal(checked.depth[part], guess[part])
        assert (checked.confidence[part] == np.float32(FILLED_CONFIDENCE)).all()
    assert checked.depth[110:140, 60:120] == pytest.approx(truth[110:140, 60:120], rel=0.01)
    assert checked.guess is None
    few = check_depth(
        camera, found, list(zip(others, sure[1:], strict=True)), replace(options, filler_share=0.2)
    )
    assert (few.depth > 0).all()
    assert few.depth[hole].max() < guess[hole].min()  # few gaps: the background's


def test_partners_of_the_network_need_no_rectification(weights):
    """Pairs stay those of the matcher alone; the network sees more, and alone it has depth where no
    pair can be rectified.
    """
    lens = np.array([[0.45, 1, 1], [1, 0.45, 1], [1, 1, 1]])
    places = ((0.0, "camera", 0.0), (0.4, "near", 0.1), (3.0, "far", 0.7))
    cameras = [look_from(x, 0, name, turn) for x, name, turn in places]
    camera, near, far = (replace(each, K=each.K * lens, near=1.0) for each in cameras)
    options = DepthOptions(filler=IterMvs(weights, ""))
    assert [each.name for each in DepthOptions().choose_partners(camera, [far, near])] == ["near"]
    assert [each.name for each in options.choose_partners(camera, [far, near])] == ["near", "far"]
    assert [each.name for each in DepthEstimator(camera, [near, far], options).pairs] == ["near"]
    picture = see_plane(camera)
    found = DepthEstimator(camera, options.choose_partners(camera, [far]), options).estimate(
        picture, [see_plane(far)]
    )
    assert (found.depth > 0).all()
    assert np.array_equal(found.depth, found.guess)


def test_the_network_is_not_asked_for_a_few_gaps(weights):
    """Where the pairs know nearly everything, their gaps are filled from the background, and the
    network costs nothing.
    """
    camera, others = look_from(0, 0, "camera"), [look_from(x, 0, f"at{x}") for x in (-0.2, 0.2)]
    pictures = [see_plane(each) for each in (camera, *others)]
    known = DepthEstimator(camera, others, DepthOptions()).estimate(pictures[0], pictures[1:])
    found = DepthEstimator(camera, others, DepthOptions(filler=IterMvs(weights, ""))).estimate(
        pictures[0], pictures[1:]
    )
    assert found.guess is None
    assert np.array_equal(found.depth, known.depth)


@pytest.mark.slow
def test_a_prepared_rig_keeps_the_guess(weights, tmp_path):
    """Stored depth as it was found holds the guess for the check; checked depth does not."""
    capture = write_capture(tmp_path / "capture", 1)
    options = replace(DepthRunOptions(f"sgbm+itermvs:{weights}").options(), filler_share=0.0)
    job = plan_depth(capture, [capture.camera("cam01")], 2, options)["cam01"]["cam00"]
    store = DepthStore(tmp_path / "depth")
    prepare_depth(capture, [job], range(1), store, options, workers=1)
    found, checked = (store.read(each.key, 0) for each in (job.unchecked, job))
    assert found.guess is not None
    assert (found.depth > 0).all()
    assert checked.guess is None
    assert (checked.depth > 0).all()
