"""The squared error taken apart: errors made to measure end where they belong, and the parts add
up.
"""

from dataclasses import asdict, replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from skimage import data

from ggvs_eval.files.images import read_image, round_levels, write_image
from ggvs_eval.metrics.image.psnr import psnr
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.tables.error_budget import NOT_TOLD, budget_table, error_budget
from ggvs_eval.run_folder import frame_path
from helpers.run_folders import LABELS, RunShape, write_run

GREY = np.full((60, 80, 3), 100, np.uint8)
LEFT = np.broadcast_to(np.arange(80) < 40, (60, 80))


def shifted(
    truth: np.ndarray, right_px: float, down_px: float = 0.0, scale: float = 1.0
) -> np.ndarray:
    """The picture moved, and enlarged about its middle."""
    middle = np.array(truth.shape[1::-1]) / 2
    matrix = np.hstack([scale * np.eye(2), ((1 - scale) * middle + (right_px, down_px))[:, None]])
    return cv2.warpAffine(
        truth, matrix, truth.shape[1::-1], flags=cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT
    )


def inside(truth: np.ndarray, other: np.ndarray, box: tuple[slice, slice]) -> np.ndarray:
    """The picture with some of another."""
    image = truth.copy()
    image[box] = other[box]
    return image


def planted_errors(truth: np.ndarray, other: np.ndarray) -> dict[str, tuple[str, np.ndarray]]:
    """Thirty-two errors: what was done -> its cause, and the image."""
    height, width = truth.shape[:2]
    body = np.s_[height // 4 : 3 * height // 4, width // 3 : 2 * width // 3]
    levels, rng = truth.astype(np.float32), np.random.default_rng(0)
    moves = {f"{px} px right": shifted(truth, px) for px in (1, 2, 4, 8, 16)}
    moves |= {"8 px down": shifted(truth, 0, 8), "1.5, -2.5 px": shifted(truth, 1.5, -2.5)}
    moves |= {f"enlarged by {scale}": shifted(truth, 0, 0, scale) for scale in (1.01, 1.03)}
    colours = {
        "gain 1.06": 1.06 * levels,
        "gain 0.7": 0.7 * levels,
        "offset": levels + 10,
        "cast": levels * (1.08, 1, 0.9),
    }
    y, x = np.mgrid[-1 : 1 : height * 1j, -1 : 1 : width * 1j]
    colours["falloff"] = levels * (1 - 0.1 * (x * x + y * y))[..., None]
    colours |= {f"gamma {power}": 255 * (levels / 255) ** power for power in (1.2, 2.2)}
    blurs = {f"blur {sigma}": cv2.GaussianBlur(truth, (0, 0), sigma) for sigma in (0.8, 1.5, 3, 5)}
    surfaces = {
        "lower half": inside(truth, other, np.s_[height // 2 :, :]),
        "left half": inside(truth, other, np.s_[:, : width // 2]),
        "other body": inside(truth, other, body),
        "hole": inside(truth, np.zeros_like(truth), body),
        "mirrored": truth[:, ::-1],
        "upside down": truth[::-1],
    }
    noises = {f"noise {sigma}": levels + rng.normal(0, sigma, truth.shape) for sigma in (3, 10)}
    parts = {f"a body moved by {px}": inside(truth, shifted(truth, px), body) for px in (2, 8)}
    parts |= {f"double, {px} px apart": (levels + shifted(truth, px)) / 2 for px in (3, 8)}
    causes = {
        "camera": moves,
        "misplaced": parts,
        "colour": colours,
        "blur": blurs,
        "surface": surfaces,
        "noise": noises,
    }
    return {
        name: (cause, round_levels(image))
        for cause, images in causes.items()
        for name, image in images.items()
    }


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "other"), [("astronaut", "coffee"), ("coffee", "chelsea"), ("chelsea", "astronaut")]
)
def test_the_planted_cause_is_the_largest_that_has_a_name(name, other):
    """Of 32 errors in each of three pictures at least 31; a move of the whole and a replaced half,
    S10's, are among them.
    """
    truth, replacement = (
        cv2.resize(getattr(data, picture)(), (320, 240), interpolation=cv2.INTER_AREA)
        for picture in (name, other)
    )
    wrong = {}
    for planted, (cause, image) in planted_errors(truth, replacement).items():
        parts = asdict(error_budget(image, truth, None)) | {"unseen": 0.0, "unexplained": 0.0}
        if max(parts, key=parts.get) != cause:
            wrong[planted] = parts
    assert len(wrong) <= 1, wrong
    assert not {"8 px right", "lower half"} & {*wrong}


def test_what_no_camera_sees_counts_apart():
    """An error of 10 levels in the unseen half is unseen alone, and does not leak into the errors
    of the other half.
    """
    image = np.where(LEFT[..., None], GREY + np.uint8(10), GREY)
    budget = error_budget(image, GREY, LEFT)
    assert (budget.unseen, budget.total) == pytest.approx((50, 50))


@given(st.integers(0, 2**32 - 1), st.booleans())
def test_the_parts_add_up_to_the_squared_error(seed, is_told):
    """For any pictures and mask the parts sum to the mean squared error, which is that of
    the PSNR.
    """
    rng = np.random.default_rng(seed)
    image, truth = rng.integers(0, 256, (2, 24, 32, 3), np.uint8)
    budget = error_budget(image, truth, rng.random((24, 32)) < 0.3 if is_told else None)
    assert budget.total == pytest.approx(255**2 / 10 ** (psnr(image, truth) / 10), rel=1e-6)


def test_the_table_has_a_row_per_method_and_view(tmp_path):
    """Each method's shares, then those of ours per view, each sum to 100 %; without masks the first
    says what it wants.
    """
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
            write_image(
                frame_path(run.folder.disoccluded(view), frame), np.full(shape, 255, np.uint8)
            )
    told = budget_table(read_run(root))
    assert ([*map(len, (table.notes, told.notes))], "add PSNR_disoccluded" in table.notes[0]) == (
        [1, 0],
        True,
    )
    assert [row.cells[1].value for row in told.rows] == pytest.approx([100] * len(told.rows))
    assert [row.cells[0].value for row in told.rows] == pytest.approx(
        [row.cells[0].value for row in table.rows]
    )


def test_without_pictures_there_is_no_table(tmp_path):
    """A run in which no method has every frame has nothing to take apart."""
    run = read_run(write_run(tmp_path / "run", RunShape(poses=0)))
    assert budget_table(replace(run, labels=())) is None
