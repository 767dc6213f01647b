"""A fault of handling undone gives back the score of the unspoilt frames; where nothing was wrong
nothing is gained.
"""

import json
from collections.abc import Callable, Mapping

import cv2
import numpy as np
import pytest

from ggvs_eval.contrib.what_if.what_if import HONEST, WhatIf, what_if, what_if_text
from ggvs_eval.errors import MetricError, RenderError
from ggvs_eval.files.images import round_levels
from ggvs_eval.metrics import score_view
from ggvs_eval.pipelines.commands.main import run_command
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.protocol import Frames, Measurement
from ggvs_eval.transforms import TRANSFORMS
from helpers.planted_renders import (
    Spoil,
    change,
    each_picture,
    film_without_noise,
    moved,
    reversed_time,
    zoomed,
)
from helpers.refusals import refused
from helpers.run_folders import RunShape, write_run

SIZE = 128, 96  # the middle of the pictures
N_FRAMES = 12
FRAMES = range(N_FRAMES)
ROUNDING = 1e-9  # of means: the frames are equal
AS_IS = Measurement()
Renders = dict[str, np.ndarray]


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> Renders:
    """What two of four cameras see without noise, each (T, H, W, 3)."""
    filmed = film_without_noise(tmp_path_factory.mktemp("what_if") / "demo", N_FRAMES)
    return {
        name: filmed[name][:, 24 : 24 + SIZE[1], 32 : 32 + SIZE[0]] for name in list(filmed)[:2]
    }


@pytest.fixture(scope="module")
def truth(filmed) -> Renders:
    """Captured frames: what the cameras see, with their noise."""
    rng = np.random.default_rng(8)
    return {
        name: round_levels(frames + rng.normal(0, 1.5, frames.shape))
        for name, frames in filmed.items()
    }


@pytest.fixture(scope="module")
def soft(filmed) -> Renders:
    """Renders of a method that blurs, and has noise of its own."""
    rng = np.random.default_rng(3)
    blurred = {
        name: np.stack([cv2.GaussianBlur(f, (0, 0), 1.2) for f in frames])
        for name, frames in filmed.items()
    }
    return {
        name: round_levels(frames + rng.normal(0, 1, frames.shape))
        for name, frames in blurred.items()
    }


def views_of(
    rendered: Mapping[str, np.ndarray], truth: Renders, spoil: Spoil = lambda view: view.rendered
) -> dict[str, ViewFrames]:
    views = {
        name: ViewFrames(frames.__getitem__, truth[name].__getitem__, FRAMES)
        for name, frames in rendered.items()
    }
    return {name: ViewFrames(spoil(view), view.truth, FRAMES) for name, view in views.items()}


def late(view: ViewFrames) -> Callable[[int], np.ndarray]:
    return lambda index: view.rendered(max(index - 1, 0))


def examined(views: dict[str, ViewFrames], metrics: tuple[str, ...] = ("PSNR",)) -> WhatIf:
    return what_if(views, {}, AS_IS, metrics)


def unspoilt(rendered: Renders, truth: Renders, found: WhatIf, metric: str = "PSNR") -> float:
    """Score of the frames before they were spoilt, on the same instants and within the same
    border.
    """
    inner = (
        slice(found.border_px, SIZE[1] - found.border_px),
        slice(found.border_px, SIZE[0] - found.border_px),
    )
    scored = [
        score_view(
            [(rendered[name][i][inner], truth[name][i][inner]) for i in found.scored_on], [metric]
        ).values
        for name in truth
    ]
    return float(np.mean([np.mean([value for _, _, value in values]) for values in scored]))


def faults(found: WhatIf) -> list[str]:
    return list(dict.fromkeys(fault for row in found.rows for fault in row.faults))


PLANTED: dict[str, tuple[str, Spoil, float]] = {
    "shift (.4, .2)": ("shift", each_picture(moved(0.4, 0.2)), 0.1),
    "focal length + 1 %": ("focal length", each_picture(zoomed(1.01)), 0.2),
    "gain 1.06": ("gain", each_picture(change("gain", gain=1.06)), 0.1),
    "gamma 1.2": ("tone curve", each_picture(change("tone curve", power=1.2)), 0.1),
    "studio range": ("value range", each_picture(change("value range", slope=0.86)), 0.1),
    "one frame late": ("frame offset", late, 0),
    "last frame first": ("reversed time", reversed_time, 0),
    "BGR": ("channel order", each_picture(lambda image: image[..., ::-1]), 0),
    "GBR": ("channel order", each_picture(lambda image: image[..., [1, 2, 0]]), 0),
    "upside down": ("mirrored", each_picture(lambda image: image[::-1]), 0),
    "one pixel": ("shift", each_picture(moved(1, 0)), 0),
}


QUICK = ("gain 1.06", "one frame late", "GBR")


@pytest.mark.parametrize(
    "planted",
    [name if name in QUICK else pytest.param(name, marks=pytest.mark.proof) for name in PLANTED],
)
def test_a_fault_undone_gives_back_the_score(planted, soft, truth):
    """The row of the fault has the unspoilt score, bit for bit where nothing is interpolated, and
    the gain is beyond doubt.
    """
    fault, spoil, most_db = PLANTED[planted]
    found = examined(views_of(soft, truth, spoil))
    honest, mended = found.rows[0], found.rows[1]
    wanted = unspoilt(soft, truth, found)

    assert faults(found) == [fault]
    assert honest.words == HONEST
    assert not set(found.estimated_on) & set(found.scored_on)
    score = mended.scores["PSNR"]
    assert score.value == pytest.approx(wanted, abs=most_db or ROUNDING)
    assert score.low - ROUNDING <= wanted <= score.high + ROUNDING
    assert (score.low == score.high) == (most_db == 0)
    assert score.value > honest.scores["PSNR"].value


def test_flicker_is_undone_frame_by_frame(soft, truth):
    """Gains that jump are taken back by each frame's own truth; the score is that of the steady
    frames.
    """
    gains = np.where(np.arange(N_FRAMES) % 2, 1.04, 0.96)
    flickering: Spoil = lambda view: lambda index: round_levels(view.rendered(index) * gains[index])  # noqa: E731
    found = examined(views_of(soft, truth, flickering))
    assert faults(found) == ["flicker"]
    assert found.rows[1].scores["PSNR"].value == pytest.approx(
        unspoilt(soft, truth, found), abs=0.05
    )
    assert found.rows[1].scores["PSNR"].value > found.rows[0].scores["PSNR"].value + 0.2


def test_several_faults_have_a_row_each_and_one_together(soft, truth):
    """Only all of them together give back the score; each alone is shown, too."""
    both = lambda view: late(  # noqa: E731
        ViewFrames(each_picture(lambda image: image[..., ::-1])(view), view.truth, FRAMES)
    )
    found = examined(views_of(soft, truth, both))

    assert [row.faults for row in found.rows] == [
        (),
        ("frame offset",),
        ("channel order",),
        ("frame offset", "channel order"),
    ]
    assert found.best is found.rows[-1]
    assert found.rows[-1].scores["PSNR"].value == pytest.approx(
        unspoilt(soft, truth, found), abs=ROUNDING
    )


def test_a_fault_of_one_view_is_undone_there_alone(soft, truth):
    """The other views keep their frames, and the words say so."""
    name = next(iter(truth))
    views = views_of(soft, truth)
    found = examined(
        views
        | {
            name: views_of({name: soft[name]}, truth, each_picture(lambda image: image[..., ::-1]))[
                name
            ]
        }
    )

    assert found.rows[1].words == "channels read as BGR, in 1 of 2 views (certain)"
    assert found.rows[1].scores["PSNR"].value == pytest.approx(
        unspoilt(soft, truth, found), abs=ROUNDING
    )


def hazy(frames: np.ndarray, _: np.random.Generator) -> np.ndarray:
    return round_levels(0.85 * frames + 9)


def in_false_colours(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    # of each camera's own
    return round_levels(frames * np.roll((0.94, 1.0, 1.06), int(frames.mean())))


def grainy(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    return round_levels(frames + rng.normal(0, 6, frames.shape))


def by_wrong_depth(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    y, x = np.mgrid[: SIZE[1], : SIZE[0]].astype(np.float32)
    shifts = [
        cv2.resize(
            rng.normal(0, 1, (9, 12)).astype(np.float32), SIZE, interpolation=cv2.INTER_CUBIC
        )
        for _ in "xy"
    ]
    return np.stack(
        [
            cv2.remap(f, x + shifts[0] - shifts[0].mean(), y + shifts[1] - shifts[1].mean(), 1)
            for f in frames
        ]
    )


@pytest.mark.slow
@pytest.mark.parametrize("render", [hazy, in_false_colours, grainy, by_wrong_depth])
def test_honest_renders_have_no_row(render, soft, truth):
    """Haze, casts, noise and wrong depth are the method's own; one line says that nothing was
    found.
    """
    rng = np.random.default_rng(5)
    found = examined(views_of({name: render(frames, rng) for name, frames in soft.items()}, truth))

    assert found.rows == ()
    assert what_if_text("mine", found).startswith(
        "mine: nothing to undo in frames 3-8 of 2 views; no known fault"
    )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(2))
def test_noise_gains_nothing(seed, filmed, truth):
    """A gain fitted to noise is next to none, and a row of a shift that does not hold in the other
    frames gains under .02 dB.
    """
    rng = np.random.default_rng(seed)
    views = views_of({name: grainy(frames, rng) for name, frames in filmed.items()}, truth)
    found = examined(views)
    gains_db = [row.scores["PSNR"].value - found.rows[0].scores["PSNR"].value for row in found.rows]

    assert max(gains_db, default=0.0) < 0.02


def test_too_few_frames_and_metrics_of_whole_clips_are_refused(soft, truth):
    """Seven frames have no two halves that say anything; TCC, SDT and corrected colours are not of
    single frames.
    """
    short = {
        name: ViewFrames(view.rendered, view.truth, range(7))
        for name, view in views_of(soft, truth).items()
    }
    with refused(RenderError, "8 frames", "got 7"):
        examined(short)
    for metric in ("TCC", "SDT", "PSNR_cc", "PSNR_moving"):
        with refused(MetricError, "single frames", metric):
            examined(views_of(soft, truth), (metric,))


def moved_softly(x_px: float, y_px: float) -> Callable[[np.ndarray], np.ndarray]:
    """A shift by linear interpolation."""
    soft = TRANSFORMS["shift"]({"shift_x_px": x_px, "shift_y_px": y_px}, SIZE).soft
    assert soft
    return soft


TOGETHER: dict[str, tuple[Callable, ...]] = {
    "soft shift": (moved_softly(0.4, -1.3),),
    "soft shift, darker": (moved_softly(1.5, 0.5), change("gain", gain=0.85)),
    "scale, gamma": (zoomed(1.015), change("tone curve", power=1.4)),
    "stretched levels": (change("value range", slope=1.16),),
    "cast, upside down": (change("gain", gain=(0.9, 1.0, 1.1)), change("mirrored", axes=(0,))),
    "squeezed levels, BGR": (
        change("value range", slope=0.86),
        change("channel order", order=(2, 1, 0)),
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("planted", TOGETHER)
def test_the_interval_of_the_best_row_has_the_unspoilt_score(planted, soft, truth):
    """However the fault was interpolated, and of several faults; all of these are never worse than
    one.
    """
    rendered = soft
    for spoil in TOGETHER[planted]:
        rendered = {
            name: np.stack([spoil(frame) for frame in frames]) for name, frames in rendered.items()
        }
    found = what_if(views_of(rendered, truth), {}, AS_IS, ("PSNR", "SSIM"))

    assert len(found.best.faults) == len(TOGETHER[planted])
    for metric, score in found.best.scores.items():
        assert score.low <= unspoilt(soft, truth, found, metric) <= score.high


@pytest.mark.slow
def test_the_command_prints_rows_and_writes_them(tmp_path, soft, truth, capsys):
    """`ggvs-eval what-if RUN` prints each method's rows; the JSON file has the numbers, the run
    folder the label for its page.
    """
    spoil = each_picture(lambda image: image[..., ::-1])
    views = tuple(truth)
    shape = RunShape(
        views=views,
        frames=Frames(0, N_FRAMES),
        labels=("mine",),
        names=(("mine", "mine"),),
        width=SIZE[0],
        height=SIZE[1],
    )
    spoilt = views_of(soft, truth, spoil)

    def paint(label: str, view: str, index: int) -> np.ndarray:
        if view == "path":
            return truth[views[0]][0]
        return truth[view][index] if label == "truth" else spoilt[view].rendered(index)

    run = write_run(tmp_path / "run", shape, paint)
    before = {file: file.read_bytes() for file in run.rglob("*") if file.is_file()}
    run_command(
        ["what-if", str(run), "--metrics", "PSNR", "SSIM", "--out", str(tmp_path / "rows.json")]
    )
    printed = capsys.readouterr().out
    rows = json.loads((tmp_path / "rows.json").read_text(encoding="utf-8"))["mine"]["rows"]

    assert "channels read as BGR (certain)" in printed
    assert "as handed in" in printed
    assert [row["faults"] for row in rows] == [[], ["channel order"]]
    assert f"{rows[1]['scores']['PSNR']['value']:.2f} " in printed
    assert json.loads((run / "what_if.json").read_text(encoding="utf-8")) == ["mine"]
    assert {
        file: file.read_bytes()
        for file in run.rglob("*")
        if file.is_file() and file.name != "what_if.json"
    } == before
