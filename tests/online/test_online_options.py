"""Every option of the online method changes what its docstring says, seen through the whole
method.
"""

from collections.abc import Callable
from dataclasses import dataclass, field, fields, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from ggvs_eval.geometry.splat import Splat, splat
from ggvs_eval.geometry.tsdf import PreviousDepth, RayMarch
from ggvs_eval.method import Instant, Rendering
from ggvs_eval.pipelines.online import geometry_guided
from ggvs_eval.pipelines.online.blending import Blended, BlendingInputs, GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions
from helpers.scenes import WALL_Z, camera_at, instant, look

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]
BLOCK = np.s_[4:12, 40:52]  # of the wall
UNITS_PER_METRE = 2.5
Case = Callable[[], None]


@dataclass
class Played:
    """What a method made of some instants, and what it gave its blender and its ray march
    for them.
    """

    renderings: list[Rendering] = field(default_factory=list)
    blended: list[BlendingInputs] = field(default_factory=list)
    images: list[np.ndarray] = field(default_factory=list)
    marches: list[RayMarch] = field(default_factory=list)
    marched: list[dict[str, Any]] = field(default_factory=list)

    @property
    def depths(self) -> list[np.ndarray]:
        """Fused depth of each instant."""
        return [np.asarray(rendering.depth) for rendering in self.renderings]

    def masks(self, index: int) -> list[np.ndarray]:
        """Difference masks of the sources in the target view, where their splats show something."""
        return [view.features[..., 3][view.alpha > 0.9] for view in self.blended[index].splats]


def play(instants: list[Instant], **options: Any) -> Played:
    """Show a method some instants."""
    played, geometric = Played(), GeometricBlender()

    class Recorder:
        def blend(self, inputs: BlendingInputs) -> Blended:
            played.blended.append(inputs)
            made = geometric.blend(inputs)
            played.images.append(made.image.copy())
            return made

    def march(*views: Any, **settings: Any) -> RayMarch:
        played.marched.append(settings)
        played.marches.append(original(*views, **settings))
        return played.marches[-1]

    original = geometry_guided.ray_march
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(geometry_guided, "ray_march", march)
        method = GeometryGuided(OnlineOptions(**options), Recorder())
        played.renderings = [method.step(each) for each in instants]
    return played


def still(count: int, depth_noise: float = 0.02) -> list[Instant]:
    """Nothing moves; depth is noisy anew at each instant."""
    return [instant(index, TARGET, SOURCES, depth_noise=depth_noise) for index in range(count)]


def moving(count: int) -> list[Instant]:
    """A square walks over the wall; depth is noisy."""
    return [
        instant(index, TARGET, SOURCES, 0.1 * index, depth_noise=0.02) for index in range(count)
    ]


def with_sources(
    given: Instant,
    image: Callable[[np.ndarray], np.ndarray],
    depth: Callable[[np.ndarray], np.ndarray],
) -> Instant:
    """The instant with other images and depths of all its sources."""
    sources = [
        replace(each, image=image(each.image), depth=depth(each.depth)) for each in given.sources
    ]
    return replace(given, sources=tuple(sources))


def brighter(levels: tuple[int, int, int]) -> list[Instant]:
    """A still scene whose colours change by some levels from the first instant to the second."""
    first, second = still(2, depth_noise=0.0)
    dark = with_sources(first, lambda image: image // 2, lambda depth: depth)
    return [
        dark,
        with_sources(
            second, lambda image: image // 2 + np.array(levels, np.uint8), lambda depth: depth
        ),
    ]


def jumped(share: float) -> list[Instant]:
    """A still scene whose depth grows by a share from the first instant to the second."""
    first, second = still(2, depth_noise=0.0)
    return [
        first,
        with_sources(second, lambda image: image, lambda depth: depth * np.float32(1 + share)),
    ]


def gain_of(played: Played, index: int) -> np.ndarray:
    previous: PreviousDepth = played.marched[index]["previous"]
    return previous.gain


def unsteadiness(depths: list[np.ndarray]) -> float:
    """Mean change from instant to instant, once histories have filled."""
    return float(np.mean([np.abs(after - before).mean() for before, after in pairwise(depths[2:])]))


def temporal() -> None:
    """Without it an instant is rendered as if it were the first: no filter, no previous depth, no
    former output.
    """
    frames = still(2)
    on, off, alone = play(frames), play(frames, temporal=False), play(frames[1:])
    np.testing.assert_array_equal(off.renderings[1].image, alone.renderings[0].image)
    np.testing.assert_array_equal(off.depths[1], alone.depths[0])
    assert off.marched[1]["previous"] is None
    assert on.marched[1]["previous"] is not None
    assert not np.array_equal(on.renderings[1].image, alone.renderings[0].image)


def fused() -> None:
    """Without it no ray is marched, and the blender is told of no depth."""
    on, off = play(still(1)), play(still(1), fused=False)
    assert (on.blended[0].depth > 0).mean() > 0.9
    assert off.blended[0].depth.max() == 0
    assert off.renderings[0].depth is None
    assert (len(on.marched), len(off.marched)) == (1, 0)


def lambda_t() -> None:
    """A change of 26 levels, 0.1, adds 0.1 / 0.7 to the mask, or twice that where half the
    difference counts as motion.
    """
    for value, expected in ((0.7, 0.6 + 0.102 / 0.7), (0.35, 0.6 + 0.102 / 0.35)):
        masks = play(brighter((26, 26, 26)), lambda_t=value).masks(1)
        assert [np.median(mask) for mask in masks] == pytest.approx([expected] * 4, abs=2e-3)


def beta_mask() -> None:
    """Where nothing moves the mask is its smallest weight, and depth the mean of new and old by it
    (Eq. 2).
    """
    for value in (0.6, 0.3):
        played = play(still(2), beta_mask=value)
        new, old = (frame.sources[0].depth for frame in reversed(still(2)))
        assert [np.median(mask) for mask in played.masks(1)] == pytest.approx([value] * 4, abs=1e-5)
        np.testing.assert_allclose(
            played.blended[1].instant.sources[0].depth, value * new + (1 - value) * old, rtol=1e-5
        )


def history_tolerance() -> None:
    """Depth that has grown by 4 % is mixed with its history under a tolerance of 5 %, and passes as
    it is under one of 3 %.
    """
    new, old = (frame.sources[0].depth for frame in reversed(jumped(0.04)))
    mixed, passed = (
        play(jumped(0.04), history_tolerance=value).blended[1].instant.sources[0].depth
        for value in (0.05, 0.03)
    )
    np.testing.assert_allclose(mixed, 0.6 * new + 0.4 * old, rtol=1e-5)
    np.testing.assert_array_equal(passed, new)


def beta_temporal() -> None:
    """The stronger the temporal term, the nearer fused depth stays to that of the instant
    before.
    """
    steps = [unsteadiness(play(still(6), beta_temporal=value).depths) for value in (0.0, 1.0, 4.0)]
    assert steps[0] > 1.1 * steps[1]
    assert steps[1] > 1.1 * steps[2]
    # 0.6: beta_mask
    assert np.median(gain_of(play(still(2), beta_temporal=2.0), 1)) == pytest.approx(
        2 * (1 - 0.6), abs=1e-5
    )


def eta() -> None:
    """The temporal weight ends at the limit: under a low one fused depth follows the new maps."""
    steps = [
        unsteadiness(play(still(6), beta_temporal=4.0, eta=value).depths) for value in (15.0, 0.5)
    ]
    assert steps[1] > 1.1 * steps[0]
    assert play(still(2), eta=3.0).marched[1]["previous"].limit == 3.0


def tau_m() -> None:
    """The truncation distance in metres: the march and the blender have it in world units."""
    for value in (0.02, 0.05):
        played = play(still(1), tau_m=value)
        assert (played.marched[0]["tau"], played.blended[0].tau) == pytest.approx(
            [value * UNITS_PER_METRE] * 2
        )


def depth_noise_m() -> None:
    """Depth that is noisy by 1 cm is trusted by noise over its rms: ten times as much where ten
    times the noise is allowed.
    """
    weights = [
        play(still(1, depth_noise=0.01), depth_noise_m=value, temporal=False)
        for value in (0.0001, 0.001)
    ]
    sums = [np.median(played.marches[0].weight[BLOCK]) for played in weights]
    assert sums[1] == pytest.approx(10 * sums[0], rel=0.05)


def mask_channels() -> None:
    """Red alone changes by 60 levels: the largest difference is three times the mean."""
    for value, share in (("largest", 1.0), ("mean", 1 / 3)):
        masks = play(brighter((60, 0, 0)), mask_channels=value).masks(1)
        assert [np.median(mask) for mask in masks] == pytest.approx(
            [0.6 + share * 60 / 255 / 0.7] * 4, abs=2e-3
        )


def mask_views() -> None:
    """The previous depth is trusted where no view sees a change, or where the views on average see
    little.
    """
    largest, mean = (gain_of(play(moving(2), mask_views=value), 1) for value in ("largest", "mean"))
    assert (mean >= largest - 1e-6).all()
    assert (mean > largest + 0.05).mean() > 0.02


def splatted_depth() -> None:
    """The splats are of the new depth, or of the filtered one."""
    for value in ("new", "filtered"):
        played = play(still(2), splatted_depth=value)
        source, inputs = still(2)[1].sources[0], played.blended[1]
        shown = source if value == "new" else replace(source, depth=inputs.instant.sources[0].depth)
        expected = splat([shown], TARGET, near=inputs.instant.near_plane, scale=0.5)
        np.testing.assert_array_equal(inputs.splats[0].depth, expected.depth)
    assert not np.array_equal(still(2)[1].sources[0].depth, inputs.instant.sources[0].depth)


def splatted_as() -> None:
    """A point covers its pixel or does not; a Gaussian also covers its neighbours in part."""
    points, gaussians = (
        _alphas(play(still(1), splatted_as=value)) for value in ("points", "gaussians")
    )
    assert set(np.unique(points)) == {np.float32(0), np.float32(0.99)}
    assert len(np.unique(gaussians)) > 1000


def gaussian_scale_px() -> None:
    """The smaller a Gaussian, the less of a pixel it covers."""
    small, middle, large = (
        np.median(_alphas(play(still(1), gaussian_scale_px=value))) for value in (0.2, 0.35, 0.5)
    )
    assert small < middle < large


def min_step() -> None:
    """The march takes no smaller step: with a small one it comes nearer to the middle of two walls,
    1.5 tau apart.
    """
    tau = OnlineOptions().tau_m * UNITS_PER_METRE
    (wall,) = still(1, 0.0)
    far = with_sources(wall, lambda image: image, lambda depth: depth + np.float32(1.5 * tau))
    both = replace(wall, sources=wall.sources[:2] + far.sources[2:])
    middle = WALL_Z + 0.75 * tau
    errors = [
        np.median(np.abs(play([both], min_step=value).depths[0][BLOCK] - middle))
        for value in (0.5, 0.1)
    ]
    assert errors[1] < 0.5 * errors[0]


def signed_distance() -> None:
    """With the printed sign few rays find a surface."""
    found = [
        _share_at_surface(play(still(1, 0.0), signed_distance=value))
        for value in ("front", "printed")
    ]
    assert found[0] > 0.9
    assert found[1] < 0.1


def normalised_field() -> None:
    """Without the division by the sum of the weights, which is near 4 here, most rays jump over the
    surface.
    """
    found = [
        _share_at_surface(play(still(1, 0.0), normalised_field=value)) for value in (True, False)
    ]
    assert found[0] > 0.9
    assert found[1] < 0.5


def recurrent_limit() -> None:
    """The larger the limit, the calmer the output where nothing moves; without, the output is what
    was blended.
    """
    alone = {"beta_temporal": 0.0, "beta_mask": 1.0}  # nothing else calms it
    without, half, most = (
        play(still(10), recurrent_limit=value, **alone) for value in (0.0, 0.5, 0.9)
    )
    for rendering, image in zip(without.renderings, without.images, strict=True):
        np.testing.assert_array_equal(rendering.image, image)
    outputs = (
        [rendering.image for rendering in played.renderings[2:]] for played in (without, half, most)
    )
    steps = [
        np.sqrt(np.mean([(after - before) ** 2 for before, after in pairwise(images)]))
        for images in outputs
    ]
    assert steps[0] > 1.3 * steps[1]
    assert steps[1] > 1.3 * steps[2]


def compensated() -> None:
    """A source that is darker by a fifth is blended as bright as the others, or as it came."""
    frame = still(1, depth_noise=0.0)[0]
    first, *others = frame.sources
    darker = replace(
        frame, sources=(replace(first, image=(0.8 * first.image).astype(np.uint8)), *others)
    )
    on, off = (
        [each.image for each in play([darker], compensated=value).blended[0].instant.sources]
        for value in (True, False)
    )
    np.testing.assert_array_equal(off[0], darker.sources[0].image)
    ratio = [np.mean(images[0]) / np.mean(images[1]) for images in (on, off)]
    assert ratio[1] == pytest.approx(0.8, abs=0.03)
    assert ratio[0] == pytest.approx(1.0, abs=0.03)


def settled() -> None:
    """Where views show a surface that the ray march has voted away, their colours bring it back, or
    it stays away.
    """
    frame, true_depth = still(1, depth_noise=0.0)[0], look(TARGET)[1]

    def march_behind(*views: Any, **settings: Any) -> RayMarch:
        return RayMarch(1.3 * true_depth, np.ones_like(true_depth))

    depths = []
    for value in (True, False):
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(geometry_guided, "ray_march", march_behind)
            depths.append(
                np.asarray(GeometryGuided(OnlineOptions(settled=value)).step(frame).depth)
            )
    assert (np.abs(depths[0] - true_depth) < 0.1).mean() > 0.8
    np.testing.assert_array_equal(depths[1], 1.3 * true_depth)


def forgiven_px() -> None:
    """A source at the target's place whose depth is wrong is looked up there, or hidden: others
    show the surface.
    """
    frame = still(1, depth_noise=0.0)[0]
    first = replace(
        frame.sources[0], image=255 - frame.sources[0].image, depth=1.3 * frame.sources[0].depth
    )
    near = replace(
        frame, target=replace(first.camera, name="target"), sources=(first, *frame.sources[1:])
    )
    images = [play([near], forgiven_px=value, compensated=False).images[0] for value in (0.5, 0.0)]
    errors = [np.abs(255 * image - first.image).mean() for image in images]
    assert errors[0] < 1 < 20 < errors[1]


def remembered() -> None:
    """What no source sees any more is shown as it was seen, though all else has changed, or filled
    from its surroundings.
    """
    first, second, third = still(3, depth_noise=0.0)
    blind = with_sources(third, lambda image: 255 - image, _without_the_top)
    truth, errors = look(TARGET)[0] / 255, []
    for value in (True, False):
        image = (
            play([first, second, blind], remembered=value, recurrent_limit=0.0).renderings[2].image
        )
        errors.append(np.abs(image - truth)[BLOCK].mean())
    assert errors[0] < 0.02
    assert errors[1] > 0.1


def _without_the_top(depth: np.ndarray) -> np.ndarray:
    """Depth that is unknown in the upper third."""
    known = depth.copy()
    known[: depth.shape[0] // 3] = 0
    return known


def _alphas(played: Played) -> np.ndarray:
    views: list[Splat] = list(played.blended[0].splats)
    return np.concatenate([view.alpha.ravel() for view in views])


def _share_at_surface(played: Played) -> float:
    """Share of the rays that end within a tenth of the truncation distance of what the
    target sees.
    """
    return float((np.abs(played.depths[0] - look(TARGET)[1]) < 0.1 * played.blended[0].tau).mean())


CASES: dict[str, Case] = {
    each.__name__: each
    for each in (
        *(
            temporal,
            fused,
            lambda_t,
            beta_mask,
            history_tolerance,
            beta_temporal,
            eta,
            tau_m,
            depth_noise_m,
        ),
        *(mask_channels, mask_views, splatted_depth, splatted_as, gaussian_scale_px, min_step),
        *(
            signed_distance,
            normalised_field,
            recurrent_limit,
            compensated,
            settled,
            forgiven_px,
            remembered,
        ),
    )
}


@pytest.mark.parametrize("option", [each.name for each in fields(OnlineOptions)])
def test_every_option_does_what_it_says(option):
    """An option without a case here fails; one that changes nothing fails in its case."""
    CASES[option]()


def test_no_case_is_left_over():
    """An option that is gone takes its case with it."""
    assert CASES.keys() == {each.name for each in fields(OnlineOptions)}
