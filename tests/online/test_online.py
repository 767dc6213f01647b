"""The online half: causality, stillness, ablations, and what each stage does in a scene known in
closed form.
"""

from dataclasses import replace

import numpy as np
import pytest

from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.method import SourceView
from ggvs_eval.pipelines.methods.registry import METHODS, find_method
from ggvs_eval.pipelines.methods.spec import OnlineMethod
from ggvs_eval.pipelines.online import geometry_guided
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided
from ggvs_eval.pipelines.online.temporal_filters import TemporalDepthFilter, filter_depth
from ggvs_eval.results import split_label
from helpers.photographs import psnr_db
from helpers.refusals import refused
from helpers.scenes import SQUARE_Z, WALL_Z, camera_at, instant, look

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]


# The others, from outside or fitted, have tests of their own.
SHIPPED = [
    label
    for label, spec in METHODS.items()
    if isinstance(spec, OnlineMethod) and "weights" not in spec.takes
]
ONLINE = [label for label in SHIPPED if METHODS[label].online]


def play(label: str, positions: list[float], **options) -> list[np.ndarray]:
    method = find_method(label).make()
    return [
        method.step(instant(t, TARGET, SOURCES, x, **options)).image
        for t, x in enumerate(positions)
    ]


@pytest.mark.parametrize("label", ONLINE)
def test_changing_the_future_does_not_change_the_present(label):
    """Two sequences that agree up to instant 2 give the same bits up to instant 2, and differ
    after.
    """
    first = play(label, [0.0, 0.1, 0.2, 0.3])
    second = play(label, [0.0, 0.1, 0.2, -0.5])

    for t in range(3):
        np.testing.assert_array_equal(first[t], second[t])
    assert not np.array_equal(first[3], second[3])


# of the others the test above says it
@pytest.mark.parametrize("label", sorted({*SHIPPED} - {*ONLINE}))
def test_equal_inputs_give_equal_bits(label):
    """Playing a sequence twice gives the same images to the last bit."""
    for once, again in zip(
        play(label, [0.0, 0.1], depth_noise=0.02),
        play(label, [0.0, 0.1], depth_noise=0.02),
        strict=True,
    ):
        np.testing.assert_array_equal(once, again)


@pytest.mark.parametrize("label", SHIPPED)
def test_exact_depth_gives_the_captured_view(label):
    """With exact depth and smooth texture every method comes close to the truth away from the
    square's edge.
    """
    truth, depth = look(TARGET)
    inside = depth == WALL_Z
    inside[15:60, 20:75] = False  # the square and what it hides from some view

    image = play(label, [0.0])[0]

    assert psnr_db(image[inside], truth[inside]) > 30


def test_ours_finds_the_surface():
    """The fused depth is the exact depth of wall and square within a tenth of the truncation
    distance, edges apart.
    """
    _, depth = look(TARGET)

    fused = GeometryGuided().step(instant(0, TARGET, SOURCES)).depth

    error = np.abs(fused - depth)
    assert np.quantile(error, 0.9) < 0.1 * 0.02 * 2.5


def test_a_moving_target_keeps_its_history_in_place():
    """When the target camera moves, the previous depth takes part at its own pose: the fused depth
    stays exact.
    """
    method = GeometryGuided()
    for t, x in enumerate((0.0, 0.05, 0.1)):
        target = camera_at(x, name="moving")
        depth = method.step(instant(t, target, SOURCES)).depth

    assert np.quantile(np.abs(depth - look(target)[1]), 0.9) < 0.1 * 0.02 * 2.5


def test_a_skipped_instant_starts_history_anew():
    """After a gap in time the method renders as if it had just begun: stale history is worse than
    none.
    """
    method = GeometryGuided()
    method.step(instant(0, TARGET, SOURCES, 0.0))

    late = method.step(instant(5, TARGET, SOURCES, 0.4)).image

    np.testing.assert_array_equal(
        late, GeometryGuided().step(instant(5, TARGET, SOURCES, 0.4)).image
    )


def test_still_pixels_get_beta_and_moving_ones_get_one():
    """Eq. 1: an unchanged image has mask beta everywhere; a change of 0.4 lambda or more
    saturates.
    """
    before = np.full((64, 64, 3), 100, np.uint8)
    after = before.copy()
    after[:32] = 100 + 75  # 75 / 255 = 0.294 > 0.28

    mask = difference_mask(after, before)

    assert mask[48:].min() == mask[48:].max() == np.float32(0.6)
    assert mask[:24].min() == 1.0
    np.testing.assert_allclose(
        difference_mask(before + 36, before), 36 / 255 / 0.7 + 0.6, atol=1e-6
    )


def test_filtered_depth_mixes_by_the_mask():
    """Eq. 2, and what is unknown on one side is taken from the other unless everything moves."""
    depth = np.array([[2.0, 0.0, 0.0, 2.0]], np.float32)
    history = np.array([[4.0, 4.0, 4.0, 0.0]], np.float32)
    mask = np.array([[0.75, 0.6, 1.0, 0.6]], np.float32)

    np.testing.assert_allclose(filter_depth(depth, history, mask, np.inf), [[2.5, 4.0, 0.0, 2.0]])


def test_the_filter_converges_on_the_mean_of_noisy_depth():
    """In a still scene the filtered depth has less noise than what goes in: by sqrt(beta / (2 -
    beta)) in the steady state.
    """
    random = np.random.default_rng(0)
    filters, image = TemporalDepthFilter(), np.full((40, 40, 3), 90, np.uint8)
    for t in range(20):
        depth = random.normal(SQUARE_Z, 0.02, (40, 40)).astype(np.float32)
        filtered = filters.step(t, SourceView(TARGET, image, depth, np.ones_like(depth)))[0].depth

    assert filtered.std() == pytest.approx(0.02 * np.sqrt(0.6 / 1.4), rel=0.1)


@pytest.mark.parametrize("gap", [0, 2])
def test_the_filter_knows_the_instant_before_alone(gap):
    """Depth of two instants ago, or of the same one, is no history: the new depth passes as it is,
    and no change is known.
    """
    filters, image, ones = (
        TemporalDepthFilter(),
        np.full((8, 12, 3), 90, np.uint8),
        np.ones((8, 12), np.float32),
    )
    filters.step(3, SourceView(TARGET, image, 2.0 * ones, ones))
    source, change = filters.step(3 + gap, SourceView(TARGET, image, 2.05 * ones, ones))
    np.testing.assert_array_equal(source.depth, 2.05 * ones)
    assert change is None
    np.testing.assert_allclose(
        filters.step(4 + gap, SourceView(TARGET, image, 2.0 * ones, ones))[0].depth, 2.02, rtol=1e-6
    )


def test_an_unknown_method_names_the_nearest():
    """A mistyped method is refused with the one that was probably meant."""
    with refused(RenderError, "'ours-geometrc'", "did you mean ours-geometric?"):
        find_method("ours-geometrc")
    assert split_label("ours-geometric+no-temporal") == ("ours-geometric", "no-temporal")


def test_a_source_that_joins_leaves_the_temporal_term_as_it_is(monkeypatch):
    """It cannot tell what moves: where nothing does the gain stays within a tenth, and the picture
    changes by less than noise.
    """
    rig, target, gains = (
        [camera_at(x) for x in (-0.3, -0.1, 0.1, 0.3)],
        camera_at(0.0, name="target"),
        [],
    )
    march = geometry_guided.ray_march

    def watched(*arguments, previous=None, **options):
        gains.append(None if previous is None else float(previous.gain.mean()))
        return march(*arguments, previous=previous, **options)

    monkeypatch.setattr(geometry_guided, "ray_march", watched)
    method, images, sigma = GeometryGuided(), [], 2.0
    for index in range(10):
        chosen = rig[:3] if index < 8 else rig[1:]
        plain, random = (
            instant(index, target, chosen, depth_noise=0.005),
            np.random.default_rng([index, 3]),
        )
        noise = [
            np.rint(view.image + random.normal(0, sigma, view.image.shape))
            for view in plain.sources
        ]
        sources = zip(plain.sources, noise, strict=True)
        noisy = tuple(
            replace(view, image=image.clip(0, 255).astype(np.uint8)) for view, image in sources
        )
        images.append(255 * method.step(replace(plain, sources=noisy)).image)
    assert gains[8] == pytest.approx(gains[7], rel=0.1)
    assert np.sqrt(np.mean((images[8] - images[7]) ** 2)) < sigma


@pytest.mark.parametrize("size", [(1, 1), (1, 7), (7, 1)])
def test_images_of_one_pixel(size):
    """One pixel wide or high is rendered; one pixel alone is an error that says so, where images
    are looked up.
    """
    target, sources = (
        camera_at(0.0, name="target", width=7, height=7),
        [camera_at(x, width=size[0], height=size[1]) for x in (-0.1, 0.1)],
    )
    method = GeometryGuided()
    for index in range(3):
        if size == (1, 1):
            with pytest.raises(RenderError, match="at least two pixels"):
                method.step(instant(index, target, sources))
        else:
            assert np.isfinite(method.step(instant(index, target, sources)).image).all()


def test_colours_are_colours():
    """What a wide change beside a pixel takes off it leaves no value below 0: a white half turns
    black where nothing moves.
    """
    pictures = np.zeros((2, TARGET.height, TARGET.width, 3), np.float32)
    pictures[0, :, : TARGET.width // 2] = 1

    class Painted:
        """A blender that shows given pictures."""

        def blend(self, inputs: BlendingInputs) -> Blended:
            """The picture of the instant."""
            return Blended(pictures[inputs.instant.index].copy())

    method = GeometryGuided(blender=Painted())
    images = [method.step(instant(index, TARGET, SOURCES)).image for index in range(2)]
    assert 0 == images[1].min() < images[1].max() <= 1
