"""Faults planted in imperfect renders of the demo are found, each as what it is; in honest renders
nothing is found.
"""

from collections.abc import Callable, Iterable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.files.images import read_image, resize, round_levels
from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.inspection.renders.border import find_border
from ggvs_eval.pipelines.inspection.renders.copied import find_copied
from ggvs_eval.pipelines.inspection.renders.examine import examine, explain_loss, faults_table
from ggvs_eval.pipelines.inspection.renders.identity import (
    ViewFrames,
    cameras_of_run,
    views_of_run,
    views_there,
)
from ggvs_eval.pipelines.inspection.renders.quick_checks import QuickChecks, doubt_numbering
from ggvs_eval.run_folder import RunFolder, frame_path
from helpers.planted_renders import PLANTED as PLANTED_IN_VIEWS
from helpers.planted_renders import SIZE, change, film_without_noise, jpeg, moved, zoomed
from helpers.refusals import refused
from helpers.run_folders import write_run

N_FRAMES = 9
VIEW, OTHER = "cam00", "cam03"


@pytest.fixture(scope="module")
def filmed(tmp_path_factory) -> dict[str, np.ndarray]:
    """What four cameras see without noise, each (T, H, W, 3): honest renders are made of it, and
    have none of the truth's.
    """
    return film_without_noise(tmp_path_factory.mktemp("doctor") / "demo", N_FRAMES)


@pytest.fixture(scope="module")
def truth(filmed) -> dict[str, np.ndarray]:
    """Captured frames: what the cameras see, with their noise."""
    rng = np.random.default_rng(8)
    return {
        name: round_levels(frames + rng.normal(0, 1.5, frames.shape))
        for name, frames in filmed.items()
    }


def blurred(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Soft, in false colours: 22 to 26 dB."""
    return np.stack(
        [round_levels(cv2.GaussianBlur(f, (0, 0), 1.8) * (0.92, 1.0, 1.08)) for f in frames]
    )


def noisy(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Grainy, darker and hazy."""
    soft = (cv2.GaussianBlur(f.astype(np.float32), (0, 0), 1.0) for f in frames)
    return np.stack([round_levels(0.85 * f + 9 + rng.normal(0, 4, f.shape)) for f in soft])


def warped(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Wrong depth: parts displaced by up to some pixels, doubled at edges, with holes, flickering,
    soft.
    """
    height, width = frames.shape[1:3]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    fields = [
        cv2.resize(
            rng.normal(0, 1.0, (9, 12)).astype(np.float32),
            (width, height),
            interpolation=cv2.INTER_CUBIC,
        )
        for _ in "1234"
    ]
    fields = [field - field.mean() for field in fields]
    holes = cv2.resize(rng.random((36, 48)).astype(np.float32), (width, height)) > 0.93
    rendered = []
    for frame in frames:
        one, other = (
            cv2.remap(frame, x + a, y + b, cv2.INTER_LINEAR).astype(np.float32)
            for a, b in (fields[:2], fields[2:])
        )
        image = cv2.GaussianBlur((0.6 * one + 0.4 * other) * rng.normal(1, 0.01), (0, 0), 0.7)
        image[holes] *= 0.1
        rendered.append(round_levels(image))
    return np.stack(rendered)


QUICK = {
    *(
        "GRB",
        "linear light",
        "upside down",
        "stretched",
        "repeated pixels",
        "JPEG 60",
        "quarter pixel left",
    ),
    *(
        "truth in every 6th frame",
        "blend with 20 % truth",
        "flicker, alternating +-3 %",
        "gamma 1.1",
        "stretched from 16-235",
    ),
    "reversed time",
}
HONEST = {render.__name__: render for render in (blurred, noisy, warped)}


@pytest.fixture(scope="module")
def honest(filmed) -> dict[str, dict[str, np.ndarray]]:
    """Kind -> camera -> imperfect renders; false colours are the other way round in every other
    camera.
    """
    orders = dict(zip(filmed, 2 * ([0, 1, 2], [2, 1, 0]), strict=True))
    return {
        kind: {
            name: render(filmed[name][..., order], np.random.default_rng(3))[..., order]
            for name, order in orders.items()
        }
        for kind, render in HONEST.items()
    }


def view_of(
    rendered: np.ndarray, captured: np.ndarray, frames: range = range(N_FRAMES)
) -> ViewFrames:
    return ViewFrames(
        lambda index: rendered[index], lambda index: captured[index], frames, range(len(captured))
    )


def diagnose(
    rendered: np.ndarray, truth: dict[str, np.ndarray], frames: range = range(N_FRAMES)
) -> list[Finding]:
    """Findings on renders that are said to be of VIEW."""
    cameras = {name: captured.__getitem__ for name, captured in truth.items()}
    return examine({VIEW: view_of(rendered, truth[VIEW], frames)}, cameras)


def faults(findings: list[Finding]) -> list[str]:
    return [finding.question for finding in findings]


def cropped(share_x: float, share_y: float) -> Callable[[np.ndarray], np.ndarray]:
    """The middle of the picture, stretched to the whole."""
    columns, rows = round(SIZE[0] * (1 - share_x) / 2), round(SIZE[1] * (1 - share_y) / 2)
    return lambda image: cv2.resize(
        np.ascontiguousarray(image[rows : SIZE[1] - rows, columns : SIZE[0] - columns]),
        SIZE,
        interpolation=cv2.INTER_AREA,
    )


def enlarged(factor: float, interpolation: int) -> Callable[[np.ndarray], np.ndarray]:
    small = round(SIZE[0] / factor), round(SIZE[1] / factor)
    return lambda image: cv2.resize(
        cv2.resize(image, small, interpolation=cv2.INTER_AREA), SIZE, interpolation=interpolation
    )


PLANTED = {
    "BGR": ("channel order", change("channel order", order=(2, 1, 0))),
    "GRB": ("channel order", change("channel order", order=(1, 0, 2))),
    "linear light": ("tone curve", change("tone curve", power=2.2)),
    "encoded twice": ("tone curve", change("tone curve", power=1 / 2.2)),
    "left and right": ("mirrored", change("mirrored", axes=(1,))),
    "upside down": ("mirrored", change("mirrored", axes=(0,))),
    "one pixel right": ("shift", moved(1, 0)),
    "one pixel up": ("shift", moved(0, -1)),
    "half a pixel": ("shift", moved(0.5, 0.5)),
    "stretched": ("wrong resize", cropped(0.8, 1)),
    "cropped": ("wrong resize", cropped(0.9, 0.9)),
    "enlarged 2 x": ("up-scaled", enlarged(2, cv2.INTER_LINEAR)),
    "enlarged 1.5 x": ("up-scaled", enlarged(1.5, cv2.INTER_LINEAR)),
    "repeated pixels": ("up-scaled", enlarged(2, cv2.INTER_NEAREST)),
    "JPEG 90": ("JPEG", jpeg(90)),
    "JPEG 60": ("JPEG", jpeg(60)),
}


@pytest.mark.slow
@pytest.mark.parametrize("kind", HONEST)
def test_honest_renders_have_no_finding(kind, honest, truth):
    """Blur, noise, casts, haze, wrong depth, ghosts, holes and flicker are no faults of
    handling.
    """
    views = {name: view_of(honest[kind][name], truth[name]) for name in truth}

    assert examine(views) == []


def quick_first(names: Iterable[str]) -> list:
    """Those that are not quick are proofs."""
    return [
        name if name in QUICK else pytest.param(name, marks=pytest.mark.proof) for name in names
    ]


@pytest.mark.parametrize("planted", quick_first(PLANTED))
def test_a_fault_of_every_picture_is_found_and_no_other(planted, honest, truth):
    """Each planted fault gives exactly one finding, of its kind."""
    fault, spoil = PLANTED[planted]
    kind = ("blurred", "warped")[list(PLANTED).index(planted) % 2]
    rendered = np.stack([spoil(image) for image in honest[kind][VIEW]])

    assert faults(diagnose(rendered, truth)) == [fault]


def soft(frames: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """A good rendering: a quarter of a pixel explains some of its error, and next to none of a bad
    one's.
    """
    return np.stack([round_levels(cv2.GaussianBlur(f, (0, 0), 1.0) * 1.02) for f in frames])


# Of a hazy picture no power law tells the gamma.
SHARP = ("focal length", "reversed time")


@pytest.mark.parametrize("planted", quick_first(PLANTED_IN_VIEWS))
def test_a_fault_of_a_clip_is_found_and_no_other(planted, honest, filmed, truth):
    """Truth in some frames or mixed into all, flicker, slight gamma, video range, small shifts and
    zooms, reversed time.
    """
    fault = PLANTED_IN_VIEWS[planted]
    rendered = honest["noisy" if fault.question in SHARP else "blurred"][VIEW]
    if fault.question == "shift":
        rendered = soft(filmed[VIEW], np.random.default_rng(3))
    view = view_of(rendered, truth[VIEW])
    findings = examine({VIEW: replace(view, rendered=fault.spoil(view))})

    assert set(faults(findings)) == {fault.question}


@pytest.mark.slow
def test_frames_that_are_copies_are_named(honest, truth):
    """The outliers are listed, bit by bit or written again as JPEG, and a copy that is one is
    certain.
    """
    rendered, captured = honest["warped"][VIEW], truth[VIEW]
    for recode in (lambda image: image, jpeg(90)):
        some = np.stack(
            [recode(captured[i]) if i in (2, 6) else rendered[i] for i in range(N_FRAMES)]
        )
        (finding,) = diagnose(some, truth)

        assert (finding.question, finding.verdict) == ("truth copied in", "certain")
        assert finding.measured.startswith("frames 2, 6 are as captured")


def test_the_share_of_the_truth_in_a_blend_is_measured(honest, truth):
    """Noise tells by how much the truth was blended in, within a few hundredths."""
    mixed = round_levels(0.7 * honest["warped"][VIEW] + 0.3 * truth[VIEW])
    (finding,) = diagnose(mixed, truth)

    assert (finding.question, finding.verdict) == ("truth copied in", "certain")
    assert finding.values["share"] == pytest.approx(0.3, abs=0.03)


@pytest.mark.parametrize("width", [48, 64, 96, pytest.param(120, marks=pytest.mark.slow)])
def test_a_small_picture_accuses_nobody(width, filmed, honest):
    """Scaled down, honest renders lose the errors that tell them from copies: unknown, no copy and
    no other instant.
    """
    height, small = round(width * SIZE[1] / SIZE[0]), {}
    for kind, frames in {
        "captured": filmed[VIEW],
        "warped": honest["warped"][VIEW],
        "nearly": filmed[OTHER],
    }.items():
        small[kind] = np.stack([resize(frame, width, height, "area") for frame in frames])
    noise = np.random.default_rng(8).normal(0, 0.4, small["captured"].shape)
    captured = round_levels(small["captured"] + noise)
    rows, columns = np.mgrid[:height, :width].astype(np.float32)
    for index, frame in enumerate(small["captured"]):
        across, down = (
            columns + 0.15 * np.sin(rows / 4 + index),
            rows + 0.15 * np.cos(columns / 5 + index),
        )
        small["nearly"][index] = cv2.remap(
            frame, across.astype(np.float32), down.astype(np.float32), cv2.INTER_LINEAR
        )
    for kind in ("warped", "nearly"):
        view = view_of(small[kind], captured)
        assert (
            QuickChecks(VIEW, view.truth, view.truth_range).check(view.rendered, view.frames) == []
        )
    if width < 64:
        assert [finding.verdict for finding in find_copied(VIEW, view)] == ["unknown"]


@pytest.mark.slow
def test_a_very_good_rendering_is_no_copy(filmed, truth):
    """What fits in every patch, but has noise of its own, is not accused."""
    rng = np.random.default_rng(2)
    assert (
        diagnose(round_levels(filmed[VIEW] + rng.normal(0, 0.5, filmed[VIEW].shape)), truth) == []
    )


@pytest.mark.slow
def test_a_drift_of_the_exposure_is_no_flicker(honest, truth):
    """A camera that grows 6 % brighter over the clip, which no method can know, is not a fault."""
    gains = np.linspace(0.97, 1.03, N_FRAMES)[:, None, None, None]

    assert diagnose(round_levels(honest["blurred"][VIEW] * gains), truth) == []


def test_video_range_is_certain_where_its_constants_are_met(honest, truth):
    """16 and 219 / 255 in each channel are no accident."""
    rendered = round_levels(16 + honest["blurred"][VIEW] * (219 / 255))
    (finding,) = diagnose(rendered, truth)

    assert (finding.question, finding.verdict) == ("value range", "certain")
    assert finding.values["intercept_255"] == pytest.approx(16, abs=1.5)


@pytest.mark.parametrize(("offset", "kind"), [(-2, "blurred"), (1, "warped")])
def test_a_frame_offset_is_found_with_its_sign(offset, kind, honest, truth):
    """Frame t that shows instant t + k is found with k."""
    rendered = np.roll(honest[kind][VIEW], -offset, axis=0)
    (finding,) = diagnose(rendered, truth, range(3, 7))

    assert finding.question == "frame offset"
    assert finding.values["offset_frames"] == offset
    flags = (
        f"--frames {N_FRAMES - abs(offset)}"
        if offset < 0
        else f"--start {offset} --frames {N_FRAMES - offset}"
    )
    assert f"by {offset:+d} and, as instant" in finding.advice
    assert f"mine.toml {flags})" in finding.advice
    assert doubt_numbering(finding, 0, 3) == finding == doubt_numbering(finding, -offset, 3)
    assert (
        f"protocol CAPTURE mine.toml --start {3 + offset}"
        in doubt_numbering(finding, offset, 3).advice
    )


@pytest.mark.slow
@pytest.mark.parametrize("kind", HONEST)
def test_the_wrong_camera_is_named(kind, honest, truth):
    """Renders of another camera under this one's name are found, and the camera with them."""
    (finding,) = diagnose(honest[kind][OTHER], truth)

    assert (finding.question, finding.verdict) == ("wrong camera", "certain")
    assert f"shows {OTHER}" in finding.measured


@pytest.mark.slow
def test_a_shift_that_single_views_leave_in_doubt_is_told_by_all(honest, truth):
    """Half a pixel in every view is found in each, also where wrong depth scatters the parts of the
    picture.
    """
    views = {
        name: view_of(np.stack([moved(0.5, 0.5)(image) for image in frames]), truth[name])
        for name, frames in honest["warped"].items()
    }

    assert [(one.subject, one.question) for one in examine(views)] == [
        (name, "shift") for name in truth
    ]


@pytest.mark.parametrize(
    ("shift", "kind"),
    [pytest.param((1, -2), "warped", marks=pytest.mark.slow), ((9, -6), "blurred")],
)
def test_a_shift_is_measured(shift, kind, honest, truth):
    """To a tenth of a pixel, and a crop that is off by many pixels is a shift, not another
    picture.
    """
    (finding,) = diagnose(np.stack([moved(*shift)(image) for image in honest[kind][VIEW]]), truth)

    assert finding.question == "shift"
    assert (finding.values["shift_x_px"], finding.values["shift_y_px"]) == pytest.approx(
        shift, abs=0.15
    )


def test_a_shift_that_explains_little_of_the_error_is_no_fault(honest, truth):
    """Honest baselines are moved by wrong depth, which costs next to nothing beside their other
    errors.
    """
    shifted = moved(0.25, 0)
    rendered = np.stack([shifted(image) for image in honest["noisy"][VIEW]])

    assert "shift" not in faults(examine({VIEW: view_of(rendered, truth[VIEW])}))


@pytest.mark.slow
def test_a_scale_is_measured(honest, truth):
    """To one per cent, across and down."""
    (scale,) = diagnose(
        np.stack([cropped(0.8, 1)(image) for image in honest["warped"][VIEW]]), truth
    )

    assert scale.values["scale_x"] == pytest.approx(1.25, abs=0.0125)
    assert scale.values["scale_y"] == pytest.approx(1, abs=0.0125)


@pytest.mark.slow
def test_the_truth_itself_is_found_out(truth):
    """Captured frames as renders are found bit by bit, and still after blur, noise or a codec."""
    captured = truth[VIEW]
    noise = np.random.default_rng(0).normal(0, 1, captured.shape)
    soft = np.stack([cv2.GaussianBlur(image, (0, 0), 0.6) for image in captured])

    (exact,) = diagnose(captured, truth)
    assert (exact.question, exact.verdict) == ("truth copied in", "certain")
    assert faults(diagnose(round_levels(captured + noise), truth)) == ["truth copied in"]
    assert faults(diagnose(soft, truth)) == ["truth copied in"]
    assert faults(diagnose(np.stack([jpeg(90)(image) for image in captured]), truth)) == [
        "truth copied in",
        "JPEG",
    ]


@pytest.mark.slow
def test_sensor_noise_in_the_rendering_is_certain_proof():
    """A rendering that carries the truth's own noise is found although it is blended with another
    picture.
    """
    rng = np.random.default_rng(1)
    scene, wrong = (
        cv2.resize(rng.uniform(60, 200, (9, 12, 3)), SIZE, interpolation=cv2.INTER_CUBIC)
        for _ in "12"
    )
    captured = np.stack([round_levels(scene + rng.normal(0, 3, scene.shape)) for _ in range(4)])
    mixed = round_levels(0.8 * captured + 0.2 * wrong)
    clean = round_levels(
        np.stack([0.8 * scene + 0.2 * wrong + rng.normal(0, 3, scene.shape) for _ in range(4)])
    )

    found, nothing = (
        examine({VIEW: view_of(rendered, captured, range(4))}) for rendered in (mixed, clean)
    )
    assert [(one.question, one.verdict) for one in found] == [("truth copied in", "certain")]
    assert nothing == []


@pytest.mark.parametrize("offset", [pytest.param(-2, marks=pytest.mark.slow), 1])
def test_frames_held_at_the_end_of_an_offset_are_no_fault_of_their_own(offset, honest, truth):
    """A late set repeats its first frame, an early one its last; a repeat elsewhere is
    still named.
    """
    held = honest["warped"][VIEW][np.clip(np.arange(N_FRAMES) + offset, 0, N_FRAMES - 1)]
    assert faults(diagnose(held, truth)) == ["frame offset"]


@pytest.mark.slow
def test_repeated_and_frozen_frames_are_listed(honest, truth):
    """Frames that repeat the one before are named; not where the truth repeats itself too."""
    repeated, captured = honest["warped"][VIEW].copy(), truth[VIEW].copy()
    repeated[[3, 6]] = repeated[[2, 5]]
    (finding,) = diagnose(repeated, truth)
    (once,) = diagnose(np.concatenate([repeated[:4], honest["warped"][VIEW][4:]]), truth)
    (frozen,) = diagnose(np.repeat(repeated[3:4], N_FRAMES, axis=0), truth)
    captured[[3, 6]] = captured[[2, 5]]

    assert finding.question == frozen.question == "repeated frames"
    assert "frames 3, 6 repeat the one before" in finding.measured
    assert "frame 3 repeats frame 2 while" in once.measured
    assert "all 9 frames show one instant" in frozen.measured
    assert examine({VIEW: view_of(repeated, captured)}) == []


def test_a_black_border_is_named_and_ragged_holes_are_not(honest, truth):
    """Lines that are black where the truth has a picture are a border with a straight edge; a
    method's holes end unevenly.
    """
    bordered = honest["blurred"][VIEW].copy()
    bordered[:, :6] = 0
    bordered[:, :, -4:] = 0
    (finding,) = find_border(VIEW, view_of(bordered, truth[VIEW]))
    assert finding.measured.endswith("4 px right, 6 px top")
    ragged = honest["blurred"][VIEW].copy()
    for row in range(ragged.shape[1]):
        ragged[:, row, : 4 + row % 9] = 0
    assert find_border(VIEW, view_of(ragged, truth[VIEW])) == []
    assert find_border(VIEW, view_of(honest["blurred"][VIEW], truth[VIEW])) == []


@pytest.mark.slow
def test_blank_frames_are_listed(honest, truth):
    """Black frames are named and the others still examined."""
    rendered = honest["blurred"][VIEW][..., ::-1].copy()
    rendered[[0, 7]] = 0
    blank, order = diagnose(rendered, truth)

    assert (blank.question, order.question) == ("blank frames", "channel order")
    assert "frames 0, 7 " in blank.measured
    assert faults(diagnose(np.zeros_like(rendered), truth)) == ["blank frames"]


@pytest.mark.slow
def test_renders_of_another_size_are_compared_all_the_same(honest, truth):
    """A wrong size is told, and does not hide a mirrored picture."""
    rendered = np.stack(
        [
            cv2.resize(image, (144, 108), interpolation=cv2.INTER_AREA)[:, ::-1]
            for image in honest["blurred"][VIEW]
        ]
    )
    size, mirrored = diagnose(rendered, truth)

    assert (size.question, mirrored.question) == ("wrong size", "mirrored")
    assert "144 x 108" in size.measured
    assert "192 x 144" in size.measured


@pytest.mark.slow
def test_two_faults_are_found_together(honest, truth):
    """Swapped channels do not hide an offset, nor the other way round; nor a wrong camera a missing
    gamma.
    """
    moved = np.roll(honest["warped"][VIEW], -2, axis=0)[..., ::-1]
    dark = change("tone curve", power=2.2)(honest["blurred"][OTHER])

    assert faults(diagnose(moved, truth, range(2, 7))) == ["frame offset", "channel order"]
    assert faults(diagnose(dark, truth)) == ["wrong camera", "tone curve"]


def test_one_frame_is_enough_for_what_one_frame_shows(honest, truth):
    """A single frame is examined without complaint."""
    image = honest["blurred"][VIEW][:1]

    assert diagnose(image, truth, range(1)) == []
    assert faults(diagnose(image[..., ::-1], truth, range(1))) == ["channel order"]


def test_a_view_without_frames_is_refused(truth):
    """Nothing to examine is an error, not health."""
    with pytest.raises(RenderError, match="without frames"):
        view_of(truth[VIEW], truth[VIEW], range(0))


def test_a_run_folder_is_read(tmp_path):
    """Views and cameras come from the run folder; a method that is not there and missing frames are
    refused.
    """
    run = RunFolder(write_run(tmp_path / "run"))
    views = views_of_run(run, "no-blending")

    assert list(views) == ["cam00", "cam03"]
    assert list(views["cam00"].frames) == [2, 3, 4, 5]
    np.testing.assert_array_equal(
        views["cam03"].truth(4), read_image(frame_path(run.truth("cam03"), 4))
    )
    assert sorted(cameras_of_run(run)) == ["cam00", "cam03"]
    with refused(RenderError, "'mine'", "no-blending"):
        views_of_run(run, "mine")
    frame_path(run.renders("no-blending", "cam03"), 4).unlink()
    with refused(RenderError, "no-blending in cam03", "lacks 4"):
        views_of_run(run, "no-blending")
    views, (gap,) = views_there(run, "no-blending")
    assert [list(view.frames) for view in views.values()] == [[2, 3, 4, 5], [2, 3]]
    assert (gap.subject, gap.question, gap.measured) == (
        "cam03",
        "missing frames",
        "lacks 4; only 2-3 examined",
    )


def test_frames_are_read_at_the_size_at_which_they_are_measured(tmp_path):
    """What a protocol measures at another size is recomputed at that size, and shown to the doctor
    as it lies there.
    """
    run = RunFolder(write_run(tmp_path / "run"))
    protocol = run.protocol()
    measurement = replace(protocol.measurement, width=32, height=24, resize_filter="area")
    run.protocol_file.write_text(replace(protocol, measurement=measurement).to_toml())

    plain, measured = (
        views_of_run(run, "no-blending", as_measured=each)["cam00"].rendered(2)
        for each in (False, True)
    )

    assert measured.shape == (24, 32, 3)
    np.testing.assert_array_equal(measured, resize(plain, 32, 24, "area"))


def test_the_table_fits_a_screen_and_joins_views():
    """Equal findings of several views share a line of at most 130 characters."""
    values, long = {"offset_frames": 1.0}, "frame t shows instant t+1 and " + "so on " * 30
    findings = [
        Finding(name, "frame offset", "certain", long, values, "renumber")
        for name in [f"cam{i:02d}" for i in range(12)]
    ]
    text = faults_table(findings)

    assert "cam06, cam07 and 4 more" in text
    assert max(map(len, text.splitlines())) <= 130


EXPOSURES = dict(zip(("cam00", "cam01", "cam02", "cam03"), (1.02, 0.98, 1.0, 1.03), strict=True))


@pytest.fixture(scope="module")
def exposed(honest) -> dict[str, np.ndarray]:
    """Camera -> renders of a rig whose cameras differ in exposure by 2 %."""
    return {name: round_levels(honest["warped"][name] * gain) for name, gain in EXPOSURES.items()}


def examine_all(
    renders: dict[str, np.ndarray], truth: dict[str, np.ndarray], *changes: Callable
) -> list[Finding]:
    """Findings on renders of all cameras after the same changes of every picture."""
    views = {name: view_of(frames, truth[name]) for name, frames in renders.items()}
    for spoil in changes:
        views = {name: view.with_rendered(spoil) for name, view in views.items()}
    return examine(views)


def drifting(step_px: tuple[int, int]) -> np.ndarray:
    """A patch that moves by a number of pixels from one frame to the next in front of a
    still wall.
    """
    rng = np.random.default_rng(7)
    wall, patch = (
        cv2.resize(rng.uniform(20, 230, (h, w, 3)), (8 * w, 8 * h)) for w, h in ((24, 18), (8, 8))
    )
    frames = np.repeat(wall[None], N_FRAMES, axis=0)
    for t, frame in enumerate(frames):
        x, y = 30 + step_px[0] * t, 20 + step_px[1] * t
        frame[y : y + 64, x : x + 64] = patch
    return frames


@pytest.mark.slow
def test_a_shift_by_the_way_of_an_instant_is_no_frame_offset():
    """What moves is where it is an instant later, what stands still is not: the pictures are
    shifted, for every check.
    """
    film = drifting((5, 3))
    truth, rendered = (
        round_levels(film + np.random.default_rng(seed).normal(0, 2, film.shape)) for seed in (1, 2)
    )
    shifted = view_of(rendered, truth).with_rendered(moved(5, 3))
    quick = QuickChecks(VIEW, shifted.truth, shifted.truth_range).check(
        shifted.rendered, shifted.frames
    )

    assert "shift" in faults(examine({VIEW: shifted}))
    assert "frame offset" not in faults([*examine({VIEW: shifted}), *quick])


@pytest.mark.slow
@pytest.mark.parametrize("gain", [0.7, 0.9, (0.88, 1.0, 1.1)])
def test_a_gain_of_all_views_is_found_on_cameras_that_differ(gain, exposed, truth):
    """Of all channels, or a cast, with its error."""
    findings = examine_all(exposed, truth, change("gain", gain=gain))

    assert faults(findings) == ["gain"] * len(truth)
    assert findings[0].values["gain"] == pytest.approx(
        np.broadcast_to(gain, 3), abs=findings[0].values["gain_error"]
    )


@pytest.mark.slow
def test_a_gain_of_shifted_pictures_is_found_and_cameras_that_differ_have_none(exposed, truth):
    """The shift is taken back first; exposures that differ by 2 % are no fault."""
    assert examine_all(exposed, truth) == []
    assert faults(examine_all(exposed, truth, moved(5, 3), change("gain", gain=1.06))) == [
        "shift",
        "gain",
    ] * len(truth)


@pytest.mark.slow
def test_a_slight_scale_is_one_of_all_views(filmed, truth):
    """0.4 %, which single views leave in doubt."""
    rng = np.random.default_rng(5)
    sharp = {
        name: round_levels(frames + rng.normal(0, 2, frames.shape))
        for name, frames in filmed.items()
    }
    scales = [
        finding
        for finding in examine_all(sharp, truth, zoomed(1.004))
        if finding.question == "focal length"
    ]

    assert [finding.subject for finding in scales] == list(truth)
    assert scales[0].values["scale_x"] == pytest.approx(1.004, abs=0.0015)


def test_a_psnr_that_no_fault_explains_is_no_all_clear(honest, truth):
    """Over white, where the truth is black; a rendering that is nearer than the instant before is a
    good one.
    """
    yy, xx = np.mgrid[: SIZE[1], : SIZE[0]]
    inside = ((np.hypot(xx - 96, yy - 72) < 40)[..., None],)
    matted = {
        name: view_of(
            np.where(inside, honest["noisy"][name], 255), np.where(inside, truth[name], 0)
        )
        for name in truth
    }
    good = {name: view_of(np.clip(truth[name], 3, 250), truth[name]) for name in truth}

    assert explain_loss(matted).startswith("no known fault explains the PSNR of 0.86 dB")
    assert explain_loss(good).startswith("no known fault found; PSNR 5")
