"""SGC of a path: regions of a true path agree on the camera's motion; a bent region does not, and
the map says which.
"""

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from ggvs_eval.camera import Camera, translated_path
from ggvs_eval.contrib.more_metrics.spatial_consistency import NAMES, WINDOWS, spatial_consistency
from ggvs_eval.errors import MetricError
from ggvs_eval.kernels.portable import rotation_by
from ggvs_eval.metrics.path.rendered_path import PathPose
from ggvs_eval.metrics.path_scores import score_path
from helpers.refusals import refused
from helpers.stereo_scenes import paint, plane_depth, random_texture

SIZE, VIEWS = (320, 240), 5
QUARTER = np.s_[SIZE[1] // 2 :, SIZE[0] // 2 :]
QUARTER_WINDOWS = np.zeros(WINDOWS, bool)
QUARTER_WINDOWS[WINDOWS[0] // 2 :, WINDOWS[1] // 2 :] = True
WALL, BOARD = ((0, 0, 4.0), (-np.inf, np.inf)), ((0, 0, 2.6), (-0.7, 0.7))
ROOM = (
    ((0.35, 0.3, 5.5), (-np.inf, np.inf)),
    ((0.2, -0.15, 4.0), (-1.8, -0.7)),
    ((-0.3, 0.2, 3.4), (0.3, 1.5)),
)
METRICS = NAMES[:2]


def path(span=0.9, poses=VIEWS):
    """Cameras that step sideways, 6 px on the wall at every step."""
    K = np.array([[120.0, 0, SIZE[0] / 2], [0, 120.0, SIZE[1] / 2], [0, 0, 1]])
    return translated_path(Camera("middle", K, np.eye(4), *SIZE, 1.0, 9.0), span, poses)


@lru_cache
def room(index):
    """Slanted surfaces from one of 17 poses in a row, with exact depth: many layers in every part
    of the picture.
    """
    camera = path(poses=4 * VIEWS - 3)[index]
    return camera, *see(camera)


def see(camera, surfaces=ROOM):
    """Picture and depth of surfaces z = a x + b y + c, each between two x."""
    depth, image = (
        np.full((camera.height, camera.width), np.inf),
        np.zeros((camera.height, camera.width, 3), np.uint8),
    )
    for seed, (plane, (left, right)) in enumerate(surfaces):
        its_depth = plane_depth(camera, np.array(plane))
        x = camera.centre[0] + its_depth * camera.rays()[..., 0]
        nearer = (its_depth < depth) & (left < x) & (x < right)
        depth[nearer] = its_depth[nearer]
        image[nearer] = paint(camera, its_depth, random_texture(seed))[nearer]
    return image, depth.astype(np.float32)


def bent(quarters=0):
    """Every fourth of these poses; the lower right quarter of the picture takes steps shorter by so
    many quarters.
    """
    poses = []
    for index in range(VIEWS):
        camera, image, depth = room(4 * index)
        image = image.copy()
        image[QUARTER] = room((4 - quarters) * index)[1][QUARTER]
        poses.append((camera, image, depth))
    return poses


@lru_cache
def exact():
    return spatial_consistency(bent())


def composed(board_camera):
    """The path past a wall and a board before it, the board as another camera sees it: two depths,
    hence two layers.
    """
    poses = []
    for index, camera in enumerate(path()):
        image, depth = see(camera, [WALL])
        board, board_depth = see(board_camera(index, camera), [WALL, BOARD])
        seen = board_depth < 3.5
        image[seen], depth[seen] = board[seen], board_depth[seen]
        poses.append((camera, image, depth))
    return poses


def scores(poses, names=METRICS):
    return score_path([PathPose(*pose) for pose in poses], metrics=names)


def test_regions_of_a_true_path_agree():
    """The room rendered exactly: within 0.05 degrees and 0.02 of a step, a twentieth of a pixel on
    the map.
    """
    assert 0 < exact().rotation < 0.05**2
    assert 0 < exact().translation < 0.02**2
    assert exact().measured_share >= 0.5
    assert np.nanmedian(exact().bend_px) < 0.05


@pytest.mark.slow
def test_a_board_that_moves_unlike_the_wall_has_the_variance_of_two_numbers():
    """Steps 1.2 times the wall's differ by 0.1 of a step from the mean; turns by 0.5 degrees a pose
    by 0.25.
    """

    def turned(index, camera):
        turn = np.eye(4)
        turn[:3, :3] = rotation_by(np.radians([0, 0, 0.5 * index]))
        return replace(camera, world_to_camera=turn @ camera.world_to_camera)

    longer = spatial_consistency(composed(lambda index, camera: path(1.2 * 0.9)[index]))
    turning = spatial_consistency(composed(turned))

    assert longer.translation == pytest.approx(0.1**2, rel=0.2)
    assert longer.rotation < 0.2**2
    assert turning.rotation == pytest.approx((0.25 * turning.stride) ** 2, rel=0.2)
    assert turning.translation < 0.05**2


def test_a_bent_quarter_raises_it_by_how_much_it_bends_and_is_on_the_map():
    """A quarter that takes steps shorter by a quarter, and by half: more each time, and and by how
    many pixels on the map.
    """
    straight, little, much = exact(), spatial_consistency(bent(1)), spatial_consistency(bent(2))

    assert 3 * straight.rotation < little.rotation < much.rotation
    assert 3 * straight.translation < little.translation < much.translation
    for bend, expected_px in ((little, 2.16), (much, 4.31)):
        assert np.nanmedian(bend.bend_px[QUARTER_WINDOWS]) == pytest.approx(expected_px, rel=0.1)
        assert np.nanmedian(bend.bend_px[~QUARTER_WINDOWS]) < 0.05


@pytest.mark.slow
def test_what_is_wrong_everywhere_alike_does_not_bend():
    """Cameras noted with steps too long and turned agree as before; pictures that come late bend
    less than a bend.
    """
    true = [room(4 * index) for index in range(VIEWS)]
    late = [
        (camera, room(4 * index + 1)[1], depth)
        for index, (camera, _, depth) in enumerate(true[:-1])
    ]
    wrong = []
    for camera, image, depth in true:
        world_to_camera = camera.world_to_camera.copy()
        world_to_camera[:3, 3] *= 1.1
        world_to_camera[:3] = rotation_by(np.array([0.02, 0.01, 0.0])) @ world_to_camera[:3]
        wrong.append((replace(camera, world_to_camera=world_to_camera), image, depth))

    assert spatial_consistency(wrong).rotation < 1.5 * exact().rotation
    assert spatial_consistency(wrong).translation < 1.5 * exact().translation
    assert spatial_consistency(late).rotation < spatial_consistency(bent(1)).rotation
    assert spatial_consistency(late).translation < spatial_consistency(bent(1)).translation


@pytest.mark.slow
def test_what_moves_has_no_vote_where_its_depth_is_unknown():
    """A quarter that stands still, with depth 0: what is left is the true path."""
    poses = [(camera, image, depth.copy()) for camera, image, depth in bent(4)]
    for _, _, depth in poses:
        depth[QUARTER] = 0
    static = spatial_consistency(poses)

    assert static.rotation < 1.5 * exact().rotation < spatial_consistency(bent(2)).rotation
    assert np.isnan(static.bend_px[QUARTER_WINDOWS]).all()


@pytest.mark.slow
def test_what_cannot_be_compared_has_a_reason_and_no_value():
    """Never 0: a frozen picture, no texture, one layer of depth, no parallax, no depth, one
    pose.
    """
    camera, image, depth = bent()[0]
    wall = [(each, *see(each, [WALL])) for each in path()]
    cases = {
        "are static": [(each, image, its_depth) for each, _, its_depth in bent()],
        "is matched": [
            (each, np.full_like(image, 128), its_depth) for each, _, its_depth in bent()
        ],
        "1 of 1 layers": [(each, its_image, its_depth) for each, its_image, its_depth in wall],
        "parallax": [(camera, image, depth)] * VIEWS,
        "no depth": [(each, its_image, None) for each, its_image, _ in bent()],
        "no known depth": [
            (each, its_image, np.zeros_like(depth)) for each, its_image, _ in bent()
        ],
        "at least 2": bent()[:1],
    }
    for word, poses in cases.items():
        found = scores(poses)
        assert not {name for name, _, _ in found.values} & set(NAMES), word
        for name in NAMES:
            assert word in found.not_computed[name]


@pytest.mark.slow
def test_it_is_measured_only_where_it_is_named():
    """A path's score has its values, one for each step too, where a protocol names it, and no word
    of it otherwise.
    """
    unasked, asked = scores(bent(), ()), scores(bent(), METRICS[:1])
    whole = {name: value for name, pose, value in asked.values if pose is None}

    assert not set(NAMES) & {*unasked.not_computed, *(name for name, _, _ in unasked.values)}
    assert [whole[name] for name in NAMES] == [
        exact().rotation,
        exact().translation,
        exact().measured_share,
    ]
    assert [
        (pose, value)
        for name, pose, value in asked.values
        if name == "SGC_rotation" and pose is not None
    ] == [(pose, rotation) for pose, rotation, _ in exact().steps]


@pytest.mark.slow
def test_cameras_that_only_turn_have_no_translation():
    """The rotations of their regions are compared; of translations it says why there are none."""
    poses = []
    for index, camera in enumerate(path()):
        world_to_camera = np.eye(4)
        world_to_camera[:3, :3] = rotation_by(np.array([0.0, 0.02 * index, 0.0]))
        turned = replace(camera, world_to_camera=world_to_camera)
        image, depth = see(turned, [WALL, BOARD])
        poses.append((turned, image, depth))
    found = scores(poses)

    assert (
        next(value for name, pose, value in found.values if name == "SGC_rotation" and pose is None)
        < 0.1**2
    )
    assert "only turn" in found.not_computed["SGC_translation"]


@pytest.mark.slow
def test_bits_do_not_depend_on_threads():
    """Equal numbers and maps by one thread and by four."""
    before, found = cv2.getNumThreads(), []
    try:
        for threads in (1, 4):
            cv2.setNumThreads(threads)
            found.append(spatial_consistency(bent(1)))
    finally:
        cv2.setNumThreads(before)

    assert found[0].steps == found[1].steps
    assert np.array_equal(found[0].bend_px, found[1].bend_px, equal_nan=True)


def test_a_depth_that_does_not_fit_is_refused():
    """A depth of another size names its pose and both sizes."""
    poses = [(camera, image, depth[1:]) for camera, image, depth in bent()]
    with refused(MetricError, "pose path0000", "240 x 320", "239"):
        spatial_consistency(poses)
