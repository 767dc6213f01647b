"""View interpolation: exact on a plane, what counts as between, and a run in which it cannot show
every view.
"""

from dataclasses import replace

import cv2
import numpy as np
import pandas as pd
import pytest

from ggvs_eval.baselines.view_interpolation import ViewInterpolation, choose_pair
from ggvs_eval.errors import ViewRefusedError
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.run.evaluate import evaluate
from ggvs_eval.protocol import Synthesis, Views
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.results import Results
from ggvs_eval.run_folder import JOB_FILE, RunFolder, read_json
from helpers.photographs import psnr_db
from helpers.run_folders import write_run
from helpers.scenes import camera_at, look
from helpers.seeded_baselines import turned
from helpers.small_runs import small_protocol, write_small_capture

WIDTH, HEIGHT = 192, 144
BARE_WALL = 9.0  # where the square is out of sight


def wall_seen_by(target, cameras, square_x=BARE_WALL):
    """An instant of the wall, and the truth of the target."""
    views = tuple(
        SourceView(camera, image, depth, np.ones_like(depth))
        for camera in cameras
        for image, depth in [look(camera, square_x)]
    )
    return Instant(0, target, views, units_per_metre=2.5), look(target, square_x)[0] / 255


def at(x, y=0.0, width=WIDTH, height=HEIGHT):
    return camera_at(x, y, width=width, height=height)


@pytest.mark.parametrize("x", [-0.15, -0.1, 0.0, 0.11])
def test_a_plane_is_shown_exactly(x):
    """Before a wall the parallax is one number: the view between two cameras is the wall's own,
    wherever it lies between.
    """
    instant, truth = wall_seen_by(at(x), [at(-0.15), at(0.2)])
    assert psnr_db(ViewInterpolation().step(instant).image, truth) > 48


def test_cameras_may_look_elsewhere_through_other_lenses():
    """What direction, lens and size of the sources do to their images is undone before flow is
    searched.
    """
    longer = at(0.2, width=240, height=160)
    K = longer.K.copy()
    K[:2, :2] *= 1.2
    sources = [turned(at(-0.15), 0.05), turned(replace(longer, K=K), -0.04)]
    instant, truth = wall_seen_by(turned(at(0.0), 0.01), sources)
    image = ViewInterpolation().step(instant).image
    assert image.shape == (HEIGHT, WIDTH, 3)
    assert psnr_db(image[10:-10, 20:-20], truth[10:-10, 20:-20]) > 40


def test_what_stands_before_the_wall_moves_more():
    """With a square before the wall it is far ahead of the mean of both images, and of either of
    them.
    """
    instant, truth = wall_seen_by(at(0.0), [at(-0.15), at(0.2)], square_x=0.0)
    image = ViewInterpolation().step(instant).image
    images = [source.image / 255 for source in instant.sources]
    assert psnr_db(image, truth) > 36
    assert psnr_db(image, truth) > 12 + max(
        psnr_db(other, truth) for other in (*images, np.mean(images, axis=0))
    )


@pytest.mark.parametrize(
    ("cameras", "pair"),
    [
        ([at(-0.1), at(0.3)], (0, 1)),
        ([at(0.05), at(0.1), at(-0.3)], (0, 2)),  # both of the nearest two stand on one side
        ([at(-0.3), at(0.1), at(-0.1)], (1, 2)),  # the nearest pair that it lies between
        ([at(-0.1, 0.07), at(0.3, 0.07)], (0, 1)),  # a row that is not quite straight
        ([at(-0.1), at(-0.1), at(0.3)], (0, 2)),
        ([at(0.0), at(0.3)], (0, 1)),  # where a camera stands
    ],
)
def test_between_is_on_the_way_from_one_camera_to_another(cameras, pair):
    """The nearest pair is taken whose line passes the target within a fifth of its length, between
    its ends.
    """
    first, second, share = choose_pair(at(0.0), cameras)
    assert (first, second) == pair
    a, b = cameras[first].centre[0], cameras[second].centre[0]
    assert share == pytest.approx(-a / (b - a), abs=1e-6)


@pytest.mark.parametrize(
    "cameras",
    [
        [at(0.1), at(0.3)],  # beyond the end of the row
        [at(-0.1, 0.1), at(0.3, 0.1)],  # another row
        [at(0.0, 0.0), at(0.0, 0.0)],  # one place
        [turned(at(-0.1), 0.9), at(0.3)],  # looks away
        [at(0.1)],
    ],
)
def test_a_target_between_no_two_cameras_is_refused(cameras):
    """Beyond the end, beside the row, or where a source looks away: refused by what is wanted."""
    with pytest.raises(ViewRefusedError, match="wanted a target between two cameras"):
        ViewInterpolation().step(wall_seen_by(at(0.0), cameras)[0])


def test_equal_bits_whatever_the_threads_and_the_order():
    """The number of OpenCV's threads moves no bit and is left as it was; neither does the order of
    the sources.
    """
    instant, _ = wall_seen_by(at(0.0), [at(-0.15), at(0.2)], square_x=0.0)
    before = cv2.getNumThreads()
    pictures = []
    try:
        for threads in (1, 4):
            cv2.setNumThreads(threads)
            pictures.append(ViewInterpolation().step(instant).image)
            assert cv2.getNumThreads() == threads
    finally:
        cv2.setNumThreads(before)
    np.testing.assert_array_equal(*pictures)
    swapped = ViewInterpolation().step(replace(instant, sources=instant.sources[::-1])).image
    np.testing.assert_allclose(swapped, pictures[0], atol=1e-5)


@pytest.mark.slow
@pytest.mark.usefixtures("no_figures")
def test_a_view_at_the_end_of_the_row_has_a_cell_that_says_so(tmp_path):
    """In a run the views between cameras are rendered and scored; the others say why not.

    The run ends well, is not begun again, and its row says what it stands on.
    """
    capture = write_small_capture(tmp_path / "room", 2)
    protocol = replace(
        small_protocol(2, 0, ("PSNR", "L1")),
        views=Views(("cam04", "cam05"), "test"),
        synthesis=Synthesis(3),
    )
    page = evaluate(
        tmp_path / "run", capture, protocol, ["distance-based", "interpolation"], workers=1
    )
    run = RunFolder(tmp_path / "run")
    results = Results.read(run.root)
    reason = "wanted a target between two cameras, got one outside"
    refused = [
        view
        for view in protocol.views.test
        if read_json(run.renders("interpolation", view) / JOB_FILE).get("refused")
    ]
    mine = results.table[results.table["method"] == "interpolation"]
    assert refused == ["cam05"]
    assert set(mine["view"]) == {"cam04"}
    assert results.why_absent("PSNR", "interpolation", "cam05") == reason
    assert reason in results.provenance["partial"]["interpolation"]
    tables = pd.read_csv(page.parent / "tables.csv")
    cell = tables[
        (tables["method"].str.startswith("View Interpolation")) & (tables["column"] == "cam05")
    ]
    assert not cell.empty
    assert all(reason in note for note in cell["note"])
    made = (run.renders("interpolation", "cam05") / JOB_FILE).stat().st_mtime_ns
    evaluate(run.root, capture, protocol, ["distance-based", "interpolation"], workers=1)
    assert (run.renders("interpolation", "cam05") / JOB_FILE).stat().st_mtime_ns == made


@pytest.mark.slow
def test_a_path_that_was_refused_has_no_slice(tmp_path):
    """A method whose folder of the path holds no picture is left out of the epipolar plane images;
    the others stay.
    """
    run = read_run(write_run(tmp_path / "run"))
    label, *others = run.labels
    for picture in run.folder.path(label).glob("*.png"):
        picture.unlink()
    folders, poses = run.path_folders(run.labels)
    assert (set(folders), poses) == ({"truth", *others}, 6)
