"""The conventions of mTV, each met by numpy's own value, and the doctor's line on steadiness that
blur has bought.
"""

import cv2
import numpy as np
import pytest
from skimage import data

from ggvs_eval.contrib.explain.explain import explain
from ggvs_eval.contrib.explain.steadiness_conventions import ALWAYS, EVERYWHERE, OURS, SECOND
from ggvs_eval.errors import MetricError
from ggvs_eval.files.images import round_levels
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.pipelines.inspection.renders.identity import ViewFrames
from ggvs_eval.pipelines.inspection.renders.steadiness import steadiness_line
from helpers.refusals import refused

RNG = np.random.default_rng(0)


def noisy(frames, sigma):
    return [round_levels(frame + RNG.normal(0, sigma, frame.shape)) for frame in frames]


def make_scene(count: int = 4) -> list[np.ndarray]:
    """A photograph that stands still, and a bright square that moves over it."""
    frames = [np.ascontiguousarray(data.astronaut()[60:132, 80:176]) for _ in range(count)]
    for index, frame in enumerate(frames):
        frame[20:36, 8 * index : 8 * index + 16] = 250
    return frames


SCENE = make_scene()
TRUTH, RENDERED = noisy(SCENE, 1), noisy(SCENE, 3)
MASKS = [difference_mask(TRUTH[t + 1], TRUTH[t], beta=0.6) <= 0.65 for t in range(3)]
CHANGES = np.abs(np.diff(np.stack(RENDERED).astype(float), axis=0))
VALUES = {
    OURS: np.mean([change[mask].mean() for change, mask in zip(CHANGES, MASKS, strict=True)]),
    ALWAYS: np.mean([change[np.all(MASKS, axis=0)].mean() for change in CHANGES]),
    EVERYWHERE: CHANGES.mean(),
    SECOND: np.abs(np.diff(np.stack(RENDERED).astype(float), n=2, axis=0)).mean(),
}


def view_of(rendered, truth=TRUTH) -> dict[str, ViewFrames]:
    return {"cam00": ViewFrames(lambda t: rendered[t], lambda t: truth[t], range(len(truth)))}


@pytest.mark.parametrize("kind", VALUES)
@pytest.mark.parametrize(("scale", "white"), [("x 100", 100), ("in 0..1", 1), ("in 0..255", 255)])
def test_conventions_of_mtv(kind, scale, white):
    """Mask and scale of a quoted value are told; our tables take what stands still between the two
    frames, times 100.
    """
    quoted = f"{white * VALUES[kind] / 255:.6f}"
    matching = {
        one.name: one.is_ours for one in explain("mTV", quoted, view_of(RENDERED)) if one.matches
    }

    assert matching == {f"{kind}, {scale}": (kind, scale) == (OURS, "x 100")}


@pytest.mark.parametrize(
    ("name", "value"),
    [
        (
            f"neighbouring frames, {EVERYWHERE}, mean over channels, x 1000",
            1000 * np.square(CHANGES / 255).mean(),
        ),
        (
            f"neighbouring frames, {OURS}, sum over channels, white is 1",
            3
            * np.mean(
                [
                    np.square(one[mask] / 255).mean()
                    for one, mask in zip(CHANGES, MASKS, strict=True)
                ]
            ),
        ),
        (
            f"each frame and the first, {EVERYWHERE}, root of the mean, white is 1",
            np.mean(
                [
                    np.sqrt(np.square((one - RENDERED[0].astype(float)) / 255).mean())
                    for one in RENDERED[1:]
                ]
            ),
        ),
    ],
)
def test_conventions_of_the_warping_error(name, value):
    """Against which frame, in which pixels, squared how: each is told apart."""
    matching = {
        one.name for one in explain("E_warp", f"{value:.8f}", view_of(RENDERED)) if one.matches
    }

    assert matching == {name}


@pytest.mark.parametrize(
    ("metric", "words"),
    [("COLMAP_matches", "is of a camera path"), ("depth_mtv", "is of depth videos")],
)
def test_metrics_of_no_view_say_so(metric, words):
    """What has no test view is named for what it is of, not taken for a typing error."""
    with pytest.raises(MetricError, match=words):
        explain(metric, "1.0", view_of(RENDERED))


def test_one_frame_has_no_change():
    """The reason names the view."""
    with refused(MetricError, "1 frame", "cam00"):
        explain("mtv", "0.2", view_of(RENDERED[:1], TRUTH[:1]))
    with refused(MetricError, "1 frame", "cam00"):
        explain("e_warp", "0.2", view_of(RENDERED[:1], TRUTH[:1]))


def test_the_doctor_tells_steadiness_by_blur():
    """A blurred rendering is steadier than the noisy capture and less sharp, and told so; a noisy
    one is not.
    """
    blurred = [cv2.GaussianBlur(frame, (0, 0), 2) for frame in SCENE]

    assert "more stable but blurrier" in steadiness_line(view_of(blurred))
    line = steadiness_line(view_of(RENDERED))
    assert f"{100 * VALUES[OURS] / 255:.3f} % of white" in line
    assert "blurrier" not in line
    assert steadiness_line(view_of([frame[:40] for frame in RENDERED])) == ""
    assert steadiness_line(view_of(RENDERED[:1], TRUTH[:1])) == ""
