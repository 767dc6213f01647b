"""Slices against arrays made by hand."""

from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.errors import RenderError, ResultsError
from ggvs_eval.files.images import read_image, write_image
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.figures.paper_figures import write_figure
from ggvs_eval.reports.figures.slices import (
    change_of_rows,
    most_different_row,
    most_textured_row,
    path_slices,
    slices_section,
    stacked_rows,
    time_slices,
)
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.run_groups import read_groups
from ggvs_eval.reports.section import Report
from ggvs_eval.run_folder import frame_path
from helpers.refusals import refused
from helpers.run_folders import LABELS, RunShape, write_run


@pytest.fixture
def frames(tmp_path: Path):
    """Five random frames on disk, numbers 3 to 7, and the same as an array (5, 20, 30, 3)."""
    images = np.random.default_rng(0).integers(0, 256, (5, 20, 30, 3), dtype=np.uint8)
    for index, image in enumerate(images, start=3):
        write_image(frame_path(tmp_path, index), image)
    return tmp_path, images


def test_temporal_slice_is_one_row_of_each_frame(frames):
    """A slice holds the same row of consecutive frames, top to bottom, to the bit; a row that is
    not there is refused.
    """
    folder, images = frames
    np.testing.assert_array_equal(stacked_rows(folder, range(3, 8), 11), images[:, 11])
    for row in (-1, 20):
        with refused(ResultsError, "0..19"):
            stacked_rows(folder, range(3, 8), row)


def test_scene_point_draws_a_straight_line(tmp_path):
    """A wall that moves by three pixels per pose is shifted by three pixels from each line of the
    EPI to the next.
    """
    run = read_run(write_run(tmp_path / "run"))
    epi = stacked_rows(run.folder.path("truth"), range(6), 40)
    np.testing.assert_array_equal(epi[1:, :-3, 0], epi[:-1, 3:, 0])


def test_row_of_largest_change_is_found(tmp_path):
    """Of still frames the row that flickers is chosen, of flat ones the striped one; vertical steps
    do not count.
    """
    for index in range(4):
        image = np.full((16, 12, 3), 90, np.uint8)
        image[13] += 20 * (index % 2)
        write_image(frame_path(tmp_path, index), image)
    change = change_of_rows(tmp_path, range(4))
    assert change.argmax() == 13
    assert change[13] == 20
    assert not change_of_rows(tmp_path, range(1)).any()
    image = np.zeros((16, 12, 3), np.uint8)
    image[8:] = 255
    image[5, ::2] = 80
    assert most_textured_row([image, image]) == 5


def test_the_row_is_where_methods_differ_most(tmp_path):
    """What all methods get wrong alike is no difference: the row in which one alone fails is
    chosen, with a truth or without.
    """
    indices = range(2)
    folders = {label: tmp_path / label for label in ("truth", "a", "b")}
    for label, folder in folders.items():
        for index in indices:
            image = np.full((16, 12, 3), 90, np.uint8)
            image[3] += 0 if label == "truth" else 100
            image[11] += 20 if label == "b" else 0
            write_image(frame_path(folder, index), image)
    assert most_different_row(folders, indices) == 11
    assert most_different_row({label: folders[label] for label in "ab"}, indices) == 11
    assert most_different_row({"truth": folders["truth"], "a": folders["a"]}, indices) is None
    assert (
        most_different_row(
            {"truth": folders["truth"], "a": folders["a"], "b": folders["a"]}, indices
        )
        is None
    )


def test_every_method_stands_beside_the_truth(tmp_path):
    """Slices of a run hold the truth first, then each method under its shown name, each equal to
    its own frames.
    """
    run = read_run(write_run(tmp_path / "run"))
    slices = time_slices(run, "cam03", row=12)
    assert [strip.name for strip in slices.strips] == [
        "Truth",
        *(run.name(label) for label in run.labels),
    ]
    for strip, folder in zip(slices.strips, run.frame_folders("cam03").values(), strict=True):
        np.testing.assert_array_equal(
            strip.image, [read_image(frame_path(folder, index))[12] for index in run.frames]
        )


def test_a_moving_view_is_cut_where_it_moves_and_opens_the_page(tmp_path):
    """In the view and row of most motion methods differ visibly; a clip that stands still is cut
    where methods differ.
    """
    shape = RunShape(frames=Frames(0, 3), dataset="DyNeRF")

    def draw(label: str, view: str, index: int) -> np.ndarray:
        picture = np.full((shape.height, shape.width, 3), 90, np.uint8)
        picture[17] += 30 * index if view == "cam03" else 0
        picture[5] += 40 if label == LABELS[0] else 0
        return picture

    run = read_run(write_run(tmp_path / "run", shape, draw))
    assert [time_slices(run, view).row for view in ("cam00", "cam03")] == [5, 17]
    content = slices_section(Report(read_groups([tmp_path / "run"])))
    ((key, values),) = content.values.items()
    assert values["opening_view"] == "cam03"
    assert content.data[key] == {"row": 17}


def test_virtual_path_has_no_truth(tmp_path):
    """Without a captured path the place of the truth is kept and empty, and the row is the one in
    which methods differ.
    """
    slices = path_slices(read_run(write_run(tmp_path / "run", RunShape(path_truth=False))))
    assert slices is not None
    assert [strip.image is None for strip in slices.strips] == [True, False, False, False]
    assert "methods differ" in slices.chosen_by


def test_missing_pose_is_named(tmp_path):
    """A gap in a path, which names method and pose, an unknown view and a strange suffix are errors
    that say what to do.
    """
    run = read_run(write_run(tmp_path / "run"))
    frame_path(run.folder.path("ours-geometric"), 4).unlink()
    with refused(RenderError, "GGVS (online), geometric weights", "lacks 4"):
        path_slices(run)
    with refused(ResultsError, "'cam99'", "cam00, cam03"):
        write_figure(run.folder.root, "time", tmp_path / "slice.png", view="cam99")
    with refused(ResultsError, ".png, .pdf, .svg", ".bmp"):
        write_figure(run.folder.root, "time", tmp_path / "slice.bmp")


def test_single_frame_has_a_slice_of_one_sample(tmp_path):
    """One frame is a slice of height one; of one method its row is the middle one, because nothing
    changes.
    """
    run = read_run(
        write_run(
            tmp_path / "run",
            RunShape(frames=Frames(0, 1), metrics=("PSNR",), labels=("ours-geometric",)),
        )
    )
    slices = time_slices(run, "cam00")
    assert slices.row == 24
    assert {strip.image.shape for strip in slices.strips} == {(1, 64, 3)}
