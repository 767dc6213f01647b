"""Live depth: one match of a pair serves both of its cameras, whoever is asked for together, and
every instant stands alone.
"""

import inspect
import os

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.contrib.view.command import view
from ggvs_eval.depth_options import DepthRunOptions
from ggvs_eval.depth_store import DepthMap, DepthStore
from ggvs_eval.errors import DepthError
from ggvs_eval.geometry.rectification import exchange_roles, rectify
from ggvs_eval.pipelines.commands.play import play
from ggvs_eval.pipelines.commands.runs import run
from ggvs_eval.pipelines.offline.depth import fill_store
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthEstimator, DepthOptions
from ggvs_eval.pipelines.offline.depth.fill_store import plan_rig_depth, prepare_depth
from ggvs_eval.pipelines.offline.stereo.live import (
    SAME_SURFACE,
    LiveEstimator,
    LiveMatcher,
    RigEstimator,
    enlarge,
)
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher
from ggvs_eval.pipelines.play.playback import PlayOptions, playback_of_capture
from helpers.geometry_scenes import seeds
from helpers.refusals import refused
from helpers.stereo_scenes import (
    PLANE,
    look_from,
    paint,
    plane_depth,
    random_texture,
    write_capture,
)
from helpers.twins.enlarging import alike_twin

PLACES = {"cam00": (0, 0), "cam01": (0.4, 0), "cam02": (-0.4, 0), "cam03": (0, 0.4)}
RIG = [look_from(*place, name, turn=0.03) for name, place in PLACES.items()]
MATCHED = [
    ("cam00", "cam01", "cam02", "cam03"),
    ("cam01", "cam00", "cam03"),
    ("cam02", "cam00"),
    ("cam03", "cam01", "cam00"),
]
SMALLER = LiveMatcher(longest_px=150)  # three quarters of the images
OPTIONS = DepthOptions(matcher=LiveMatcher(longest_px=150), consistency=False)
CUT = np.array([-0.2, 0.1, 5.0])  # another plane


def see(plane=PLANE, cameras=RIG):
    """What every camera sees of a plane, by its name."""
    return {
        camera.name: paint(camera, plane_depth(camera, plane), random_texture())
        for camera in cameras
    }


def errors(camera, depth_map, plane=PLANE):
    """Relative errors of the depth that at least half of the partners are sure of."""
    sure = depth_map.confidence > 0.5
    assert sure.mean() > 0.4
    return np.abs(depth_map.depth / plane_depth(camera, plane) - 1)[sure]


def alone(names, images, cameras=RIG):
    """The depth of one camera, asked for by itself."""
    camera, *partners = (next(each for each in cameras if each.name == name) for name in names)
    estimator = LiveEstimator(camera, partners, SMALLER, 0.5)
    return estimator.estimate(images[names[0]], [images[name] for name in names[1:]])


def same(first: DepthMap, second: DepthMap) -> bool:
    """Equal to the last bit."""
    return np.array_equal(first.depth, second.depth) and np.array_equal(
        first.confidence, second.confidence
    )


@pytest.fixture(scope="module")
def together():
    """Depth of the whole rig."""
    return RigEstimator(RIG, MATCHED, SMALLER, 0.5).estimate(see())


@pytest.mark.parametrize("other", ["cam01", "cam02", "cam03"])
def test_exchanged_roles_are_the_other_rectification(other):
    """The turned canvas is that of rectifying the two in the other order, up to where its window
    begins.
    """
    partner = next(camera for camera in RIG if camera.name == other)
    pair, expected = rectify(RIG[0], partner), rectify(partner, RIG[0])
    turned = exchange_roles(pair, RIG[0], partner)
    offset = turned.canvas_map - expected.canvas_map
    assert np.allclose(turned.rotation, expected.rotation, atol=1e-12)
    assert np.allclose(turned.depth_scale, expected.depth_scale)
    assert np.allclose(offset, (turned.projection - expected.projection)[:2, 2], atol=1e-3)
    assert np.array_equal(turned.left_inside, pair.right_inside[::-1, ::-1])
    assert np.array_equal(turned.warp_left(see()[other]), pair.warp_right(see()[other])[::-1, ::-1])


def test_the_other_side_is_the_mirror_image():
    """The left image's disparity is that of `match`; the right one's is that of the mirrored pair,
    mirrored back.
    """
    pair, images, matcher = rectify(RIG[0], RIG[1]), see(), SgbmMatcher(levels=2)
    left, right = pair.warp_left(images["cam00"]), pair.warp_right(images["cam01"])
    of_left, of_right = matcher.match_sides(left, right, pair.d_min, pair.d_max, ("left", "right"))
    mirrored = matcher.match(right[:, ::-1], left[:, ::-1], pair.d_min, pair.d_max)
    assert np.array_equal(of_left, matcher.match(left, right, pair.d_min, pair.d_max))
    assert np.array_equal(of_right, [each[:, ::-1] for each in mirrored])


def test_depth_is_right_for_every_camera(together):
    """Of a slanted plane, within 0.8 % for half of the pixels that are sure, of partners on either
    side, above and below.
    """
    for (name, *_), depth_map in zip(MATCHED, together, strict=True):
        camera = next(each for each in RIG if each.name == name)
        error = errors(camera, depth_map)
        assert depth_map.depth.shape == (camera.height, camera.width)
        assert np.median(error) < 0.008
        assert (error < 0.02).mean() > 0.92
        # nothing lies far behind the farthest depth, not even next to what could not be matched
        assert error.max() < 0.5


def test_depth_does_not_depend_on_who_else_is_asked_for(together):
    """Alone, in another order, with one partner less: each map depends on its own camera and
    partners, to the last bit.
    """
    images = see()
    backwards = RigEstimator(RIG[::-1], MATCHED[::-1], SMALLER, 0.5).estimate(images)[::-1]
    fewer = RigEstimator(RIG, [MATCHED[0][:-1], *MATCHED], SMALLER, 0.5).estimate(images)
    assert all(same(*each) for each in zip(together, backwards, strict=True))
    assert all(same(*each) for each in zip(together, fewer[1:], strict=True))
    assert all(
        same(each, alone(names, images)) for names, each in zip(MATCHED, together, strict=True)
    )
    assert same(fewer[0], alone(MATCHED[0][:-1], images))
    assert not same(fewer[0], together[0])


def test_every_instant_stands_alone(together):
    """After a cut, and back again, depth is what a fresh estimator finds."""
    rig = RigEstimator(RIG, MATCHED, SMALLER, 0.5)
    first, cut, back = (rig.estimate(see(plane)) for plane in (PLANE, CUT, PLANE))
    assert all(same(*each) for each in zip(first, together, strict=True))
    assert all(same(*each) for each in zip(back, together, strict=True))
    assert same(cut[1], alone(MATCHED[1], see(CUT)))
    assert np.median(errors(RIG[0], cut[0], CUT)) < 0.005


def test_missing_and_wrong_images_are_refused():
    """The camera is named, with what came and what was wanted."""
    rig, images = RigEstimator(RIG, MATCHED, SMALLER, 0.5), see()
    with refused(DepthError, "camera cam03", "(150, 200, 3)", "got none"):
        rig.estimate({name: image for name, image in images.items() if name != "cam03"})
    with refused(DepthError, "camera cam01", "uint8 (100, 200, 3)"):
        rig.estimate(images | {"cam01": images["cam01"][:100]})


@settings(deadline=None, max_examples=40)
@given(seeds, st.integers(1, 40), st.integers(1, 40), st.integers(1, 60), st.integers(1, 60))
def test_each_pixel_takes_the_depth_of_its_like(seed, small_width, small_height, width, height):
    """Larger, smaller or skewed: of four small pixels the one of the likest colour, where surfaces
    are too far apart to mix.
    """
    random = np.random.default_rng(seed)
    small_image = random.integers(0, 256, (small_height, small_width, 3)).astype(np.uint8)
    image = random.integers(0, 256, (height, width, 3)).astype(np.uint8)
    depth = np.float32(2) ** random.integers(1, 6, (small_height, small_width)).astype(np.float32)
    confidence = random.random(depth.shape, dtype=np.float32)
    enlarged = enlarge(DepthMap(depth, confidence), small_image, image)
    if image.shape != small_image.shape:
        np.testing.assert_array_equal(
            enlarged.confidence, alike_twin(confidence, small_image, image)
        )
        np.testing.assert_allclose(
            enlarged.depth, alike_twin(depth, small_image, image), rtol=SAME_SURFACE
        )


def test_depth_ends_where_the_image_does():
    """An edge of depth between two small pixels goes to the image's edge, at odd sizes too; a slope
    stays a slope.
    """
    image = np.zeros((31, 41, 3), np.uint8)
    image[:, 22:] = 200  # the small image's column 11 shows 22 and 23
    small_image = cv2.resize(image, (21, 16), interpolation=cv2.INTER_AREA)
    depth = np.full((16, 21), 2, np.float32)
    depth[:, 11:] = 4
    enlarged = enlarge(DepthMap(depth, np.ones_like(depth)), small_image, image)
    assert np.array_equal(enlarged.depth[:, :22], np.full((31, 22), 2))
    assert np.array_equal(enlarged.depth[:, 23:], np.full((31, 18), 4))
    slope = np.tile(np.linspace(2, 2.1, 21, dtype=np.float32), (16, 1))
    level = np.zeros_like(image)
    smooth = enlarge(
        DepthMap(slope, np.ones_like(slope)), np.zeros((16, 21, 3), np.uint8), level
    ).depth
    assert np.diff(smooth[5, 2:-2]).min() > 0
    assert np.ptp(np.diff(smooth[5, 2:-2])) < 1e-4


@pytest.fixture(scope="module")
def nearing_plane(tmp_path_factory):
    """Five cameras before a plane that comes nearer, three instants."""
    return write_capture(tmp_path_factory.mktemp("plane"))


@pytest.mark.slow
def test_a_store_is_filled_alike_however_it_is_done(nearing_plane, tmp_path, monkeypatch):
    """All together, one by one and an instant alone: equal files, and what is there is not made
    again.
    """
    jobs = plan_rig_depth(nearing_plane, OPTIONS)
    whole, single, parts = (DepthStore(tmp_path / name) for name in ("whole", "single", "parts"))
    prepare_depth(nearing_plane, jobs, (1, 2), whole, OPTIONS, 1)
    with monkeypatch.context() as patch:
        patch.setattr(fill_store, "MOST_TOGETHER", 2)
        prepare_depth(nearing_plane, jobs, [1], parts, OPTIONS, 1)
    assert all(same(parts.read(job.key, 1), whole.read(job.key, 1)) for job in jobs)
    for job in jobs[::3]:
        prepare_depth(nearing_plane, [job], [2], single, OPTIONS, 1)
        assert same(single.read(job.key, 2), whole.read(job.key, 2))
        assert not single.has(job.key, 1)
    lost, kept = whole.path(jobs[0].key, 1), whole.path(jobs[1].key, 1)
    content, written = lost.read_bytes(), kept.stat().st_mtime_ns
    os.unlink(lost)
    prepare_depth(nearing_plane, jobs, (1, 2), whole, OPTIONS, 1)
    assert lost.read_bytes() == content
    assert kept.stat().st_mtime_ns == written


def test_it_is_a_matcher_by_name():
    """`live` is found by its name, has a key of its own, and finishes its maps as every matcher's
    are.
    """
    options = DepthRunOptions("live").options()
    assert isinstance(options.matcher, LiveMatcher)
    assert options.describe()["matcher_name"] == "sgbm-3way-shared"
    assert options.describe() != DepthOptions().describe()
    images = see()
    estimator = DepthEstimator(RIG[0], RIG[1:], options)
    depth_map = estimator.estimate(images["cam00"], [images[camera.name] for camera in RIG[1:]])
    assert (depth_map.depth > 0).all()


def test_play_and_view_take_it_by_default(nearing_plane, tmp_path):
    """Both verbs of live synthesis, and no other; what a viewer reads is the plane at every
    camera.
    """
    defaults = {
        verb: inspect.signature(verb).parameters["depth"].default for verb in (play, view, run)
    }
    assert [default.matcher for default in defaults.values()] == ["live", "live", "sgbm"]
    playback = playback_of_capture(
        nearing_plane,
        PlayOptions(k=2, frames=1),
        defaults[view].options(),
        tmp_path / "cache",
        anywhere=True,
    )
    for camera in nearing_plane.cameras:
        depth_map = playback.store.read(playback.depth_keys[camera.name], 0)
        assert np.median(errors(camera, depth_map)) < 0.005
