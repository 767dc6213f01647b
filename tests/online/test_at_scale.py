"""A method at a fraction of the size: shown small sources, enlarged, and timed with both."""

import numpy as np
import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.method import Instant, Rendering
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.methods.spec import AtScale
from helpers.scenes import camera_at
from helpers.scenes import instant as make_instant


class Noted:
    """Remembers what it is shown, and answers with a grey picture of the target's size."""

    def __init__(self) -> None:
        self.shown: list[Instant] = []

    def step(self, instant: Instant) -> Rendering:
        self.shown.append(instant)
        width, height = instant.target.size
        grey = np.full((height, width, 3), 0.5, np.float32)
        return Rendering(grey, np.full((height, width), 2.0, np.float32), {"work": 0.25})


@pytest.fixture
def instant() -> Instant:
    """Two views of a plane."""
    return make_instant(0, camera_at(0.0), [camera_at(-0.3), camera_at(0.3)])


def test_sources_are_small_and_the_picture_is_large(instant):
    """The method sees half of everything, depth included; the picture and its depth have the
    target's size again.
    """
    inner = Noted()
    rendering = AtScale(inner, 0.5).step(instant)
    width, height = instant.target.size
    (small,) = inner.shown

    assert small.target.size == (round(width / 2), round(height / 2))
    assert small.target.K[0, 0] == pytest.approx(instant.target.K[0, 0] / 2)
    for source, whole in zip(small.sources, instant.sources, strict=True):
        assert (
            source.image.shape[:2]
            == source.depth.shape
            == source.confidence.shape
            == source.camera.size[::-1]
        )
        # no mean of two surfaces
        assert set(np.unique(source.depth)) <= set(np.unique(whole.depth))
        assert source.share == whole.share
    assert rendering.image.shape == (height, width, 3)
    assert rendering.image.dtype == np.float32
    np.testing.assert_allclose(rendering.image, 0.5, atol=1e-6)
    assert rendering.depth is not None
    assert rendering.depth.shape == (height, width)
    assert [*rendering.seconds] == ["shrink", "work", "enlarge"]
    assert rendering.seconds["work"] == 0.25


def test_labels_set_the_scale_of_any_online_method():
    """With options, of a variant, with a device: the label says it, and the identity knows it."""
    for label, title in (
        ("distance-based+scale=0.5", "Distance-based Blending, scale=0.5"),
        (
            "ours-geometric+no-temporal+scale=0.25",
            "GGVS (online), geometric weights, no temporal filtering, scale=0.25",
        ),
    ):
        spec = find_method(label)
        assert spec.title == title
        assert spec.settings["scale"] == float(label.rpartition("=")[2])
        assert isinstance(spec.make(), AtScale)
    both = find_method("ours-geometric+tau_m=0.1+scale=0.5")
    assert isinstance(both.make(), AtScale)
    assert "scale" in both.settings


@pytest.mark.parametrize(
    "label",
    ["ours+scale=1.5", "ours+scale=0", "ours+scale=half", "ours-geometric+offline+scale=0.5"],
)
def test_what_is_no_scale_is_refused(label):
    """A scale beyond (0, 1), a word, and a method that must see the whole sequence first."""
    with pytest.raises(
        RenderError, match="wanted a scale between 0 and 1 of a method that is online"
    ):
        find_method(label)
