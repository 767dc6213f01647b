"""The registration of views in one pass, against warps mixed with splats, which define it."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.camera import Camera
from ggvs_eval.contrib.training.samples.sample_kinds import raw_views
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.splat import Splat
from ggvs_eval.geometry.warp import register_views
from ggvs_eval.method import Instant, SourceView
from ggvs_eval.pipelines.online.blending import BlendingInputs
from ggvs_eval.pipelines.online.network_blender import overview, registered
from ggvs_eval.pipelines.online.network_inputs import FAINT, blend_maps
from helpers.geometry_scenes import TAU, random_camera, random_depth, seeds, sizes, view_of
from helpers.refusals import refused

pytestmark = pytest.mark.usefixtures("kernel_settings")


def source_view(random: np.random.Generator, width: int, height: int, name: str) -> SourceView:
    camera = random_camera(random, width, height, name)
    image = random.integers(0, 256, (height, width, 3)).astype(np.uint8)
    return view_of(camera, random_depth(random, camera), image)


def random_splat(random: np.random.Generator, camera: Camera, features: int) -> Splat:
    size = camera.height, camera.width
    alpha = random.random(size, dtype=np.float32) * (random.random(size) < 0.7)
    return Splat(
        random.random((*size, features), dtype=np.float32),
        alpha.astype(np.float32),
        random_depth(random, camera),
    )


def random_inputs(seed: int, size: tuple[int, int], views: int, features: int) -> BlendingInputs:
    """Views of different sizes around a rough surface, their splats of so many features, one source
    not seen at all.
    """
    random = np.random.default_rng(seed)
    target = random_camera(random, *size, "target")
    sources = [source_view(random, 5 + 9 * k, 7 + 5 * k, f"source {k}") for k in range(views)]
    splats = [random_splat(random, target, features) for _ in sources]
    sources[-1] = replace(sources[-1], depth=np.zeros_like(sources[-1].depth))
    return BlendingInputs(
        Instant(0, target, tuple(sources), 1.0), splats, random_depth(random, target), TAU
    )


@settings(deadline=None, max_examples=25)
@given(
    seeds, sizes, st.integers(1, 5), st.integers(3, 4), st.sampled_from(kernels.available_levels())
)
def test_one_pass_is_warps_mixed_with_splats(seed, size, views, features, level):
    """Any sizes, poses and holes give what `RawViews.maps` makes of warps and splats, with every
    instruction set.
    """
    inputs = random_inputs(seed, size, views, features)
    kernels.set_simd_level(level)
    found, expected = blend_maps(inputs, "registered"), raw_views(inputs).maps("registered")
    for name in ("colours", "coverage", "visibilities", "alphas", "depths", "fused_depth"):
        ours, theirs = np.asarray(getattr(found, name)), np.asarray(getattr(expected, name))
        assert ours.dtype == theirs.dtype == np.float32
        np.testing.assert_allclose(ours, theirs, atol=2e-6, err_msg=name)
    assert found.sources == expected.sources


@settings(deadline=None, max_examples=25)
@given(seeds, sizes, st.integers(1, 4), st.sampled_from((1, 3, 4, 8)), st.integers(1, 3))
def test_registered_and_looked_at_in_one_pass(seed, size, views, scale, threads):
    """Registration and overview at once have the bits of one after the other."""
    inputs = random_inputs(seed, size, views, 4)
    kernels.set_threads(threads)
    maps, summary = registered(inputs, scale)
    expected = blend_maps(inputs, "registered")
    for ours, theirs in ((maps, expected), (summary.small, overview(expected, scale).small)):
        for name in ("colours", "coverage", "visibilities", "alphas", "depths", "fused_depth"):
            np.testing.assert_array_equal(
                np.asarray(getattr(ours, name)), np.asarray(getattr(theirs, name)), err_msg=name
            )
    for name in ("unseen", "picture", "covered"):
        np.testing.assert_array_equal(
            getattr(summary, name), getattr(overview(expected, scale), name), err_msg=name
        )


def test_threads_and_instruction_sets_give_the_same_bits():
    """Neither changes a bit."""
    inputs, found = random_inputs(0, (67, 41), 3, 4), []
    for level in kernels.available_levels():
        for threads in (1, 3):
            kernels.set_simd_level(level)
            kernels.set_threads(threads)
            found.append(blend_maps(inputs, "registered"))
    assert 0.1 < found[0].visibilities[:-1].mean() < 1
    for other in found[1:]:
        np.testing.assert_array_equal(other.colours, found[0].colours)
        np.testing.assert_array_equal(other.coverage, found[0].coverage)


def test_what_does_not_fit_is_refused():
    """Splats of another number or size, images of another kind, no tolerance: named."""
    inputs = random_inputs(1, (12, 9), 2, 3)
    target, sources, splats = inputs.instant.target, inputs.instant.sources, list(inputs.splats)
    arguments = (target, inputs.depth)
    with refused(RenderError, "2 views", "1 splats"):
        register_views(*arguments, sources, splats[:1], TAU, float(FAINT))
    with pytest.raises(RenderError, match="tolerance must be positive"):
        register_views(*arguments, sources, splats, 0.0, float(FAINT))
    small = Splat(splats[0].features[:4], splats[0].alpha[:4], splats[0].depth[:4])
    with refused(RenderError, "coverage", "9 x 12"):
        register_views(*arguments, sources, [small, splats[1]], TAU, float(FAINT))
    grey = replace(sources[0], image=sources[0].image[..., 0])
    with pytest.raises(RenderError, match="wanted a uint8 image"):
        register_views(*arguments, [grey, sources[1]], splats, TAU, float(FAINT))
