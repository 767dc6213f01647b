"""Augmented crops: what is drawn from the same seed is the same, and each change does what it says
and nothing else.
"""

import numpy as np

from ggvs_eval.contrib.training.blend_task import Augmentation, augment, displaced
from ggvs_eval.contrib.training.samples.sample_kinds import RawViews, raw_views
from helpers.blender_inputs import inputs_of
from helpers.scenes import camera_at, instant, look

NOTHING = Augmentation(gain=0, view_gain_share=0, blur_share=0, shift_share=0)
TARGET = camera_at(0.0, name="target")
SHIFTED = ("splats", "warps", "alphas", "visibilities", "depths")
MAPS = (*SHIFTED, "fused_depth")


def crop() -> tuple[RawViews, np.ndarray]:
    views = raw_views(inputs_of(instant(0, TARGET, [camera_at(-0.1), camera_at(0.15)])))
    return views, (look(TARGET)[0] / 255).astype(np.float32)


def changed(options: Augmentation, seed: int = 0) -> tuple[RawViews, np.ndarray]:
    return augment(*crop(), np.random.default_rng(seed), options)


def test_without_strength_nothing_changes():
    """Shares and strengths of zero leave every map and the truth."""
    views, truth = crop()
    found, same = changed(NOTHING)
    np.testing.assert_array_equal(same, truth)
    for name in MAPS:
        np.testing.assert_array_equal(getattr(found, name), getattr(views, name))


def test_a_common_gain_is_that_of_the_truth():
    """Sources and truth become brighter by the same factor per channel; geometry stays."""
    views, truth = crop()
    found, brighter = changed(
        Augmentation(gain=0.1, view_gain_share=0, blur_share=0, shift_share=0)
    )
    inside = (views.warps > 0.05) & (views.warps < 0.6)
    factors = np.median((brighter / truth).reshape(-1, 3), axis=0)
    expected = views.warps * factors
    np.testing.assert_allclose(found.warps[inside], expected[inside], rtol=1e-4)
    assert np.ptp(factors) > 0.01
    for name in ("alphas", "visibilities", "depths", "fused_depth"):
        np.testing.assert_array_equal(getattr(found, name), getattr(views, name))


def test_gains_of_single_views_do_not_touch_the_truth():
    """Two views by two factors, one factor for all channels of a view."""
    views, truth = crop()
    found, same = changed(
        Augmentation(gain=0, view_gain=0.1, view_gain_share=1, blur_share=0, shift_share=0)
    )
    np.testing.assert_array_equal(same, truth)
    usable = (views.warps > 0.05) & (views.warps < 0.6)
    factors = [found.warps[k][usable[k]] / views.warps[k][usable[k]] for k in range(2)]
    assert all(np.ptp(each) < 1e-4 for each in factors)
    assert abs(factors[0].mean() - factors[1].mean()) > 0.01


def test_views_are_displaced_as_asked():
    """Whole pixels to the right and down are a roll away from the border; another view stays."""
    views, _ = crop()
    found = displaced(views, np.array([[3.0, 2.0], [0.0, 0.0]]))
    for name in SHIFTED:
        before, after = getattr(views, name), getattr(found, name)
        np.testing.assert_allclose(after[0, 2:, 3:], before[0, :-2, :-3], atol=1e-6, err_msg=name)
        np.testing.assert_allclose(after[1], before[1], atol=1e-6, err_msg=name)


def test_one_view_is_blurred():
    """Its colours vary less from pixel to pixel; the other's stay."""
    views, _ = crop()
    found, _ = changed(Augmentation(gain=0, view_gain_share=0, blur_share=1, shift_share=0))
    touched = [not np.array_equal(found.splats[k], views.splats[k]) for k in range(2)]
    assert sum(touched) == 1
    k = touched.index(True)
    assert (
        np.abs(np.diff(found.splats[k], axis=1)).sum()
        < np.abs(np.diff(views.splats[k], axis=1)).sum()
    )
    np.testing.assert_array_equal(found.alphas, views.alphas)
