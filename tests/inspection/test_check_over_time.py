"""The check of a capture over its whole clip: faults that come after the first frame, their time,
and repairs with intervals.
"""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ggvs_eval.capture import Capture
from ggvs_eval.datasets.corrections import FILE, read_corrections
from ggvs_eval.errors import CaptureError
from ggvs_eval.files.video import write_video
from ggvs_eval.finding import Finding
from ggvs_eval.pipelines.commands.check import check as check_command
from ggvs_eval.pipelines.inspection.capture import check as check_module
from ggvs_eval.pipelines.inspection.capture.check import CaptureCheck, check_capture
from ggvs_eval.pipelines.inspection.capture.colour import (
    describe_repair,
    propose_corrections,
    repair_capture,
)
from ggvs_eval.pipelines.inspection.capture.records import CameraRecord, record_camera
from ggvs_eval.pipelines.offline.calibration.calibrate import CalibrationOptions, calibrate
from helpers.small_rig import N_FRAMES, NAMES, Frames, brighten, bump, expose, lose, warp

SHARED = CalibrationOptions(shared_intrinsics=True, max_features=1500)
Plant = Callable[[Frames], Frames]


def spoilt(filmed, plants: dict[str, Plant]) -> CaptureCheck:
    """The check of the rig with faults planted in some cameras."""
    return filmed.check(**{name: plant(filmed.frames[name]) for name, plant in plants.items()})


def minded(check: CaptureCheck) -> dict[tuple[str, str], Finding]:
    """What is warned of or bad, by question and subject; units are guessed in this rig."""
    found = [
        each
        for each in check.findings
        if each.verdict in ("warn", "bad") and each.question != "units"
    ]
    return {(each.question, each.subject): each for each in found}


@pytest.mark.slow
def test_a_bump_in_mid_clip_is_found_with_its_size_and_time(filmed):
    """6 px at frame 7: that camera alone, by 6 px, at frame 7; the last instant's epipolar error
    contradicts the poses too.
    """
    found = minded(spoilt(filmed, {"cam04": bump(-3.6, 4.8, 7)}))

    assert set(found) == {("stands still", "cam04"), ("epipolar error", "cam04")}
    still = found["stands still", "cam04"]
    assert still.verdict == "bad"
    assert still.values["moved_px"] == pytest.approx(6, abs=0.4)
    assert (still.values["right_px"], still.values["down_px"]) == pytest.approx(
        (-3.6, 4.8), abs=0.4
    )
    assert abs(still.values["first_frame"] - 7) <= 1
    assert still.values["last_frame"] - still.values["first_frame"] <= 1
    assert "(0.23 s)" in still.measured
    assert "at frame 0" in found["epipolar error", "cam04"].measured


@pytest.mark.slow
@pytest.mark.parametrize(("far", "at"), [(1.6, 15), pytest.param(70.0, 9, marks=pytest.mark.slow)])
def test_small_and_large_bumps_are_found(filmed, far, at):
    """A bump of a pixel and a half is found, and one so large that no corner can be followed."""
    still = minded(spoilt(filmed, {"cam02": bump(far, 0, at)}))["stands still", "cam02"]

    assert still.values["moved_px"] == pytest.approx(far, rel=0.2)
    assert still.values["first_frame"] - 1 <= at <= still.values["last_frame"] + 1


@pytest.mark.slow
def test_a_zoom_in_mid_clip_is_told_from_a_push(filmed):
    """Enlarged by 3 % from frame 12 on: said as a zoom."""

    def zoom(frames: Frames) -> Frames:
        return [*frames[:12], *(warp(frame, zoom=1.03) for frame in frames[12:])]

    still = minded(spoilt(filmed, {"cam01": zoom}))["stands still", "cam01"]
    assert still.values["zoom"] == pytest.approx(1.03, abs=0.003)
    assert "zoomed by x 1.03" in still.measured


@pytest.mark.proof
def test_a_rig_that_moves_as_a_whole_is_said_of_the_rig(filmed):
    """All cameras pushed at once have another cause than one tripod."""
    check = spoilt(filmed, dict.fromkeys(NAMES, bump(4, 0, 10)))

    (rig, *_) = check.of("stands still")
    assert rig.verdict == "warn"
    assert "6 of 6 cameras move" in rig.measured


@pytest.mark.slow
def test_an_exposure_that_grows_is_found_with_its_amount(filmed):
    """1.00 to 1.20 over the clip: bad, by 20 %, over most of the clip, and no constant gain is
    written for it.
    """
    check = spoilt(filmed, {"cam01": expose(1.2)})

    found = minded(check)
    assert {subject for _, subject in found} == {"cam01"}
    drift = found["colour over time", "cam01"]
    assert drift.verdict == "bad"
    assert np.expm1(drift.values["change"]) == pytest.approx(0.2, abs=0.02)
    assert drift.values["first_frame"] < N_FRAMES / 4
    assert drift.values["last_frame"] > 3 * N_FRAMES / 4
    assert propose_corrections(check.findings, {}) == {}


@pytest.mark.slow
def test_a_white_balance_that_jumps_is_found_with_its_time(filmed):
    """Red up and blue down by 6 % from frame 14 on."""

    def redden(frames: Frames) -> Frames:
        return [*frames[:14], *(brighten(frame, [1.06, 1, 0.94]) for frame in frames[14:])]

    drift = minded(spoilt(filmed, {"cam05": redden}))["colour over time", "cam05"]
    assert drift.values["part"] in ("red", "blue")
    assert abs(drift.values["first_frame"] - 14) <= 1


@pytest.mark.proof
def test_lamps_that_fade_for_all_are_no_fault_of_a_camera(filmed):
    """Half the light over the clip: nobody is minded, and the rig's line gives the change."""
    check = spoilt(filmed, dict.fromkeys(NAMES, expose(0.5)))

    assert minded(check) == {}
    assert check.of("colour over time")[0].values["common_change"] == pytest.approx(
        np.log(2), abs=0.15
    )


@pytest.mark.slow
def test_lamps_that_flicker_are_said_of_the_rig(filmed):
    """5 % up and down from frame to frame in all cameras: one warning, of the rig."""

    def flicker(frames: Frames) -> Frames:
        return [brighten(frame, 1 + 0.05 * (-1) ** number) for number, frame in enumerate(frames)]

    found = set(minded(spoilt(filmed, dict.fromkeys(NAMES, flicker))))
    assert {key for key in found if key[0] != "noise"} == {("colour over time", "rig")}


@pytest.mark.slow
def test_a_lost_frame_is_found_with_its_time_and_no_shift_is_proposed(filmed):
    """One frame missing at 12: lost there, in step before; the whole clip is not shifted, which
    would spoil its first half.
    """
    check = spoilt(filmed, {"cam04": lose(12)})

    found = minded(check)
    # The last frame comes twice, so that the count stays.
    assert set(found) == {("dropped frames", "cam04"), ("frozen frames", "cam04")}
    (step,) = found["dropped frames", "cam04"].values["steps"]
    assert step["frames"] == 1
    assert step["first_frame"] - 1 <= 12 <= step["last_frame"] + 1
    assert "from there on 1 frame ahead" in found["dropped frames", "cam04"].measured
    offset = next(each for each in check.of("time offset") if each.subject == "cam04")
    assert abs(offset.values["offset_frames"]) < 0.5
    assert propose_corrections(check.findings, {}) == {}


@pytest.fixture
def recalled(filmed, rig, monkeypatch) -> Path:
    """A rig on disk to damage; a check looks at the frames of cam02 alone, of the others it recalls
    what is recorded.
    """

    def recall(capture: Capture, _workers: int) -> list[CameraRecord]:
        return [
            record_camera(capture, old.name) if old.name == "cam02" else old
            for old in filmed.records
        ]

    monkeypatch.setattr(check_module, "record_cameras", recall)
    monkeypatch.chdir(rig.parent)
    return rig


@pytest.mark.slow
def test_a_gain_is_written_within_two_percent_and_said_before_and_after(filmed, recalled, capsys):
    """15 % brighter: that camera alone is corrected, with its gain before and after; a clean rig is
    left alone.
    """
    check_command(recalled, repair=True, jobs=1)
    assert not (recalled / FILE).exists()
    assert "corrections" not in capsys.readouterr().out

    write_video(
        recalled / "cam02.mp4",
        [brighten(frame, 1.15) for frame in filmed.frames["cam02"]],
        30.0,
        crf=6,
    )
    check_command(recalled, repair=True, jobs=1)
    corrections = read_corrections(recalled / FILE)
    assert set(corrections) == {"cam02"}
    assert corrections["cam02"].gain == pytest.approx([1.15] * 3, rel=0.02)
    assert corrections["cam02"].offset_frames == 0
    (line,) = [line for line in capsys.readouterr().out.splitlines() if " -> " in line]
    before, after = line.split(" -> ")
    assert before.startswith("cam02 colour gain: red x 1.1")
    assert after.startswith(("red x 0.99", "red x 1.00"))


def test_a_repair_stays_outside_of_its_interval():
    """A gain or an offset whose interval holds no fault is not written, however large it was
    measured.
    """

    def finding(question: str, verdict: str, **values: object) -> Finding:
        return Finding("cam01", question, verdict, "", values)  # type: ignore[arg-type]

    assert (
        propose_corrections(
            [finding("time offset", "bad", offset_frames=0.9, half_width_frames=0.6)], {}
        )
        == {}
    )
    assert (
        propose_corrections(
            [
                finding(
                    "time offset",
                    "bad",
                    offset_frames=1.9,
                    half_width_frames=0.2,
                    is_constant=False,
                )
            ],
            {},
        )
        == {}
    )
    (shifted,) = propose_corrections(
        [finding("time offset", "bad", offset_frames=1.9, half_width_frames=0.6)], {}
    ).values()
    assert shifted.offset_frames == 2
    assert describe_repair([], []) == []


def test_a_gain_measured_inside_its_error_is_not_a_warning():
    """Few matches that scatter: 4 % is measured, but the interval holds 1, and the finding is ok
    with both numbers.
    """
    from ggvs_eval.geometry.epipolar import MatchedPair
    from ggvs_eval.pipelines.inspection.capture.colour import check_gain

    rng = np.random.default_rng(4)
    pairs = []
    for first, second in ((0, 1), (1, 2), (0, 2)):
        uv = rng.uniform(0, 300, (24, 2))
        colours = rng.uniform(60, 150, (24, 3))
        other = colours * np.exp(rng.normal(0, 0.25, (24, 1)))
        pairs.append(
            MatchedPair(first, second, uv, uv, colours.astype(np.float32), other.astype(np.float32))
        )
    rig, *cameras = check_gain("abc", pairs)

    assert {each.verdict for each in (rig, *cameras)} == {"ok"}
    assert max(abs(value - 1) for each in cameras for value in each.values["measured_gain"]) > 0.03
    assert all(each.values["gain"] == [1.0, 1.0, 1.0] for each in cameras)


def write_table(folder: Path, frames: dict[str, Frames], n_frames: int = 1) -> Path:
    """Videos without poses."""
    for name in frames:
        write_video(folder / f"{name}.mp4", frames[name][:n_frames], 30.0, crf=6)
    return folder


@pytest.mark.proof
def test_a_shared_lens_that_fits_all_is_not_questioned(filmed, tmp_path):
    """Of a clean rig with poses by `calibrate` no camera's lens disagrees, and no gain is
    written.
    """
    found = calibrate(write_table(tmp_path / "table", filmed.frames, 14), tmp_path / "rig", SHARED)
    check = check_capture(tmp_path / "rig")

    assert found.odd_lenses == {}
    (rig, *_) = check.of("lens")
    assert (rig.verdict, rig.measured) == ("ok", "one for all cameras; 0 disagree")
    assert {finding.verdict for finding in check.of("colour gain")} == {"ok"}
    assert repair_capture(found.path, check.findings) == ""


@pytest.mark.proof
def test_one_zoom_under_a_shared_lens_is_named_and_can_be_freed(filmed, tmp_path):
    """8 %: that camera and no other, the factor within its interval; freed, the common focal length
    is right again.
    """
    table = write_table(
        tmp_path / "table", filmed.frames | {"cam02": [warp(filmed.frames["cam02"][0], zoom=1.08)]}
    )
    calibrated = calibrate(table, tmp_path / "rig", SHARED)

    assert set(calibrated.odd_lenses) == {"cam02"}
    lens = calibrated.odd_lenses["cam02"]
    assert lens.factor == pytest.approx(1.08, abs=max(lens.half_width, 0.01))
    (bad,) = [
        finding
        for finding in check_capture(tmp_path / "rig").of("lens")
        if finding.verdict == "bad"
    ]
    assert bad.subject == "cam02"
    assert "--own-lens cam02" in bad.advice

    freed = calibrate(table, tmp_path / "freed", replace(SHARED, own_lens=("cam02",)))
    truth = filmed.cameras[0].focal_px
    error, freed_error = (
        abs(found.cameras["cam00"].focal_px / truth - 1) for found in (calibrated, freed)
    )
    assert freed_error < min(0.03, error)
    assert freed.cameras["cam02"].focal_px / freed.cameras["cam00"].focal_px == pytest.approx(
        1.08, abs=0.01
    )
    assert freed.mean_reprojection_error_px < calibrated.mean_reprojection_error_px


@pytest.mark.slow
def test_own_lenses_want_a_shared_one_and_known_names(filmed, tmp_path):
    """Options that contradict each other, and a camera that is not there."""
    with pytest.raises(CaptureError, match="wanted shared intrinsics with --own-lens"):
        CalibrationOptions(own_lens=("cam02",))
    table = write_table(tmp_path / "table", filmed.frames)
    with pytest.raises(
        CaptureError, match="wanted cameras for --own-lens, got cam99; there are cam00"
    ):
        calibrate(
            table, tmp_path / "rig", CalibrationOptions(shared_intrinsics=True, own_lens=("cam99",))
        )
