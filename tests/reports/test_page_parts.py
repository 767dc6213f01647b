"""What the page carries for its scripts: values over view and frame, pictures along the path,
videos, the scripts themselves.
"""

import base64
import hashlib
import math
from dataclasses import replace
from io import BytesIO
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.files.images import read_image
from ggvs_eval.protocol import Frames
from ggvs_eval.reports.model.measured import MeasuredRun, read_run
from ggvs_eval.reports.page.heat_map import heat_colours, heat_maps
from ggvs_eval.reports.page.page import (
    FIRST_SCRIPTS,
    SCRIPTS,
    STILL_SCRIPTS,
    TEMPLATES,
    page_script,
    script_digest,
)
from ggvs_eval.reports.page.pictures import (
    FRAME_BYTES,
    PATH_BYTES,
    POSES_AT_MOST,
    VIDEO_FRAMES_AT_MOST,
    MethodVideo,
    compare_frames,
    fitting_width,
    method_videos,
    path_pictures,
    share_room,
)
from ggvs_eval.reports.report import write_report
from ggvs_eval.run_folder import frame_path
from helpers.page_reader import PageReader
from helpers.run_folders import LABELS, RunShape, write_run

SHAPE = RunShape(metrics=("PSNR", "L1", "TCC", "STED"))


@pytest.fixture(scope="module")
def measured_run(tmp_path_factory):
    """A scored run; nobody changes it."""
    return read_run(write_run(tmp_path_factory.mktemp("parts") / "run", SHAPE))


def test_heat_map_holds_the_results(measured_run):
    """Each cell is the value to five digits, on one scale over all methods, or None; STED, one
    value per sequence, has no map.
    """
    psnr, _, tcc = heat_maps(measured_run)
    table = measured_run.results.per_frame("PSNR", "cam03")
    for label in LABELS:
        method, _, variant = label.partition("+")
        np.testing.assert_allclose(psnr.values[label]["cam03"], table[(method, variant)], rtol=1e-4)
    values = [value for views in psnr.values.values() for row in views.values() for value in row]
    assert (psnr.low, psnr.high) == (min(values), max(values))
    assert tcc.values[LABELS[0]]["cam00"][0] is None
    assert None not in tcc.values[LABELS[0]]["cam00"][1:]
    assert [one.metric for one in heat_maps(measured_run)] == ["PSNR", "L1", "TCC"]


def test_infinite_values_are_no_colour(tmp_path):
    """A perfect frame (PSNR infinite) leaves its cell empty and the scale finite."""
    folder = write_run(tmp_path / "run", SHAPE)
    measured = read_run(folder)
    table = measured.results.table
    table.loc[table.index[table["metric"] == "PSNR"][0], "value"] = math.inf
    psnr = heat_maps(measured)[0]
    assert psnr.values[LABELS[0]]["cam00"][0] is None
    assert math.isfinite(psnr.high)


def test_heat_colours_brighten_steadily():
    """Luminance rises from the best to the worst colour, so the map reads the same without colour
    vision.
    """
    luminance = heat_colours()[0] @ np.array([0.2126, 0.7152, 0.0722])
    assert (np.diff(luminance) > -1.0).all()
    assert luminance[-1] > luminance[0] + 150


def test_path_pictures_hold_every_pose(measured_run, tmp_path):
    """A short path is carried whole, the truth first; a run without a path has none; a narrow
    budget makes it narrower.
    """
    pictures = path_pictures(measured_run)
    assert pictures.poses == tuple(range(SHAPE.poses))
    assert pictures.keys == ("truth", *LABELS)
    assert {len(images) for images in pictures.images.values()} == {SHAPE.poses}
    assert (
        path_pictures(read_run(write_run(tmp_path / "run", RunShape(poses=0, metrics=("PSNR",)))))
        is None
    )


@pytest.mark.slow
def test_path_pictures_are_bounded(tmp_path):
    """A long path is thinned out until its pictures stay below the bound, and they keep within
    their budget.
    """
    shape = RunShape(width=480, height=48, poses=150, views=("cam00",), metrics=("PSNR",))
    pictures = path_pictures(read_run(write_run(tmp_path / "run", shape)), 800_000)
    count = sum(len(images) for images in pictures.images.values())
    assert count <= POSES_AT_MOST
    assert pictures.poses[:2] == (0, 2)
    assert (
        sum(len(text) for images in pictures.images.values() for text in images) * 3 / 4
        <= 800_000 * 1.1
    )


def test_room_is_shared_by_what_there_is_to_show(measured_run, tmp_path):
    """A run with twice the frames gets twice the room; pictures along a path go to the run that has
    one; none is left over.
    """
    long = read_run(
        write_run(tmp_path / "long", RunShape(metrics=("PSNR",), frames=Frames(0, 8), poses=0))
    )
    first, second = share_room([measured_run, long])
    assert second.frames == pytest.approx(2 * first.frames, rel=0.01)
    assert second.videos == pytest.approx(2 * first.videos, rel=0.01)
    assert first.frames + second.frames == pytest.approx(FRAME_BYTES, rel=0.01)
    assert (first.path, second.path) == (PATH_BYTES, 0)
    assert path_pictures(long, second.path) is None


def test_fewer_frames_are_shown_rather_than_none_clearly(tmp_path):
    """Where all frames would be narrow, every so many-th is shown, wider, at least eight; with room
    all are shown whole.
    """
    shape = RunShape(
        width=480,
        height=48,
        frames=Frames(0, 24),
        views=("cam00",),
        labels=LABELS[:1],
        poses=0,
        metrics=("PSNR",),
    )
    run = read_run(write_run(tmp_path / "run", shape))
    whole, tight = compare_frames(run), compare_frames(run, 48 * 1500)
    assert (whole.stride, whole.width) == (1, 480)
    assert tight.stride > 1
    assert 8 <= len(tight.frames) == len(tight.images["cam00"]["truth"]) < 24
    assert tight.width > fitting_width([run_frame(run)], 1500)


def run_frame(run: MeasuredRun) -> np.ndarray:
    """One of its frames."""
    return read_image(frame_path(run.folder.renders(LABELS[0], "cam00"), 12))


def decode(video: MethodVideo) -> list[np.ndarray]:
    """Frames of a video as a page carries it, (H, W, 3) each."""
    import av

    with av.open(BytesIO(base64.b64decode(video.address.partition(",")[2]))) as container:
        return [frame.to_ndarray(format="rgb24").astype(int) for frame in container.decode(video=0)]


def test_video_shows_every_view_and_frame(measured_run):
    """The truth's video has all frames of the first view, then all of the second, in their
    order.
    """
    videos = method_videos(measured_run, 30.0)
    assert [video.name for video in videos] == ["Truth", *measured_run.names.values()]
    shown = decode(videos[0])
    assert len(shown) == 8
    assert (videos[0].width, videos[0].height) == (SHAPE.width, SHAPE.height)
    for index, picture in enumerate(shown):
        column = 4 + 3 * (2 + index % 4) + 6  # middle of the square that moves
        assert picture[16, column, 0] > 190
        assert abs(picture[16, column, 0] - picture[16, column, 1]) > 100


@pytest.mark.slow
def test_long_runs_give_short_videos(tmp_path):
    """Of a run longer than the bound the beginning of one view is shown; one frame gives no
    video.
    """
    shape = RunShape(
        frames=Frames(0, VIDEO_FRAMES_AT_MOST + 10),
        width=32,
        height=32,
        poses=0,
        labels=LABELS[:1],
        metrics=("PSNR",),
    )
    videos = method_videos(read_run(write_run(tmp_path / "long", shape)), 0.0)
    assert videos[0].views == ("cam00",)
    assert len(decode(videos[0])) == VIDEO_FRAMES_AT_MOST
    single = RunShape(frames=Frames(0, 1), metrics=("PSNR",))
    assert method_videos(read_run(write_run(tmp_path / "single", single)), 30.0) == ()


@pytest.mark.slow
def test_every_script_is_in_the_page(measured_run, tmp_path):
    """All JavaScript files among the templates are inlined, in full, under a policy that allows
    exactly these two scripts.
    """
    used = {*FIRST_SCRIPTS, *SCRIPTS, *STILL_SCRIPTS}
    assert {f"{name}.js" for name in used} == {file.name for file in TEMPLATES.glob("*.js")}
    scripts = [page_script(FIRST_SCRIPTS), page_script()]
    page = write_report([Path(measured_run.folder.root)], tmp_path / "report", with_figures=False)
    text = page.read_text(encoding="utf-8")
    assert [one for one in PageReader(text).texts if one.startswith('"use strict"')] == [
        one.strip() for one in scripts
    ]
    files = [TEMPLATES / f"{name}.js" for name in (*FIRST_SCRIPTS, *SCRIPTS)]
    assert all(file.read_text(encoding="utf-8").strip() in "".join(scripts) for file in files)
    digests = [
        base64.b64encode(hashlib.sha256(script.encode()).digest()).decode() for script in scripts
    ]
    assert [script_digest(script) for script in scripts] == digests
    assert f"script-src 'sha256-{digests[0]}' 'sha256-{digests[1]}';" in text


def test_the_viewer_opens_with_ours(measured_run):
    """Beside the truth stands the method itself, not a variant listed before it; without ours, the
    first with pictures.
    """
    mixed = replace(
        measured_run,
        labels=("no-blending", "ours+no-tsdf", "ours"),
        ours=frozenset({"ours", "ours+no-tsdf"}),
    )
    assert mixed.ours_first == ("ours", "ours+no-tsdf", "no-blending")
    assert replace(measured_run, labels=("mine",), ours=frozenset()).ours_first == ("mine",)
    assert replace(measured_run, labels=()).ours_first == ()
