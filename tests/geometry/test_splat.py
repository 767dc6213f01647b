import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval import kernels
from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.splat import Splat, float_features, splat, splat_depth
from ggvs_eval.kernels import _core
from helpers.geometry_scenes import (
    random_camera,
    random_depth,
    random_source,
    seeds,
    sizes,
    view_of,
)
from helpers.places import DATA_FOLDER
from helpers.refusals import refused
from helpers.twins.splat import splat_twin

ORACLE = DATA_FOLDER / "splat_case.npz"


pytestmark = pytest.mark.usefixtures("kernel_settings")


def flat_camera(width: int = 21, height: int = 21, focal: float = 20.0) -> Camera:
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera("flat", K, np.eye(4), width, height, 0.5, 10.0)


def images(result: Splat) -> np.ndarray:
    """Features, alpha and depth side by side, (H, W, C + 2)."""
    return np.concatenate(
        [result.features, result.alpha[..., None], result.depth[..., None]], axis=-1
    )


def assert_close(ours: Splat, theirs: Splat) -> None:
    """Tight everywhere but at single pixels where the 1/255 cut or the stop fell the other way (a
    weight of at most 0.01).
    """
    difference = np.abs(images(ours) - images(theirs)).max(axis=-1)
    assert (difference > 1e-4).mean() <= max(0.002, 2 / difference.size)
    assert difference.max() < 0.05


@settings(deadline=None, max_examples=5)
@given(seeds, sizes, sizes, st.integers(1, 4), st.integers(1, 3), st.booleans())
def test_agrees_with_its_twin(seed, source_size, target_size, channels, count, normalised):
    """Any sizes, channels and number of sources give the twin's images."""
    random = np.random.default_rng(seed)
    sources = [
        random_source(random, random_camera(random, *source_size), channels) for _ in range(count)
    ]
    target = random_camera(random, *target_size)
    assert_close(
        splat(sources, target, near=0.2, normalised=normalised),
        splat_twin(sources, target, near=0.2, normalised=normalised),
    )


@pytest.mark.parametrize("prefix", ["", "identity_"])
def test_oracle(prefix):
    """The stored case is met but for the first row and column of its 16-pixel tiles, where it drops
    Gaussians that we keep.
    """
    case = np.load(ORACLE)
    height, width = case["depth"].shape
    source = Camera("source", case["K"], case["src_w2c"], width, height, 0.1, 100.0)
    target = Camera(
        "target", case["K"], case["src_w2c" if prefix else "tgt_w2c"], width, height, 0.1, 100.0
    )
    gaussians = view_of(source, case["depth"].astype(np.float32), case["image"].astype(np.float32))
    ours = splat([gaussians], target, near=0.2, scale=float(case["sigma_factor"]), normalised=False)
    oracle = Splat(
        *(
            case[prefix + key].astype(np.float32)
            for key in ("color_premult", "alpha", "depth_premult")
        )
    )
    rows, columns = (np.arange(size) % 16 != 0 for size in (height, width))
    difference = np.abs(images(ours) - images(oracle)).max(axis=-1)
    assert difference[rows][:, columns].max() < 1e-5
    assert difference.max() < 0.02


def test_single_gaussian():
    """One Gaussian of sigma 1 px has the published profile: variance 1.3, alpha 0.99, 0.68071,
    0.21471.
    """
    camera = flat_camera()
    depth = np.zeros((21, 21), dtype=np.float32)
    depth[10, 10] = 2.0
    alpha = splat([view_of(camera, depth, depth[..., None])], camera, near=0.2, scale=1.0).alpha
    # five printed digits
    np.testing.assert_allclose(alpha[10, 10:13], [0.99, 0.68071, 0.21471], atol=5e-6)
    # sums are rounded in the order across, down
    np.testing.assert_allclose(alpha, alpha.T, atol=1e-6)


def test_before_near_is_left_out():
    """A Gaussian at or before `near` is not drawn."""
    camera = flat_camera()
    plane = view_of(
        camera, np.full((21, 21), 1.0, dtype=np.float32), np.ones((21, 21, 1), dtype=np.float32)
    )
    assert splat([plane], camera, near=1.0).alpha.max() == 0
    assert splat([plane], camera, near=0.99).alpha.min() > 0.9


@pytest.mark.parametrize("invalid", [0.0, -1.0, np.nan, np.inf])
def test_invalid_depth_draws_nothing(invalid):
    """Where no pixel is valid, everything is exactly 0."""
    camera = flat_camera()
    nothing = view_of(
        camera, np.full((21, 21), invalid, dtype=np.float32), np.ones((21, 21, 3), dtype=np.float32)
    )
    assert not images(splat([nothing], camera, near=0.2)).any()


def test_layouts_are_accepted_by_the_face():
    """Float64 and strided inputs give what their contiguous float32 copies give."""
    random = np.random.default_rng(4)
    camera = random_camera(random, 33, 22)
    tidy = random_source(random, camera, 3)
    untidy = view_of(
        camera, np.asfortranarray(tidy.depth, dtype=np.float64), tidy.image[..., ::-1][..., ::-1]
    )
    np.testing.assert_array_equal(
        images(splat([untidy], camera, near=0.2)), images(splat([tidy], camera, near=0.2))
    )


@pytest.mark.parametrize(
    ("features", "depth", "message"),
    [
        ((21, 21, 5), (21, 21), "one C from 1 to 4"),
        ((21, 21), (21, 21), "one C from 1 to 4"),
        ((21, 21, 3), (20, 21), "depth must be 21 x 21"),
        ((20, 21, 3), (21, 21), "features must be 21 x 21"),
        ((21, 21, 0), (21, 21), "one C from 1 to 4"),
    ],
)
def test_shapes_that_do_not_fit_are_refused(features, depth, message):
    """The error names what was wanted."""
    source = view_of(
        flat_camera(), np.ones(depth, dtype=np.float32), np.ones(features, dtype=np.float32)
    )
    with pytest.raises(RenderError, match=message):
        splat([source], flat_camera(), near=0.2)


def test_no_source_is_refused():
    """An empty list of sources is an error, not an empty image."""
    with pytest.raises(RenderError, match="no source"):
        splat([], flat_camera(), near=0.2)


@pytest.mark.parametrize(
    ("depth", "got"),
    [
        (np.ones((21, 21)), "float64"),
        (np.ones((21, 42), dtype=np.float32)[:, ::2], "not C-contiguous"),
        (np.ones((21, 20), dtype=np.float32), r"\(21, 20\)"),
        ([1.0], "list"),
    ],
)
def test_the_kernel_converts_nothing(depth, got):
    """Below the Python face a wrong dtype, layout or shape is a TypeError that names both sides."""
    pinhole = (20.0, 20.0, 10.5, 10.5, 21, 21)
    source = (pinhole, np.eye(4), depth, np.ones((21, 21, 1), dtype=np.float32))
    with pytest.raises(
        TypeError, match=rf"depth: wanted float32 \(21, 21\), C-contiguous, got .*{got}"
    ):
        _core.splat([source], pinhole, 0.2, 0.5, 1, True, 1, 0)


def test_settings_refuse_what_cannot_be():
    """Zero threads and unknown instruction sets are refused with what would be possible."""
    with pytest.raises(ValueError, match="at least 1"):
        kernels.set_threads(0)
    with pytest.raises(ValueError, match="wanted one of baseline"):
        kernels.set_simd_level("mmx")


def test_settings_come_from_the_environment(monkeypatch):
    """Unset, threads and instruction set are those of the environment variables."""
    monkeypatch.setattr(kernels, "_settings", {})
    monkeypatch.setenv("GGVS_EVAL_THREADS", "3")
    monkeypatch.setenv("GGVS_EVAL_SIMD", "baseline")
    assert (kernels.get_threads(), kernels.get_simd_level()) == (3, "baseline")


@pytest.mark.parametrize("channels", [3, 4])
def test_an_8_bit_image_splats_as_its_float_copy(channels):
    """Levels 0 to 255, and an extra feature beside them, give the bits that floats of level / 255
    give.
    """
    random = np.random.default_rng(12)
    source, target = random_camera(random, 50, 38), random_camera(random, 61, 45)
    depth = random_depth(random, source)
    image = random.integers(0, 256, (38, 50, 3)).astype(np.uint8)
    extra = random.random((38, 50), dtype=np.float32) if channels == 4 else None
    extras = () if extra is None else [extra]

    ours = splat([view_of(source, depth, image)], target, near=0.2, extras=extras)
    floats = splat([view_of(source, depth, float_features(image, extra))], target, near=0.2)

    assert ours.features.shape[2] == channels
    for name in ("features", "alpha", "depth"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(floats, name))


def test_the_splat_of_a_depth_map_is_that_of_its_view():
    """Coverage and depth do not depend on what is blended: those of a depth map alone are the
    view's, bit by bit.
    """
    random = np.random.default_rng(14)
    source, target = (
        random_source(random, random_camera(random, 50, 38), 1),
        random_camera(random, 61, 45),
    )

    alone, whole = (
        splat_depth(source.camera, source.depth, target, near=0.2),
        splat([source], target, near=0.2),
    )

    np.testing.assert_array_equal(alone.alpha, whole.alpha)
    np.testing.assert_array_equal(alone.depth, whole.depth)
    assert 0 < (whole.alpha > 0).mean() <= 1


def test_an_extra_feature_goes_with_8_bit_images():
    """Beside float features, and beside an image that is not RGB, an extra feature is refused."""
    random = np.random.default_rng(13)
    camera = random_camera(random, 8, 6)
    depth, image = np.ones((6, 8), np.float32), np.zeros((6, 8, 3), np.uint8)
    with refused(RenderError, "8-bit", "float32"):
        splat([view_of(camera, depth, image.astype(np.float32))], camera, near=0.2, extras=[depth])
    with refused(RenderError, "8-bit", "(H, W, 3)", "(6, 8)"):
        splat([view_of(camera, depth, image[..., 0])], camera, near=0.2)
    with refused(RenderError, "extra feature", "6 x 8"):
        splat([view_of(camera, depth, image)], camera, near=0.2, extras=[depth[:5]])
    with refused(RenderError, "2 of 1"):
        splat([view_of(camera, depth, image)], camera, near=0.2, extras=[depth, depth])
