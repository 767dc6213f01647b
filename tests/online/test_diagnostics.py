"""What our method decides on the way to a frame: its maps, their pictures in a run, and those in
the page.
"""

import dataclasses

import numpy as np
import pytest

from ggvs_eval.files.images import read_image
from ggvs_eval.pipelines.online.blend_network import SURE
from ggvs_eval.pipelines.online.network_blender import composed, filled_picture, view_shares
from ggvs_eval.pipelines.online.network_inputs import blend_maps
from ggvs_eval.pipelines.run.evaluate import evaluate
from ggvs_eval.pipelines.run.render import VIEW_COLOURS, view_colours
from ggvs_eval.reports.model.measured import read_run
from ggvs_eval.reports.page.pictures import MEANINGS, compare_frames
from ggvs_eval.run_folder import DIAGNOSTICS, RunFolder, diagnostics_path
from helpers.blender_inputs import inputs_of
from helpers.scenes import camera_at, instant
from helpers.small_runs import small_protocol, write_small_capture

pytestmark = pytest.mark.usefixtures("no_figures")

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.3)]
LABELS = ("no-blending", "ours", "ours+no-tsdf", "ours-geometric")


@pytest.fixture(scope="module")
def reported_run(tmp_path_factory) -> RunFolder:
    """Two frames in two views and two poses, rendered, scored and reported."""
    root = tmp_path_factory.mktemp("inside")
    capture = write_small_capture(root / "capture", 2)
    evaluate(root / "run", capture, small_protocol(2, 2, ("PSNR",)), LABELS, workers=1)
    return RunFolder(root / "run")


def test_shares_are_those_of_the_composed_picture():
    """Eqs. 4-5 at the network's own size: the views by their shares and the background by the rest
    are the composed picture.
    """
    maps = blend_maps(inputs_of(instant(0, TARGET, SOURCES)), "registered")
    views = len(maps.sources)
    small = (
        np.random.default_rng(0)
        .uniform(0, 1, (views + 4, TARGET.height, TARGET.width))
        .astype(np.float32)
    )
    small[:views] /= small[:views].sum(axis=0)
    small[views + 1 :] = 0
    background = filled_picture(maps)
    shares = view_shares(small, maps)
    mixed = np.einsum("khw,khwc->hwc", shares, maps.colours)
    foreground = small[:views] * maps.coverage
    shown = foreground.sum(axis=0) > 0  # 0 where no view has weight
    unseen = np.clip(maps.unseen(), SURE, 1 - SURE)
    weight = 1 / (1 + np.exp(-(small[views] + np.log(unseen / (1 - unseen)))))
    np.testing.assert_allclose(shares.sum(axis=0), (1 - weight) * shown, atol=1e-5)
    expected = composed(maps, maps.unseen(), background, small, 1).picture
    np.testing.assert_allclose(
        mixed + weight[..., None] * background, np.moveaxis(expected, 0, 2), atol=1e-4
    )


def test_one_view_alone_shows_its_colour():
    """All weight on one view is its colour, half of it half as bright, none is black; an eighth
    view has the first one's.
    """
    weights = np.zeros((8, 1, 4), np.float32)
    weights[2, 0, 0], weights[2, 0, 1], weights[7, 0, 3] = 1, 0.5, 1
    drawn = view_colours(weights)[0]
    np.testing.assert_array_equal(drawn[0], VIEW_COLOURS[2])
    np.testing.assert_allclose(drawn[1], VIEW_COLOURS[2] / 2, atol=0.5)
    np.testing.assert_array_equal(drawn[2:], [[0, 0, 0], VIEW_COLOURS[0]])


@pytest.mark.slow
@pytest.mark.parametrize(
    ("label", "names"),
    [
        ("ours", {"depth", "weights", "coverage", "motion"}),
        ("ours+no-tsdf", {"weights", "coverage", "motion"}),
        ("ours-geometric", {"depth", "coverage", "motion"}),
        ("no-blending", set()),
    ],
)
def test_a_job_writes_what_its_method_tells(reported_run, label, names):
    """Each map of each frame, at a quarter of the size, in views and along the path; methods that
    tell nothing have no folder.
    """
    for frames in (reported_run.renders(label, "cam00"), reported_run.path(label)):
        inside = frames / DIAGNOSTICS
        assert (
            {folder.name for folder in inside.iterdir()} == names if names else not inside.exists()
        )
        for name in names:
            assert read_image(diagnostics_path(frames, name, 1)).shape == (12, 16, 3)


@pytest.mark.slow
def test_the_page_can_choose_them(reported_run):
    """The maps of ours, not of its variants, stand beside the frames of every view, named and
    explained; they have no errors.
    """
    measured = read_run(reported_run.root)
    shown = compare_frames(measured)
    inside = [f"ours/{name}" for name in MEANINGS]
    assert list(shown.keys) == ["truth", *LABELS, *inside]
    assert shown.names[-4:] == tuple(
        f"GGVS (online): {name}" for name in ("depth", "weights", "coverage", "motion")
    )
    for view in shown.views:
        assert [len(shown.images[view][key]) for key in inside] == [2] * 4
        assert set(shown.errors[view]) == set(LABELS)
    page = (reported_run.report / "index.html").read_text(encoding="utf-8")
    for key in inside:
        assert f'<option value="{key}"' in page
    assert "Intermediate results of GGVS" in page


@pytest.mark.slow
def test_a_run_without_them_has_the_methods_alone(reported_run):
    """Renders of an earlier version, or of others, tell nothing: the page shows their frames."""
    measured = read_run(reported_run.root)
    others = dataclasses.replace(measured, labels=("no-blending",))
    assert compare_frames(others).keys == ("truth", "no-blending")
