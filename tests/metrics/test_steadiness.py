"""Steadiness without truth: mTV, second differences, depth videos, and the sharpness beside them;
closed forms and laws.
"""

import cv2
import numpy as np
import pytest

from ggvs_eval.errors import MetricError
from ggvs_eval.metrics.image.sharpness import sharpness
from ggvs_eval.metrics.registry import DEPTH_METRICS, METRICS, select_metrics
from ggvs_eval.metrics.series_scores import mean_values, score_depths, score_frames
from ggvs_eval.metrics.stream import score_view
from ggvs_eval.metrics.time.depth_variation import (
    depth_blinking,
    depth_mtv,
    depth_mtv2,
    depth_sharpness,
)
from ggvs_eval.metrics.time.temporal_variation import mtv, mtv2


def stripes(shift: int, period: int = 8, level: int = 51) -> np.ndarray:
    """Vertical stripes, half black and half `level` of 255, moved to the right."""
    bright = (np.arange(64) - shift) % period < period // 2
    return np.repeat(np.tile(bright * np.uint8(level), (32, 1))[..., None], 3, axis=-1)


def test_a_shifted_pattern_changes_by_its_edges():
    """Stripes of a fifth of white, a period of 8 px, moved by 1 px: 2 columns of 8 change
    by 20 %.
    """
    scores = mean_values(score_frames(stripes(shift) for shift in range(6)))

    assert scores["mTV"] == pytest.approx(20 * 2 / 8)
    # what changes at an edge changes once: it is in two second differences
    assert scores["mTV2"] == pytest.approx(20 * 4 / 8)
    # 15 edges between 64 columns, none between rows
    assert sharpness(stripes(0)) == pytest.approx(20 * 15 / 63 / 2)


def test_mtv_is_the_published_formula():
    """Frames in [0, 1]: the mean over a mask of the absolute difference along time, times 100;
    8-bit frames give the same.
    """
    frames = np.random.default_rng(0).integers(0, 256, (5, 20, 30, 3), dtype=np.uint8)
    mask = np.random.default_rng(1).random((20, 30)) < 0.5
    expected = 100 * np.abs(np.diff(frames / 255.0, axis=0))[:, mask].mean()
    second = 100 * np.abs(np.diff(frames / 255.0, n=2, axis=0))[:, mask].mean()

    for kind in (frames, frames / 255.0, (frames / 255.0).astype(np.float32)):
        scores = mean_values(score_frames(kind, mask))
        assert scores["mTV"] == pytest.approx(expected, rel=1e-5)
        assert scores["mTV2"] == pytest.approx(second, rel=1e-5)


def test_blur_and_a_frozen_video_win_mtv_and_only_blur_loses_sharpness():
    """Why a sharpness stands beside: the blurred video is steadier by mTV than the one it was made
    of.
    """
    texture = np.random.default_rng(0).integers(0, 256, (40, 80, 3), dtype=np.uint8)
    moving = [np.roll(texture, shift, axis=1) for shift in range(4)]
    blurred = [cv2.GaussianBlur(frame, (0, 0), 2) for frame in moving]
    true, smooth, frozen = (
        mean_values(score_frames(frames)) for frames in (moving, blurred, moving[:1] * 4)
    )

    for name in ("mTV", "mTV2"):
        assert frozen[name] == 0 < smooth[name] < true[name] / 3
    assert smooth["Sharpness"] < true["Sharpness"] / 3 < frozen["Sharpness"]


def test_boiling_depth_reads_as_its_strength():
    """Depth that changes by 1 % up and down: 1 % of change, 2 % of second difference; what is
    steady has none.
    """
    wall = np.tile(np.linspace(2, 4, 40, dtype=np.float32), (30, 1))
    boiling = [wall * np.float32(1.01 if index % 2 else 1) for index in range(6)]
    scores, steady = mean_values(score_depths(boiling)), mean_values(score_depths([wall] * 6))

    assert scores["depth_mTV"] == pytest.approx(100 * np.log(1.01), rel=1e-4)
    assert scores["depth_mTV2"] == pytest.approx(200 * np.log(1.01), rel=1e-4)
    assert scores["depth_Sharpness"] == pytest.approx(steady["depth_Sharpness"], rel=1e-4)
    assert steady["depth_mTV"] == steady["depth_mTV2"] == steady["depth_blinking"] == 0


def test_unknown_depth_has_no_vote_and_holes_that_come_and_go_are_counted():
    """A quarter of the map is unknown in every second frame: the rest alone is compared, and a
    quarter blinks.
    """
    whole = np.full((16, 16), 3.0, np.float32)
    holed = whole * np.float32(1.02)
    holed[:4] = 0
    holed[4, 0] = np.nan
    scores = mean_values(score_depths([whole, holed, whole]))

    assert scores["depth_mTV"] == pytest.approx(100 * np.log(1.02), rel=1e-4)
    assert scores["depth_blinking"] == pytest.approx(100 * 65 / 256)
    assert depth_blinking(np.zeros((8, 8)), np.zeros((8, 8))) == 0


def test_only_what_stands_still_counts_in_a_run():
    """A square moves, rightly, over a background that flickers by 5 levels: mTV is the flicker
    alone.
    """
    truth = np.full((6, 64, 96, 3), 100, np.uint8)
    for index, frame in enumerate(truth):
        frame[20:44, 10 * index : 10 * index + 24] = 220
    rendered = [frame + np.uint8(5) * (index % 2) for index, frame in enumerate(truth)]
    scores = score_view(zip(rendered, truth, strict=True), ["mTV", "mTV2"])

    values = {
        name: [value for metric, _, value in scores.values if metric == name]
        for name in ("mTV", "mTV2", "Sharpness")
    }
    assert values["mTV"] == pytest.approx([100 * 5 / 255] * 5)
    assert values["mTV2"] == pytest.approx([100 * 10 / 255] * 4)
    assert len(values["Sharpness"]) == 6


def test_what_is_told_without_truth_is_never_told_alone():
    """Every metric that blur improves names its sharpness, and asking for it gets both, next to
    each other.
    """
    assert {name for name, metric in {**METRICS, **DEPTH_METRICS}.items() if metric.beside} == {
        *(
            "mTV",
            "mTV2",
            "reprojection",
            "E_warp",
            "COLMAP_registered",
            "COLMAP_track_length",
            "COLMAP_matches",
        ),
        *("SGC_rotation", "SGC_translation"),
        *("depth_mTV", "depth_mTV2", "depth_blinking"),
    }
    assert [metric.name for metric in select_metrics(["E_warp", "PSNR", "mTV2"])] == [
        *("E_warp", "path_sharpness", "PSNR", "mTV2", "Sharpness"),
    ]
    assert [metric.name for metric in select_metrics(["Sharpness", "mTV"])] == ["Sharpness", "mTV"]


@pytest.mark.parametrize(
    ("call", "words"),
    [
        (
            lambda: mtv(np.zeros((9, 9, 3)), np.zeros((9, 8, 3))),
            r"one frame is \(9, 9, 3\) float64, another \(9, 8, 3\) float64",
        ),
        (lambda: mtv2([np.zeros((9, 9, 3))] * 2), "got 2 frames; needs 3"),
        (
            lambda: mtv(*np.zeros((2, 9, 9, 3), np.uint8), np.zeros((9, 9), bool)),
            "0 pixels; needs 64",
        ),
        (lambda: mtv(*np.full((2, 9, 9, 3), np.nan)), "not finite"),
        (lambda: sharpness(np.zeros((9, 9))), r"wanted RGB .* got \(9, 9\)"),
        (
            lambda: depth_mtv(-np.ones((9, 9)), np.ones((9, 9))),
            "wanted depth above 0, and 0 where it is unknown; got -1",
        ),
        (lambda: depth_mtv(np.ones((9, 9)), np.ones((9, 8))), "one depth map is"),
        (
            lambda: depth_mtv(np.zeros((9, 9)), np.ones((9, 9))),
            "0 pixels have a depth in all 2 frames",
        ),
        (lambda: depth_mtv2([np.ones((9, 9))]), "got 1 frames; needs 3"),
        (lambda: depth_sharpness(np.ones((9, 9, 3))), r"wanted depth maps \(height, width\)"),
        (lambda: depth_sharpness(np.zeros((9, 9))), "0 known pixels"),
        (lambda: score_frames([]), "no frames to score"),
        (
            lambda: select_metrics(["depth_mTV"]),
            "is of depth videos, a protocol is of frames.*steadiness --depth",
        ),
    ],
)
def test_what_cannot_be_measured_is_told(call, words):
    """Each refusal says what was wanted and what came."""
    with pytest.raises(MetricError, match=words):
        call()


def test_too_few_frames_leave_out_what_needs_more():
    """One frame has a sharpness and no change."""
    scores = score_frames([stripes(0)])

    assert [name for name, _, _ in scores.values] == ["Sharpness"]
    assert scores.not_computed == {"mTV": "1 frames; needs 2", "mTV2": "1 frames; needs 3"}
    assert score_view([(stripes(0), stripes(0))], ["mTV"]).not_computed == {
        "mTV": "1 frames; needs 2"
    }
