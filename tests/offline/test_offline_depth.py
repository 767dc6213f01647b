"""Depth from several partners: choice, check, consensus, filling, and a store filled by many
workers.
"""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.depth_store import DepthJob, DepthMap, DepthStore, is_known
from ggvs_eval.errors import CaptureError, DepthError
from ggvs_eval.geometry.rectification import rectify
from ggvs_eval.pipelines.offline.depth.camera_depth import (
    FILLED_CONFIDENCE,
    DepthEstimator,
    DepthOptions,
    finish,
)
from ggvs_eval.pipelines.offline.depth.colour_fill import fill_by_colour
from ggvs_eval.pipelines.offline.depth.fill_store import depth_job, plan_depth, prepare_depth
from ggvs_eval.pipelines.offline.depth.pairing import choose_partners
from ggvs_eval.pipelines.offline.itermvs.estimator import IterMvs
from ggvs_eval.pipelines.offline.stereo.fusion import (
    drop_flying_pixels,
    fill_background,
    fuse,
    smooth_surfaces,
)
from ggvs_eval.pipelines.offline.stereo.live import LiveMatcher, RigEstimator
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher
from helpers.refusals import refused
from helpers.stereo_scenes import look_from, plane_depth, random_texture, see_plane, write_capture

CAMERA = look_from(0, 0, "camera")
ROW = [look_from(0.5 * index, 0, f"row{index:+d}") for index in (-2, -1, 1, 2)]


def test_excluded_camera_is_never_chosen():
    """The target of a leave-one-out run and the camera itself are never partners, however good."""
    names = {partner.name for partner in choose_partners(CAMERA, [CAMERA, *ROW], 10, {"row+1"})}
    assert names == {"row-2", "row-1", "row+2"}


def test_choice_does_not_depend_on_order():
    """The same candidates in any order give the same partners in the same order."""
    chosen = [camera.name for camera in choose_partners(CAMERA, ROW, 3)]
    assert [camera.name for camera in choose_partners(CAMERA, ROW[::-1], 3)] == chosen


@pytest.mark.parametrize(
    ("candidates", "count", "wanted"),
    [
        (ROW, 2, {"row-1", "row+1"}),
        ([*ROW, look_from(0, 0.5, "below")], 3, {"row-1", "row+1", "below"}),
        (
            [
                look_from(4.0, 0, "far away"),
                look_from(0.001, 0, "almost here"),
                look_from(-0.6, 0, "good"),
            ],
            1,
            {"good"},
        ),
    ],
)
def test_partners_come_from_all_sides_neither_too_far_nor_too_near(candidates, count, wanted):
    """Two from both sides of a row, the third from below it; neither huge disparities nor fractions
    of a pixel.
    """
    assert {partner.name for partner in choose_partners(CAMERA, candidates, count)} == wanted


def test_partners_are_on_both_sides_of_the_camera_itself():
    """A row far from the world's origin has the same partners as one around it."""
    camera, *row = (look_from(3 + 0.5 * index, 0, f"row{index:+d}") for index in (0, -2, -1, 1, 2))
    assert {partner.name for partner in choose_partners(camera, row, 2)} == {"row-1", "row+1"}


def test_a_pair_that_cannot_be_rectified_is_passed_over():
    """Very wide lenses see much together, but no plane holds what both see."""

    def wide(x: float, name: str, turn: float) -> Camera:
        camera = look_from(x, 0, name, turn)
        return replace(
            camera, K=camera.K * np.array([[0.2, 1, 1], [1, 0.2, 1], [1, 1, 1]]), near=1.0
        )

    camera, near, far = wide(0.001, "camera", 0.0), wide(0.4, "near", 0.1), wide(3.0, "far", 0.5)
    with pytest.raises(DepthError, match="too different directions for matching"):
        rectify(camera, far)
    assert [partner.name for partner in choose_partners(camera, [far, near], 2)] == ["near"]
    with refused(DepthError, "none of 1 cameras"):
        choose_partners(camera, [far], 2)


def test_nobody_to_match_with():
    """A camera that no other overlaps is an error that names it and says what to do."""
    with refused(DepthError, "camera camera", "none of 1 cameras", "add cameras"):
        choose_partners(CAMERA, [look_from(60, 0, "elsewhere")], 2)


def test_check_rejects_what_only_one_eye_sees():
    """Background hidden from the right image is rejected, everything else is kept and right."""
    texture = random_texture(3)
    columns = np.arange(240)
    near = (columns >= 100) & (columns < 150)
    disparity = np.where(near, 24, 8)
    rows = np.arange(120)[:, None]
    left = np.rint(
        255 * np.where(near, texture[rows + 500, columns], texture[rows, columns])
    ).astype(np.uint8)
    right = np.rint(255 * texture[rows, columns + 8]).astype(np.uint8)
    right[:, 100 - 24 : 150 - 24] = left[:, 100:150]
    found, confidence = SgbmMatcher(levels=1).match(
        *(np.repeat(image[..., None], 3, -1) for image in (left, right)), 2, 40
    )
    # matches of 84..99 lie under the near strip
    hidden, safe = slice(88, 97), np.r_[50:80, 106:144, 160:230]
    assert (found[:, hidden] == 0).mean() > 0.8
    assert (found[:, safe] > 0).mean() > 0.95
    kept = found[:, safe] > 0
    assert np.median(np.abs(found[:, safe] - disparity[safe])[kept]) < 0.1
    assert (confidence[found == 0] == 0).all()
    assert (confidence[found > 0] > 0).all()


def test_fusion_prefers_consensus():
    """Two partners that agree outvote a third that is surer, and the result lies between
    the two.
    """
    depths = np.array([5.0, 5.02, 8.0], np.float32).reshape(3, 1, 1)
    confidences = np.array([0.6, 0.6, 1.0], np.float32).reshape(3, 1, 1)
    depth, confidence = fuse(depths, confidences, np.full((3, 1, 1), 50, np.float32), 0.5)
    assert 5.0 < depth.item() < 5.02
    assert confidence.item() == pytest.approx(1.2 / 3)


def test_fusion_trusts_wide_pairs():
    """Among agreeing estimates the one from twice the disparity counts four times."""
    depths = np.array([5.0, 5.02], np.float32).reshape(2, 1, 1)
    disparities = np.array([20.0, 40.0], np.float32).reshape(2, 1, 1)
    depth, _ = fuse(depths, np.ones_like(depths), disparities, 0.5)
    assert depth.item() == pytest.approx(5.0 + 0.02 * 4 / 5, abs=1e-5)


@pytest.mark.parametrize(("gap", "mean"), [(0.28, 5.0 + 0.28 * 100 / 2600), (0.32, 5.0)])
def test_estimates_agree_within_the_sum_of_their_errors(gap, mean):
    """Half a pixel is 1 % of a depth of 50 px of disparity and 5 % of one of 10 px: both together 6
    % of 5, which is 0.3.
    """
    depths, disparities = (
        np.array(pair, np.float32).reshape(2, 1, 1) for pair in ((5.0, 5.0 + gap), (50.0, 10.0))
    )
    depth, _ = fuse(depths, np.ones_like(depths), disparities, 0.5)
    assert depth.item() == pytest.approx(mean, abs=1e-5)


def test_fusion_without_opinions():
    """Where nobody has an opinion there is no depth and no confidence."""
    nothing = np.zeros((2, 3, 4), np.float32)
    assert not np.any(fuse(nothing, nothing, nothing, 0.5))


def test_flying_pixels_go():
    """A pixel between two surfaces is dropped, both surfaces stay."""
    depth = np.full((9, 9), 4, np.float32)
    depth[:, 5:] = 8
    expected = depth.copy()
    depth[4, 4], expected[4, 4] = 6, 0
    assert np.array_equal(drop_flying_pixels(depth, 0.03), expected)
    block, row = np.zeros((2, 7, 9), np.float32)
    block[2:4, 3:5], row[3, 3:6] = 4, 4
    assert np.array_equal(drop_flying_pixels(block, 0.03), block)  # three neighbours each
    assert not drop_flying_pixels(row, 0.03).any()  # two at most


def test_smoothing_keeps_steps():
    """Noise within a surface shrinks to less than half, a step of depth stays where it is, holes
    stay holes.
    """
    random = np.random.default_rng(0)
    truth = np.where(np.arange(40) < 20, 4.0, 6.0) * np.ones((40, 1))
    noisy = (truth * random.normal(1, 0.005, truth.shape)).astype(np.float32)
    noisy[3, 3] = 0
    smooth = smooth_surfaces(noisy, 0.03, 4)
    kept = noisy > 0
    assert np.abs(smooth / truth - 1)[kept].mean() < 0.5 * np.abs(noisy / truth - 1)[kept].mean()
    assert smooth[3, 3] == 0
    lone = np.ones((9, 11), np.float32)
    lone[4, 5] = np.e
    rows, columns = np.mgrid[-2:3, -2:3]
    # three quarters of the radius of 2
    weights = np.exp(-(rows**2 + columns**2) / (2 * 1.5**2)) * (rows**2 + columns**2 <= 4)
    assert np.log(smooth_surfaces(lone, 1000.0, 2)[4, 5:7]) == pytest.approx(
        [1 / weights.sum(), weights[2, 1] / weights.sum()], rel=1e-3
    )


def test_filling_takes_the_background():
    """A hole gets the far depth, an empty row that of its neighbours, with the confidence that is
    given; without one it stays.
    """
    depth = np.array([[2, 0, 0, 5], [0, 0, 0, 0], [2, 2, 2, 2]], np.float32)
    confidence = (depth > 0).astype(np.float32)
    filled, trust = fill_background(depth, confidence, 0.02)
    assert np.array_equal(filled, [[2, 5, 5, 5], [2, 5, 5, 5], [2, 2, 2, 2]])
    assert np.array_equal(trust, np.where(depth > 0, np.float32(1), np.float32(0.02)))
    assert fill_background(depth, confidence, 0.0)[0] is depth


def test_estimate_is_complete_and_sure_of_it():
    """Four partners give every pixel a depth, within 0.5 % in the median, and confidence in
    (0, 1].
    """
    estimator = DepthEstimator(CAMERA, ROW, DepthOptions())
    result = estimator.estimate(see_plane(CAMERA), [see_plane(partner) for partner in ROW])
    assert result.depth.dtype == result.confidence.dtype == np.float32
    assert (result.depth > 0).all()
    assert result.confidence.min() > 0
    assert result.confidence.max() <= 1
    assert np.median(np.abs(result.depth / plane_depth(CAMERA) - 1)) < 0.005


def test_wrong_images_are_refused():
    """An image of another size, or too few images, raise DepthError naming the camera."""
    estimator = DepthEstimator(CAMERA, ROW[:1], DepthOptions())
    image = see_plane(CAMERA)
    with refused(DepthError, "camera row-2", "(150, 200, 3)", "uint8 (10, 200, 3)"):
        estimator.estimate(image, [image[:10]])
    with refused(DepthError, "camera camera", "1 partner", "got 0"):
        estimator.estimate(image, [])


@pytest.fixture(scope="module")
def plane_capture(tmp_path_factory):
    return write_capture(tmp_path_factory.mktemp("capture"))


def test_plan_leaves_the_target_out(plane_capture):
    """No job of a target names it, sources are the nearest, and every job has partners."""
    plan = plan_depth(plane_capture, plane_capture.cameras, 2, DepthOptions(partners=2))
    for target, jobs in plan.items():
        assert len(jobs) == 2
        for source, job in jobs.items():
            assert job.camera_name == source
            assert target not in (source, *job.partner_names)
            assert source not in job.partner_names
            assert len(job.partner_names) == 2


def test_plan_for_a_virtual_camera(plane_capture):
    """A camera that the capture does not have excludes nobody, and equal jobs of two targets are
    equal.
    """
    targets = [look_from(0.1, 0.05, "path0000"), look_from(0.12, 0.05, "path0001")]
    plan = plan_depth(plane_capture, targets, 2, DepthOptions(partners=2))
    assert plan["path0000"] == plan["path0001"]
    assert "cam00" in plan["path0000"]


OPTIONS = DepthOptions(matcher=SgbmMatcher(levels=2))


@pytest.fixture(scope="module")
def jobs(plane_capture) -> list[DepthJob]:
    """Two cameras with two partners each."""
    pairs = (("cam00", ("cam01", "cam02")), ("cam03", ("cam00", "cam01")))
    return [depth_job(plane_capture, name, partners, OPTIONS) for name, partners in pairs]


def stored_files(store):
    """Content of every file of a store, by its path in it."""
    return {
        path.relative_to(store.root): path.read_bytes()
        for path in sorted(store.root.rglob("*.*"))
        if path.is_file()
    }


def test_prepare_resumes(plane_capture, jobs, tmp_path):
    """A second call touches nothing, and a lost frame alone is computed again."""
    store = DepthStore(tmp_path)

    def written_ns() -> dict[Path, int]:
        prepare_depth(plane_capture, [jobs[0], jobs[0]], range(2), store, OPTIONS, workers=1)
        return {path: path.stat().st_mtime_ns for path in store.root.rglob("*.npz")}

    first = written_ns()
    assert len(first) == 2
    assert written_ns() == first
    lost = min(first)
    lost.unlink()
    again = written_ns()
    assert [path for path in first if again[path] != first[path]] == [lost]


@pytest.mark.slow
def test_depth_does_not_depend_on_workers(plane_capture, jobs, tmp_path):
    """One worker gives the bits of two."""
    one, two = (DepthStore(tmp_path / name) for name in ("one", "two"))
    for store, workers in ((one, 1), (two, 2)):
        prepare_depth(plane_capture, jobs, range(2), store, OPTIONS, workers=workers)
    assert stored_files(one) == stored_files(two)


def test_prepared_depth_is_right(plane_capture, jobs, tmp_path):
    """What the store holds under a job's key is the depth of that instant."""
    store = DepthStore(tmp_path)
    prepare_depth(plane_capture, jobs[:1], range(1, 2), store, OPTIONS, workers=1)
    key = jobs[0].key
    truth = plane_depth(plane_capture.camera("cam00"), np.array([0.25, 0.15, 5.8]))
    assert np.median(np.abs(store.read(key, 1).depth / truth - 1)) < 0.005
    assert not store.has(key, 0)


def test_options_change_the_key(plane_capture, tmp_path):
    """Every field of the options and of the matcher enters the key."""

    def key_with(options: DepthOptions) -> str:
        return depth_job(plane_capture, "cam00", ("cam01", "cam02"), options).key

    keys = {key_with(OPTIONS)}
    for field, value in vars(OPTIONS).items():
        if field not in ("matcher", "filler", "sensor", "sensor_fills", "consistency"):
            keys.add(key_with(replace(OPTIONS, **{field: value + 1})))
    for field, value in vars(OPTIONS.matcher).items():
        changed = replace(OPTIONS, matcher=replace(OPTIONS.matcher, **{field: value + 1}))
        keys.add(key_with(changed))
    keys.add(key_with(replace(OPTIONS, filler=IterMvs(tmp_path / "model.ckpt", "digest"))))
    keys.add(key_with(replace(OPTIONS, filler=SgbmMatcher())))
    assert len(keys) == len(vars(OPTIONS)) + len(vars(OPTIONS.matcher)) - 2


@pytest.mark.slow
def test_missing_frames_in_a_worker_are_reported(plane_capture, jobs, tmp_path):
    """Frames that the capture does not have end the run with a message that says which
    there are.
    """
    with refused(CaptureError, "2..4", "has 3"):
        prepare_depth(plane_capture, jobs, range(2, 5), DepthStore(tmp_path), OPTIONS, workers=2)


def test_sources_of_a_view_are_held_against_each_other(plane_capture):
    """Each source's depth is checked with that of the view's other sources, all found without the
    view itself.
    """
    jobs = plan_depth(plane_capture, [plane_capture.camera("cam01")], 3, OPTIONS)["cam01"]
    for name, job in jobs.items():
        assert [other.camera_name for other in job.checked_with] == sorted(set(jobs) - {name})
        assert all("cam01" not in other.partner_names for other in (job, *job.checked_with))
    unchecked = plan_depth(
        plane_capture, [plane_capture.camera("cam01")], 3, replace(OPTIONS, consistency=False)
    )["cam01"]
    assert unchecked == {name: job.unchecked for name, job in jobs.items()}


@pytest.mark.slow
def test_checked_depth_has_a_key_of_its_own_and_comes_back(plane_capture, tmp_path):
    """Checked depth of a plane is no worse than what was found, lies beside it, and a lost instant
    comes back with equal bits.
    """
    store, job = (
        DepthStore(tmp_path),
        plan_depth(plane_capture, [plane_capture.camera("cam01")], 3, OPTIONS)["cam01"]["cam00"],
    )
    prepare_depth(plane_capture, [job], range(1, 2), store, OPTIONS, workers=1)
    keys = [each.key for each in (job.unchecked, job)]
    truth = plane_depth(plane_capture.camera("cam00"), np.array([0.25, 0.15, 5.8]))
    found, checked = (np.median(np.abs(store.read(key, 1).depth / truth - 1)) for key in keys)
    assert checked <= found * 1.01
    before = store.read(keys[1], 1).depth
    store.path(keys[1], 1).unlink()
    prepare_depth(plane_capture, [job], range(1, 2), store, OPTIONS, workers=1)
    assert np.array_equal(store.read(keys[1], 1).depth, before)


@pytest.mark.parametrize("odd", [-1.2, np.nan, np.inf])
@pytest.mark.parametrize("guess", [None, 3.0])
def test_what_is_no_depth_is_filled(odd, guess):
    """A depth that is negative or not finite is a hole, filled by the background or the guess and
    as little sure as it.
    """
    depth = np.full((40, 50), 2.0, np.float32)
    depth[10:30, 10:40] = odd
    raw = DepthMap(
        depth, np.ones_like(depth), None if guess is None else np.full_like(depth, guess)
    )

    result = finish(raw, DepthOptions(filler_share=0.1))

    assert result.depth[20, 25] == pytest.approx(guess or 2.0, rel=1e-5)
    assert result.confidence[20, 25] == pytest.approx(FILLED_CONFIDENCE)
    colours = fill_by_colour(raw, np.full((40, 50, 3), 99, np.uint8))
    assert is_known(colours.depth).all()
    assert colours.confidence[20, 25] < 1


def test_a_pair_that_is_refused_costs_that_pair():
    """A partner at the camera's own place has no opinion; the others' stays, and alone it is an
    error, live no depth.
    """
    here, other = replace(CAMERA, name="here"), look_from(-0.6, 0, "other")
    images = {camera.name: see_plane(camera) for camera in (CAMERA, here, other)}
    for matcher in (SgbmMatcher(levels=1), LiveMatcher()):
        alone, both = (
            DepthEstimator(CAMERA, partners, DepthOptions(matcher=matcher)).estimate(
                images[CAMERA.name], [images[partner.name] for partner in partners]
            )
            for partners in ([other], [here, other])
        )
        np.testing.assert_allclose(both.depth, alone.depth, rtol=1e-5)
    with refused(DepthError, "no parallax"):
        DepthEstimator(CAMERA, [here], DepthOptions())
    rig = RigEstimator([CAMERA, here], [[CAMERA.name, "here"]], LiveMatcher(), 0.5)
    assert not rig.estimate(images)[0].depth.any()


@pytest.mark.parametrize("levels", [1, 2, 3])
def test_a_sliver_has_no_match(levels):
    """Canvases of a few columns, or of fewer than the smallest disparity, are matched without an
    error.
    """
    for width, height, d_min in ((1, 1, 0), (3, 1, 2), (3, 8, 3), (2, 8, 5), (5, 4, 4)):
        image = np.zeros((height, width, 3), np.uint8)
        disparity, confidence = SgbmMatcher(levels=levels).match(image, image, d_min, d_min + 8)
        assert disparity.shape == confidence.shape == (height, width)
