"""Validation of depth: each measure in closed form, regions of drawn pictures, points of a written
model, and what is refused.
"""

import numpy as np
import pytest

from benchmarks.depth_validation import middlebury
from benchmarks.depth_validation.__main__ import main
from benchmarks.depth_validation.depth_errors import relative_errors, summarise
from benchmarks.depth_validation.evaluate_matcher import validate_depth
from benchmarks.depth_validation.figures import Measure, figures_of, quoted_figures
from benchmarks.depth_validation.middlebury import (
    evaluate_motorcycle,
    fill_disparity,
    read_motorcycle,
    score_disparity,
)
from benchmarks.depth_validation.named_matchers import depth_options, pairwise_matchers
from benchmarks.depth_validation.region_errors import FRAME, errors_by_region, evaluate_rooms
from benchmarks.depth_validation.room_regions import (
    RegionOptions,
    discontinuities,
    find_regions,
    slope_of_grey,
    thin_structures,
)
from benchmarks.depth_validation.rooms import FRAMES, RenderedRoom
from benchmarks.depth_validation.sparse_points import (
    choose_points,
    evaluate_sparse,
    read_sparse_points,
    score_points,
)
from benchmarks.depth_validation.static_reuse import evaluate_reuse
from benchmarks.depth_validation.temporal_spread import find_static, measure_spread, temporal_spread
from ggvs_eval.capture import Capture
from ggvs_eval.contrib.worlds.film.film import DepthWriter, depth_path
from ggvs_eval.contrib.worlds.film.options import DemoOptions
from ggvs_eval.depth_store import DepthMap
from ggvs_eval.errors import CaptureError, DepthError
from ggvs_eval.files.images import write_image
from ggvs_eval.method import SourceView
from ggvs_eval.pipelines.offline.depth.camera_depth import DepthOptions
from ggvs_eval.pipelines.offline.stereo.sgbm import SgbmMatcher
from helpers.refusals import refused
from helpers.stereo_scenes import (
    PLANE,
    look_from,
    plane_depth,
    random_texture,
    see_plane,
    write_capture,
)

CAMERA = look_from(0, 0, "camera")


def full(value: float, shape: tuple[int, ...] = (40, 60)) -> np.ndarray:
    return np.full(shape, value, np.float32)


# Disparity against measured disparity


def test_planted_errors_are_found_exactly():
    """Of 100 pixels, 10 are wrong by 2.5 px and 5 by 4 px: EPE 0.45 px, bad-2 15 %, bad-3 5 %."""
    truth = full(20, (10, 10))
    disparity = truth.copy()
    disparity[0] += 2.5
    disparity[1, :5] -= 4
    scores = score_disparity(disparity, truth)
    assert scores == pytest.approx(
        {
            "epe_px": 0.45,
            "bad_2_percent": 15,
            "bad_3_percent": 5,
            "epe_kept_px": 0.45,
            "density_percent": 100,
        }
    )
    assert score_disparity(full(22), full(20))["bad_2_percent"] == 0  # not above 2 px
    truth[:, 5:] = 0  # where nothing was measured nothing counts
    assert score_disparity(np.where(truth > 0, truth + 1, 99).astype(np.float32), truth)[
        "epe_px"
    ] == pytest.approx(1)


def test_rejected_pixels_count_as_the_background_beside_them():
    """A hole between disparity 30 and 10 becomes 10; right for the background's half, 20 px wrong
    for the other.
    """
    truth = np.where(np.arange(60) < 30, 30, 10) * full(1)
    disparity = truth.copy()
    disparity[:, 24:36] = 0
    scores = score_disparity(disparity, truth)
    assert scores["density_percent"] == pytest.approx(80)
    assert scores["epe_px"] == pytest.approx(20 * 6 / 60)
    assert scores["bad_3_percent"] == pytest.approx(10)
    assert scores["epe_kept_px"] == 0
    nothing = score_disparity(full(0), full(20))  # no matcher gains by rejecting everything
    assert (nothing["epe_px"], nothing["density_percent"]) == (20, 0)
    assert np.isnan(nothing["epe_kept_px"])


def test_filling_keeps_what_was_found():
    """Kept disparities keep their bits; an empty row takes the smaller of the rows above
    and below.
    """
    disparity = np.array([[7.3, 0, 11.1], [0, 0, 0], [5, 5, 5]], np.float32)
    filled = fill_disparity(disparity)
    assert np.array_equal(filled[disparity > 0], disparity[disparity > 0])
    assert filled[0, 1] == pytest.approx(7.3)
    assert filled[1] == pytest.approx([5, 5, 5])


def write_pair(folder, shift: int = 12) -> np.ndarray:
    """A pair of one surface, and its disparity with a corner unknown (infinite, as some files have
    it).
    """
    texture = random_texture(1)[:100, :240]
    grey = np.rint(255 * texture).astype(np.uint8)[..., None].repeat(3, axis=-1)
    write_image(folder / "motorcycle_left.png", grey[:, : 240 - shift])
    write_image(folder / "motorcycle_right.png", grey[:, shift:])
    disparity = full(shift, (100, 240 - shift))
    disparity[:10, :10] = np.inf
    np.savez(folder / "motorcycle_disp.npz", disparity)
    return disparity


def test_matcher_on_a_written_pair(tmp_path):
    """The real matcher finds the shift of a written pair; learned matchers alone have targets,
    peers are quoted.
    """
    write_pair(tmp_path)
    rows, figures = evaluate_motorcycle(
        tmp_path, {"sgbm": SgbmMatcher(), "raft": SgbmMatcher(levels=1)}
    )
    assert rows["sgbm"]["epe_px"] < 0.5
    assert rows["sgbm"]["bad_3_percent"] < 3
    assert figures["depth.motorcycle.epe_px.sgbm"]["target"] is None
    assert figures["depth.motorcycle.epe_px.raft"]["target"] == 1.5
    assert figures["depth.motorcycle.epe_px.raft"]["peer_value"] == rows["sgbm"]["epe_px"]
    quoted = figures["depth.motorcycle.bad_3_percent.raft.vs.KITTI-trained-PSMNet"]
    assert quoted["peer_value"] == 8.6
    assert "depth.motorcycle.bad_2_percent.raft.vs.KITTI-trained-PSMNet" not in figures


def test_damaged_pair_is_refused(tmp_path):
    """An absent image, a cut disparity file and one of another size are errors that name the file;
    infinite truth is unknown.
    """
    with pytest.raises(CaptureError, match=r"motorcycle_left\.png"):
        read_motorcycle(tmp_path)
    disparity = write_pair(tmp_path)
    assert np.array_equal(
        read_motorcycle(tmp_path).disparity, np.where(np.isinf(disparity), 0, disparity)
    )
    np.savez(tmp_path / "motorcycle_disp.npz", full(3, (7, 7)))
    with refused(DepthError, "motorcycle_disp.npz", "(7, 7)"):
        read_motorcycle(tmp_path)
    (tmp_path / "motorcycle_disp.npz").write_bytes(b"PK\x03\x04 cut")
    with refused(DepthError, "motorcycle_disp.npz", "disparity"):
        read_motorcycle(tmp_path)


# Relative errors of depth


def test_relative_errors_and_their_summary():
    """Errors of 1, 1, 3 and, where there is no depth, 100 %: half are within 2 %, the median is 2
    %, a quarter was rejected.
    """
    truth = full(8, (1, 4))
    depth = truth * np.array([1.01, 0.99, 1.03, 0], np.float32)
    errors = relative_errors(depth, truth)
    assert errors[0] == pytest.approx([0.01, 0.01, 0.03, 1], abs=1e-6)
    summary = summarise([errors], [depth == 0])
    assert summary == pytest.approx(
        {"within_2_percent": 50, "median_error_percent": 2, "rejected_percent": 25}, abs=1e-4
    )
    # pictures weigh by their pixels
    pooled = summarise([full(0, (9,)), full(1, (1,))], [full(0, (9,)), full(1, (1,))])
    assert (pooled["within_2_percent"], pooled["rejected_percent"]) == pytest.approx((90, 10))


@pytest.mark.parametrize(
    ("compare", "message"),
    [
        (lambda: score_disparity(full(1), full(1, (4, 4))), r"\(40, 60\).*\(4, 4\)"),
        (lambda: score_disparity(full(1), full(0)), "with 0 known pixels"),
        (lambda: relative_errors(full(1), full(1, (2, 2))), "wanted depth and truth of one shape"),
        (lambda: relative_errors(full(1), full(0)), "wanted a positive true depth, got 0"),
        (lambda: summarise([], []), "wanted at least one pixel"),
        (
            lambda: find_regions(full(1), np.zeros((3, 3, 3), np.uint8), RegionOptions()),
            r"\(40, 60\).*\(3, 3, 3\)",
        ),
        (
            lambda: score_points(full(1), choose_points(np.empty((0, 5)), CAMERA)),
            "wanted at least one point to compare with",
        ),
        (
            lambda: temporal_spread(full(1, (1, 8, 8)), np.ones((8, 8), bool)),
            r"\(8, 8\).*\(1, 8, 8\)",
        ),
        (
            lambda: temporal_spread(full(1, (3, 8, 8)), np.zeros((8, 8), bool)),
            "static pixels.*got none",
        ),
        (lambda: depth_options("sbgm"), "'sbgm'"),
    ],
)
def test_senseless_depth_comparisons_are_refused(compare, message):
    """Other shapes, a truth that is unknown and nothing to compare are errors that say what
    came.
    """
    with pytest.raises(DepthError, match=message):
        compare()


def test_filled_pixels_are_rejected_ones():
    """What is trusted no more than a filled pixel counts as rejected, its error as it stands; other
    regions do not see it.
    """
    depth, confidence = full(5), full(0.5)
    confidence[:, :6], depth[:, :6] = 0.02, 10
    depth[0, 0] = confidence[0, 0] = 0
    left = np.zeros(depth.shape, bool)
    left[:, :6] = True
    found = errors_by_region(
        DepthMap(depth, confidence), full(5), {"left": left, "right": ~left}, np.float32(0.02)
    )
    errors, rejected = found["left"]
    assert rejected.all()
    assert (errors == 1).all()
    assert not found["right"][1].any()
    assert not found["right"][0].any()


def test_a_room_is_judged_region_by_region(tmp_path):
    """A textured plane with exact depth beside it: all of it is texture, nearly all right, and no
    other region has pixels.
    """
    capture = write_capture(tmp_path / "plane", n_frames=FRAME + 1)
    camera = capture.cameras[0]
    truth = plane_depth(camera, PLANE - [0, 0, 0.2 * FRAME]).astype(np.float32)
    with DepthWriter(
        depth_path(capture.path, camera.name), [FRAME], camera.height, camera.width
    ) as writer:
        writer.add(FRAME, truth)
    table, figures = evaluate_rooms(
        [RenderedRoom("demo", DemoOptions(), capture)], {"sgbm": DepthOptions(partners=2)}
    )
    assert table.loc[("demo", "texture"), ("", "pixels_percent")] > 95
    assert table.loc[("demo", "thin"), ("", "pixels_percent")] == 0
    assert np.isnan(table.loc[("demo", "thin"), ("sgbm", "within_2_percent")])
    assert table.loc[("demo", "texture"), ("sgbm", "within_2_percent")] > 90
    assert figures["depth.demo.texture.median_error_percent.sgbm"]["value"] < 0.5
    assert "depth.demo.thin.median_error_percent.sgbm" not in figures


@pytest.mark.slow
def test_reuse_saves_what_stands_still(tmp_path):
    """Of a plane at rest only the first frame is computed, and its depth stays as good; of one that
    moves, every frame is.
    """
    saved = {}
    for name, step in (("still", 0.0), ("moving", 0.2)):
        capture = write_capture(tmp_path / name, FRAMES, step)
        camera = capture.cameras[0]
        with DepthWriter(
            depth_path(capture.path, camera.name), range(FRAMES), camera.height, camera.width
        ) as writer:
            for frame in range(FRAMES):
                writer.add(
                    frame, plane_depth(camera, PLANE - [0, 0, step * frame]).astype(np.float32)
                )
        table, figures = evaluate_reuse(
            [RenderedRoom(name, DemoOptions(), capture)], {"sgbm": DepthOptions(partners=2)}
        )
        row = table.loc[name, "sgbm"]
        assert row["within_2_percent_whole"] > 90
        assert row["within_2_percent_reused"] == pytest.approx(row["within_2_percent_whole"], abs=2)
        saved[name] = figures["depth.reuse.time_saved_percent.sgbm"]["value"]
    assert saved["still"] > 60
    assert saved["moving"] < 30


# Regions


def test_planes_have_no_edges():
    """However slanted, a plane has neither discontinuities nor thin structures."""
    slanted = plane_depth(CAMERA, np.array([0.6, 0.3, 6.0])).astype(np.float32)
    assert slanted.max() > 2 * slanted.min() > 0
    assert not discontinuities(slanted, 0.03).any()
    assert not thin_structures(slanted, 6, 0.05).any()
    depth = full(8)
    depth[:, :3] = 4  # a wide thing of which the picture shows three columns
    assert not thin_structures(depth, 6, 0.05).any()


def test_a_step_is_an_edge_on_both_sides():
    """A step between two columns marks exactly these two; one below the threshold marks nothing."""
    depth = np.where(np.arange(60) < 30, 4.0, 6.0).astype(np.float32) * np.ones((40, 1), np.float32)
    found = discontinuities(depth, 0.03)
    assert found[:, 29:31].all()
    assert found.sum() == 2 * 40
    assert np.array_equal(discontinuities(depth.T, 0.03), found.T)
    assert not discontinuities(np.where(depth == 6, np.float32(4.08), depth), 0.03).any()


@pytest.mark.parametrize(("width", "is_thin"), [(1, True), (6, True), (7, False), (20, False)])
def test_thin_is_what_is_narrow_and_near(width, is_thin):
    """A near bar of up to 6 px is thin, upright or lying; a wider one is not; a narrow gap between
    near things never is.
    """
    depth = full(8, (60, 60))
    depth[:, 20 : 20 + width] = 4
    expected = (depth == 4) & is_thin
    assert np.array_equal(thin_structures(depth, 6, 0.05), expected)
    assert np.array_equal(thin_structures(depth.T.copy(), 6, 0.05), expected.T)
    assert not thin_structures(12 - depth, 6, 0.05).any()


def test_slope_of_a_ramp():
    """A ramp of 3 grey levels per pixel across and 1 down has the slope of their root of
    squares.
    """
    ramp = 3.0 * np.arange(40) + np.arange(60)[:, None]
    image = ramp.astype(np.uint8)[..., None].repeat(3, axis=-1)
    assert slope_of_grey(image, 9)[20:30, 10:30] == pytest.approx(np.sqrt(10), abs=0.02)


def test_regions_divide_the_known_pixels():
    """Of a wall half painted, half plain, with a box and a rod before it, each pixel is in one
    region, and in the right one.
    """
    depth = full(8, (120, 160))
    depth[50:90, 100:140] = 5  # a box before the painted half
    depth[:, 40:44] = 5  # a rod before the plain half
    depth[:5] = 0  # unknown
    image = np.full((120, 160, 3), 128, np.uint8)
    image[:, 80:] = np.rint(255 * random_texture(2)[:120, :80, None])
    regions = find_regions(depth, image, RegionOptions())
    assert np.array_equal(
        sum(mask.astype(int) for mask in regions.values()), (depth > 0).astype(int)
    )
    assert np.array_equal(regions["thin"], (depth == 5) & (np.arange(160) < 60))
    assert regions["edge"][60, 96:104].all()  # four pixels to each side of the box's left edge
    assert not regions["edge"][60, [94, 106]].any()
    assert regions["edge"][60, [37, 38, 39, 44, 45, 46]].all()
    assert regions["untextured"][20:, 52:70].all()
    assert regions["texture"][20:40, 90:].all()
    assert regions["texture"][60:80, 110:130].all()


# Sparse points


def rows_of(points: list[tuple[float, float, float, int, float]]) -> np.ndarray:
    return np.array(points, float)


def test_only_sure_points_count():
    """Points of two observations, of a large error, without an error, outside the image or behind
    the camera are left out.
    """
    good = (0.5, 0.25, 6.0, 3, 0.9)
    others = [
        (0.5, 0.5, 6.0, 2, 0.1),
        (0.5, 0.5, 6.0, 9, 1.0),
        (0.5, 0.5, 6.0, 9, -1.0),
        (1.0, 0.5, 6.0, 9, 0.1),
    ]
    points = choose_points(rows_of([good, *others, (0.5, 0.5, -6.0, 9, 0.1)]), CAMERA)
    assert points.uv.tolist() == [[CAMERA.width / 2, CAMERA.height / 4]]
    assert points.depth.tolist() == [6.0]


def test_points_are_compared_at_their_own_pixels():
    """Of four planted points one is 1 %, one 3 % off, one has no depth and one fits: half are
    within 2 %, the median is 2 %.
    """
    depth = full(0, (CAMERA.height, CAMERA.width))
    factors = (1.0, 1.01, 1.03, 0.0)
    columns = np.array([3, 50, 100, 199])
    depth[20, columns] = 6 * np.array(factors)
    rows = [
        ((column + 0.9) / CAMERA.width, 20.1 / CAMERA.height, 6.0, 5, 0.5) for column in columns
    ]
    scores = score_points(depth, choose_points(rows_of(rows), CAMERA))
    assert scores == pytest.approx({"within_2_percent": 50, "median_error_percent": 2}, abs=1e-4)


def write_model(
    folder,
    capture: Capture,
    depth_factor: float = 1.0,
    model: str = "PINHOLE",
    width_factor: int = 2,
) -> None:
    """A COLMAP model in text: 40 points of the plane, seen by every camera of the capture, at twice
    its size.
    """
    folder.mkdir(parents=True)
    first = capture.cameras[0]
    uv = np.stack(np.meshgrid(np.linspace(70, 130, 8), np.linspace(50, 100, 5)), -1).reshape(-1, 2)
    z = plane_depth(first)[uv[:, 1].astype(int), uv[:, 0].astype(int)]
    points = first.unproject(uv, z)
    cameras, images = [], []
    for number, camera in enumerate(capture.cameras, 1):
        K = camera.K * width_factor
        distortion = " 0.1 0 0 0" if model == "OPENCV" else ""
        size = f"{camera.width * width_factor} {camera.height * width_factor}"
        cameras.append(
            f"{number} {model} {size} {K[0, 0]} {K[1, 1]} {K[0, 2]} {K[1, 2]}{distortion}"
        )
        turned = camera.world_to_camera[:3, 3]
        seen = camera.project(points)[0] * width_factor
        images.append(
            f"{number} 1 0 0 0 {turned[0]} {turned[1]} {turned[2]} {number} {camera.name}/0000.png"
        )
        images.append(" ".join(f"{u} {v} {index}" for index, (u, v) in enumerate(seen, 1)))
    # The tracks say who saw a point; depth_factor moves it along the first camera's ray.
    moved = first.centre + depth_factor * (points - first.centre)
    lines = []
    for index, (x, y, depth) in enumerate(moved, 1):
        track = " ".join(f"{number} {index - 1}" for number in range(1, len(capture.cameras) + 1))
        lines.append(f"{index} {x} {y} {depth} 9 9 9 0.3 {track}")
    for name, content in (("cameras", cameras), ("images", images), ("points3D", lines)):
        (folder / f"{name}.txt").write_text("\n".join(content) + "\n")


@pytest.fixture
def planes(tmp_path) -> Capture:
    return write_capture(tmp_path / "plane", n_frames=1)


def test_depth_of_a_rig_against_its_points(planes):
    """Points of a written model lie where the pictures show them: stereo hits nearly all, the table
    has a row per camera.
    """
    write_model(planes.path / "sparse" / "0", planes)
    table, figures = evaluate_sparse(planes, {"sgbm": DepthOptions(partners=2)})
    assert list(table.index) == list(planes.camera_names)
    assert table["sgbm", "within_2_percent"].mean() > 95
    assert figures["depth.sparse.within_2_percent.sgbm"]["value"] == pytest.approx(
        table["sgbm", "within_2_percent"].mean()
    )
    assert figures["depth.sparse.median_error_percent.sgbm"]["value"] < 0.5
    assert figures["depth.sparse.median_error_percent.sgbm"]["target"] == 0.35


def test_points_are_read_at_the_size_of_the_capture(planes):
    """Observations of a model at twice the size land on the capture's pixels; depth is that of the
    points.
    """
    write_model(planes.path / "sparse" / "0", planes, depth_factor=1.5)
    points = read_sparse_points(planes)["cam00"]
    assert points.uv.min(axis=0) == pytest.approx([70, 50])
    pixels = points.uv.astype(int)
    assert points.depth == pytest.approx(
        1.5 * plane_depth(planes.cameras[0])[pixels[:, 1], pixels[:, 0]], rel=1e-6
    )


def test_models_without_use_are_refused(planes):
    """No model, a distorting camera and a damaged file each raise CaptureError that says what to
    do.
    """
    with refused(CaptureError, "COLMAP", "points", "calibrate"):
        read_sparse_points(planes)
    write_model(planes.path / "sparse" / "0", planes, model="OPENCV")
    with refused(CaptureError, "pinhole", "OPENCV", "image_undistorter"):
        read_sparse_points(planes)
    (planes.path / "sparse" / "0" / "points3D.txt").unlink()
    with pytest.raises(CaptureError, match="its points cannot be read"):
        read_sparse_points(planes)


# Spread over time


def test_spread_of_a_known_wave():
    """Depth that alternates by 1 % about its mean over four instants spreads by 1 % times the root
    of 4 / 3.
    """
    depths = full(10, (4, 8, 8)) * np.array([0.99, 1.01, 0.99, 1.01], np.float32)[:, None, None]
    assert temporal_spread(depths, np.ones((8, 8), bool)) == pytest.approx(
        0.01 * np.sqrt(4 / 3), rel=1e-4
    )
    depths[:, :4] *= np.array([1, 2, 3, 4], np.float32)[:, None, None]  # moving
    depths[1, 4] = 0  # unknown once
    assert temporal_spread(depths, np.arange(8)[:, None] >= np.full((8, 8), 4)) == pytest.approx(
        0.01 * np.sqrt(4 / 3), rel=1e-4
    )


def test_the_filter_shrinks_white_noise_as_it_must():
    """In still pictures the filter is recursive with weight beta = 0.6: white noise shrinks to the
    root of 0.6 / 1.4.
    """
    random = np.random.default_rng(0)
    image = see_plane(CAMERA)
    noise = random.normal(1, 0.002, (60, *image.shape[:2]))
    views = [
        SourceView(CAMERA, image, (6 * each).astype(np.float32), full(1, image.shape[:2]))
        for each in noise
    ]
    scores = measure_spread(views, np.ones(image.shape[:2], bool))
    assert scores["spread_percent"] == pytest.approx(0.2, rel=0.02)
    assert scores["share_of_unfiltered"] == pytest.approx(np.sqrt(0.6 / 1.4), rel=0.04)
    assert scores["spread_filtered_percent"] == pytest.approx(
        scores["spread_percent"] * scores["share_of_unfiltered"]
    )
    # mean size of a difference of two
    assert scores["flicker_percent"] == pytest.approx(0.2 * 2 / np.sqrt(np.pi), rel=0.02)


def test_static_is_what_changes_in_neither_colour_nor_depth():
    """A change of one channel by one level, one of depth, and unknown depth each make a pixel not
    static.
    """
    images, depths = np.full((3, 4, 4, 3), 100, np.uint8), full(5, (3, 4, 4))
    images[2, 0, 0, 1] += 1
    depths[1, 1, 1] += 1e-4
    depths[:, 2, 2] = 0
    expected = np.ones((4, 4), bool)
    expected[[0, 1, 2], [0, 1, 2]] = False
    assert np.array_equal(find_static(images, depths), expected)


# Figures and the whole


def test_figures_name_the_baseline_as_peer():
    """Every matcher but the baseline has it as its peer; a ratio above 1 means better in either
    direction.
    """
    measures = (
        Measure("share", "%", higher_is_better=True),
        Measure("error", "px", higher_is_better=False, target=1.0),
    )
    values = {"sgbm": {"share": 80.0, "error": 2.0}, "raft": {"share": 90.0, "error": 1.0}}
    figures = figures_of("pair", measures, values)
    assert "peer" not in figures["depth.pair.share.sgbm"]
    assert figures["depth.pair.share.raft"]["ratio"] == pytest.approx(1.125)
    assert figures["depth.pair.error.raft"]["ratio"] == pytest.approx(2)
    assert figures["depth.pair.error.raft"]["target"] == 1
    assert measures[0].ratio(0.0, 3.0) is None
    quoted = quoted_figures("pair", measures, values, {"a paper": {"error": 3.0}})
    assert set(quoted) == {"depth.pair.error.sgbm.vs.a-paper", "depth.pair.error.raft.vs.a-paper"}
    assert quoted["depth.pair.error.sgbm.vs.a-paper"]["ratio"] == pytest.approx(1.5)


def test_matchers_have_the_options_of_the_pipeline():
    """Validation takes each matcher as the pipeline would; one rectified pair is nothing for the
    plane sweep.
    """
    matchers = pairwise_matchers({name: depth_options(name) for name in ("raft", "sweep", "sgbm")})
    assert [matcher.name for matcher in matchers.values()] == ["raft-stereo", "sgbm-3way"]


def test_unknown_names_are_refused(tmp_path, capsys):
    """Unknown parts and no matcher are errors that name what there is; of absent data nothing is
    computed, and a line says so.
    """
    with refused(DepthError, "motorcycle, sparse, rendering, rooms, temporal, reuse", "parts room"):
        validate_depth(tmp_path, tmp_path, ["sgbm"], ["room"])
    with pytest.raises(DepthError, match="got no matcher"):
        validate_depth(tmp_path, tmp_path, [])
    assert (
        validate_depth(tmp_path / "data", tmp_path / "out", ["sgbm"], ["motorcycle", "sparse"])
        == {}
    )
    printed = capsys.readouterr().out
    assert (
        f"motorcycle: not computed: no pair at {tmp_path / 'data' / middlebury.FOLDER}; give --data"
        in printed
    )
    assert "sparse points: not computed: no capture at" in printed


def test_the_command_writes_table_and_figures(tmp_path, capsys):
    """`python -m benchmarks.depth_validation` evaluates the pair it is given; what it refuses is
    one line.
    """
    folder = tmp_path / "data" / middlebury.FOLDER
    folder.mkdir(parents=True)
    write_pair(folder)
    places = ["--data", str(tmp_path / "data"), "--out", str(tmp_path / "out")]
    main([*places, "--only", "motorcycle"])
    assert "epe_px" in capsys.readouterr().out
    assert (tmp_path / "out/depth_validation/motorcycle.csv").is_file()
    assert (
        "depth.motorcycle.epe_px.sgbm"
        in (tmp_path / "out/depth_validation/figures.json").read_text()
    )
    with pytest.raises(
        SystemExit, match=r"^ggvs-eval: depth validation: wanted a matcher and parts of [^\n]*$"
    ):
        main([*places, "--only", "rom"])
