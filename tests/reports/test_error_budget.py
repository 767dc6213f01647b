"""The squared error taken apart: errors made to measure end where they belong, and the parts add up."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage import data

from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.tables.error_budget import NOT_TOLD, budget_table, error_budget
from ggvs_eval.run_folder import frame_path
from helpers.run_folders import LABELS, RunShape, write_run

GREY = np.full((60, 80, 3), 100, np.uint8)
LEFT = np.broadcast_to(np.arange(80) < 40, (60, 80))


@pytest.fixture(scope="module")
def photograph() -> np.ndarray:
    """A picture with texture, 320 x 240."""
    return np.ascontiguousarray(data.astronaut()[40:280, 60:380])


def test_another_brightness_is_wide():
    """A picture that is 10 levels brighter throughout has a squared error of 100, all of it wide."""
    budget = error_budget(GREY + np.uint8(10), GREY, np.zeros((60, 80), bool))
    assert (budget.unseen, budget.wide, budget.misplaced, budget.detail) == pytest.approx((0, 100, 0, 0), abs=1e-3)


def test_a_checkered_error_is_detail():
    """An error of 10 levels that changes its sign from pixel to pixel averages to nothing: all of it is detail."""
    signs = np.where(np.indices((60, 80)).sum(axis=0) % 2, 10, -10)[..., None]
    budget = error_budget((GREY + signs).astype(np.uint8), GREY, None)
    assert budget.unseen is None
    assert (budget.wide, budget.detail) == pytest.approx((0, 100), abs=0.5)


def test_a_texture_in_the_wrong_place_is_misplaced(photograph):
    """Two pixels to the right: nearly all of the error goes where windows may move; of blur and of noise next to nothing does."""
    moved = error_budget(np.roll(photograph, 2, axis=1), photograph, None)
    blurred = error_budget(cv2.GaussianBlur(photograph, (0, 0), 1.5), photograph, None)
    noise = np.random.default_rng(0).normal(0, 8, photograph.shape)
    noisy = error_budget(np.rint(np.clip(photograph + noise, 0, 255)).astype(np.uint8), photograph, None)
    assert moved.misplaced > 0.85 * moved.total
    assert blurred.misplaced < 0.06 * blurred.total
    assert noisy.misplaced < 0.01 * noisy.total


def test_what_no_camera_sees_counts_apart():
    """An error of 10 levels in the unseen half is unseen alone, and does not leak into the wide error of the other half."""
    image = np.where(LEFT[..., None], GREY + np.uint8(10), GREY)
    budget = error_budget(image, GREY, LEFT)
    assert (budget.unseen, budget.wide, budget.misplaced, budget.detail) == pytest.approx((50, 0, 0, 0), abs=1e-6)


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
        assert sum(cell.value for cell in row.cells[2:]) == pytest.approx(100)

    for view in run.protocol.views.test:
        for frame in run.frames:
            shape = read_image(frame_path(run.folder.truth(view), frame)).shape
            write_image(frame_path(run.folder.disoccluded(view), frame), np.full(shape, 255, np.uint8))
    told = budget_table(run)
    assert [row.cells[1].value for row in told.rows] == pytest.approx([100] * len(told.rows))
    assert [row.cells[0].value for row in told.rows] == pytest.approx([row.cells[0].value for row in table.rows])


def test_without_pictures_there_is_no_table(tmp_path):
    """A run in which no method has every frame has nothing to take apart."""
    run = read_run(write_run(tmp_path / "run", RunShape(poses=0)))
    assert budget_table(replace(run, labels=())) is None
