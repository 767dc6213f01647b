"""The squared error taken apart: errors made to measure end where they belong, and the parts add up."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage import data

from ggvs_eval.camera import Camera
from ggvs_eval.files.images import quantise, read_image, round_levels, write_image
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.tables.error_budget import NOT_TOLD, ErrorBudget, budget_table, error_budget, smooth_colour_map
from ggvs_eval.run_folder import frame_path
from helpers.run_folders import LABELS, RunShape, write_run

GREY = np.full((60, 80, 3), 100, np.uint8)
LEFT = np.broadcast_to(np.arange(80) < 40, (60, 80))


@pytest.fixture(scope="module")
def photograph() -> np.ndarray:
    """A picture with texture, 320 x 240."""
    return np.ascontiguousarray(data.astronaut()[40:280, 60:380])


@pytest.mark.parametrize("body", [np.s_[100:380, 200:320], np.s_[120:240, 20:300]])
def test_a_missing_body_is_a_wrong_surface_and_no_colour(body):
    """Exact colours but for a body of 120 x 280 pixels that shows what is behind it: at most 10 % is colour."""
    truth = cv2.resize(data.astronaut(), (640, 480), interpolation=cv2.INTER_AREA)
    image = truth.copy()
    truth[body] = truth[body] // 4 + np.array((120, 40, 10), np.uint8)
    budget = error_budget(image, truth, None)
    assert budget.colour <= 0.1 * budget.total
    assert budget.surface > 0.6 * budget.total


@pytest.mark.parametrize("tint", [(1.05, 1.05, 1.05), (1.1, 1.0, 0.9)])
def test_another_gain_or_vignette_is_colour(photograph, tint):
    """Another exposure, white balance or falloff: above 80 % is colour, by a map that a missing body does not bend."""
    truth = photograph // 2 + 40
    y, x = np.mgrid[-1:1:240j, -1:1:320j]
    for light in (np.ones((240, 320, 1)), (1 - 0.1 * (x * x + y * y))[..., None]):
        image = np.rint(truth * light * tint).astype(np.uint8)
        budget = error_budget(image, truth, None)
        assert budget.colour > 0.8 * budget.total
        patched = truth.copy()
        patched[60:160, 100:140] = 255 - patched[60:160, 100:140]
        mapped = smooth_colour_map(image, patched, np.ones((240, 320), np.float32))
        assert np.abs(mapped - truth).mean() < 0.3 * np.abs(image.astype(float) - truth).mean()


def test_a_checkered_error_is_detail():
    """An error of 10 levels that changes its sign from pixel to pixel averages to nothing: all of it is detail."""
    signs = np.where(np.indices((60, 80)).sum(axis=0) % 2, 10, -10)[..., None]
    budget = error_budget((GREY + signs).astype(np.uint8), GREY, None)
    assert budget.unseen is None
    assert (budget.colour, budget.surface, budget.detail) == pytest.approx((0, 0, 100), abs=1)


def test_a_texture_in_the_wrong_place_is_misplaced(photograph):
    """Two pixels to the right: nearly all of the error goes where windows may move; of blur and of noise next to nothing does."""
    moved = error_budget(np.roll(photograph, 2, axis=1), photograph, None)
    blurred = error_budget(cv2.GaussianBlur(photograph, (0, 0), 1.5), photograph, None)
    noise = np.random.default_rng(0).normal(0, 8, photograph.shape)
    noisy = error_budget(round_levels(photograph + noise), photograph, None)
    assert moved.misplaced > 0.85 * moved.total
    assert blurred.misplaced < 0.06 * blurred.total
    assert noisy.misplaced < 0.01 * noisy.total


@pytest.mark.slow
@pytest.mark.parametrize("name", ["astronaut", *(pytest.param(name, marks=pytest.mark.proof) for name in ("coffee", "chelsea"))])
def test_a_region_ends_where_its_fault_belongs(name):
    """A region moved by 1 or 8 pixels is above 65 % misplaced, a blurred one above 80 % detail, other content a wrong surface."""
    truth = cv2.resize(getattr(data, name)(), (640, 480), interpolation=cv2.INTER_AREA)

    def planted(shown: np.ndarray) -> ErrorBudget:
        image = truth.copy()
        image[120:360, 200:400] = shown[120:360, 200:400]
        return error_budget(image, truth, None)

    for pixels in (1, 8):
        moved = planted(np.roll(truth, pixels, axis=1))
        assert moved.misplaced > 0.65 * moved.total
    for sigma in (2, 4):
        blurred = planted(cv2.GaussianBlur(truth, (0, 0), sigma))
        assert blurred.detail > 0.8 * blurred.total
    other = planted(np.roll(truth, 240, axis=1))
    assert other.surface > 0.5 * other.total
    assert other.misplaced < 0.15 * other.total


@pytest.mark.slow
def test_wrong_depth_is_told_from_blur():
    """Of the error that depth 2 % wrong adds to a rendered wall 90 % is misplaced, of what blur adds nothing."""
    K = np.array([[400.0, 0, 240], [0, 400, 180], [0, 0, 1]])
    poses = [np.block([[np.eye(3), np.array([[-x], [0], [0]])], [np.zeros((1, 3)), 1]]) for x in (0.0, -0.5, 0.5)]
    target, *others = (Camera(f"cam{at}", K, pose, 480, 360, 2.0, 8.0) for at, pose in enumerate(poses))
    truth, *seen = (np.ascontiguousarray(data.coffee()[20:380, 60 + x : 540 + x]) for x in (0, -40, 40))  # a wall at z = 5

    def rendered(wrong: float) -> np.ndarray:
        depths = [np.full((360, 480), 5 * (1 + side * wrong), np.float32) for side in (-1, 1)]
        views = [SourceView(*view, np.ones_like(view[2])) for view in zip(others, seen, depths, strict=True)]
        return quantise(find_method("ours-geometric").make().step(Instant(0, target, tuple(views), 1.0)).image)

    right, wrong = rendered(0.0), rendered(0.02)
    budgets = [error_budget(image, truth, None) for image in (right, wrong, cv2.GaussianBlur(right, (0, 0), 2))]
    by_depth, by_blur = ((each.misplaced - budgets[0].misplaced, each.total - budgets[0].total) for each in budgets[1:])
    assert by_depth[0] > 0.9 * by_depth[1]
    assert by_blur[0] < 0.05 * by_blur[1]


def test_what_no_camera_sees_counts_apart():
    """An error of 10 levels in the unseen half is unseen alone, and does not leak into the errors of the other half."""
    image = np.where(LEFT[..., None], GREY + np.uint8(10), GREY)
    budget = error_budget(image, GREY, LEFT)
    parts = (budget.unseen, budget.colour, budget.surface, budget.misplaced, budget.detail)
    assert parts == pytest.approx((50, 0, 0, 0, 0), abs=1e-6)


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_the_parts_add_up_to_the_squared_error(seed, is_told):
    """For any pictures and mask the parts sum to the mean squared error, which is that of the PSNR."""
    rng = np.random.default_rng(seed)
    image, truth = rng.integers(0, 256, (2, 24, 32, 3), np.uint8)
    budget = error_budget(image, truth, rng.random((24, 32)) < 0.3 if is_told else None)
    assert budget.total == pytest.approx(255**2 / 10 ** (psnr(image, truth) / 10), rel=1e-6)


def test_the_table_has_a_row_per_method_and_view(tmp_path):
    """Each method's shares, then those of ours per view, each sum to 100 %; without masks the first says what it wants."""
    root = write_run(tmp_path / "run", RunShape(views=("cam00", "cam01"), poses=0))
    run = read_run(root)
    table = budget_table(run)
    shown = run.name("ours-geometric")
    names = [*(run.name(label) for label in LABELS), f"{shown} in cam00", f"{shown} in cam01"]
    assert [row.name for row in table.rows] == names
    for row in table.rows:
        assert row.cells[1] == NOT_TOLD
        assert "PSNR" not in row.cells[1].shown
        assert sum(cell.value for cell in row.cells[2:]) == pytest.approx(100)

    for view in run.protocol.views.test:
        for frame in run.frames:
            shape = read_image(frame_path(run.folder.truth(view), frame)).shape
            write_image(frame_path(run.folder.disoccluded(view), frame), np.full(shape, 255, np.uint8))
    told = budget_table(read_run(root))
    assert ([*map(len, (table.notes, told.notes))], "add PSNR_disoccluded" in table.notes[0]) == ([1, 0], True)
    assert [row.cells[1].value for row in told.rows] == pytest.approx([100] * len(told.rows))
    assert [row.cells[0].value for row in told.rows] == pytest.approx([row.cells[0].value for row in table.rows])


def test_without_pictures_there_is_no_table(tmp_path):
    """A run in which no method has every frame has nothing to take apart."""
    run = read_run(write_run(tmp_path / "run", RunShape(poses=0)))
    assert budget_table(replace(run, labels=())) is None
