"""Every reading of the paper is an option: ours and the others do what their names say."""

import numpy as np
import pytest

from ggvs_eval.camera import Camera
from ggvs_eval.errors import RenderError
from ggvs_eval.geometry.difference_mask import difference_mask
from ggvs_eval.geometry.splat import Splat, splat, splat_points
from ggvs_eval.geometry.tsdf import PreviousDepth, ray_march
from ggvs_eval.method import SourceView
from ggvs_eval.pipelines.methods.registry import find_method
from ggvs_eval.pipelines.online.blending import GeometricBlender
from ggvs_eval.pipelines.online.geometry_guided import GeometryGuided, OnlineOptions, target_mask
from ggvs_eval.pipelines.online.printed_march import FieldReading, printed_march
from helpers.geometry_scenes import view_of
from helpers.scenes import SQUARE_Z, camera_at, instant, look

TARGET = camera_at(0.0, name="target")
SOURCES = [camera_at(-0.15), camera_at(0.15), camera_at(-0.45), camera_at(0.45)]
TAU = 0.05


def weighted_depths(weight: float = 1.0) -> tuple[list[Camera], list[np.ndarray], list[np.ndarray]]:
    """Cameras, depths and weights of the sources."""
    depths = [look(camera)[1] for camera in SOURCES]
    return SOURCES, depths, [np.full_like(depth, weight) for depth in depths]


def view_from(camera: Camera) -> SourceView:
    image, depth = look(camera)
    return view_of(camera, depth, image.astype(np.float32) / 255)


def test_points_in_their_own_camera_are_the_image():
    """Points seen from where they come from are the source itself: colour and depth exact, nothing
    uncovered.
    """
    source = view_from(TARGET)

    seen = splat_points(source, TARGET, near=0.5)

    np.testing.assert_array_equal(seen.features, source.image)
    np.testing.assert_allclose(seen.depth, source.depth, rtol=1e-6)
    assert (seen.alpha == np.float32(0.99)).all()


def test_the_nearest_point_of_a_pixel_is_seen():
    """Of two points that fall into one pixel the nearer is seen, whichever comes first; unknown
    depth gives none.
    """
    small = camera_at(0.0, width=4, height=2).resized(2, 1)
    depth = np.array([[4.0, 2.0, 0.0, 3.0], [0.0, 0.0, 0.0, 0.0]], np.float32)
    features = np.arange(8, dtype=np.float32).reshape(2, 4, 1)
    source = view_of(camera_at(0.0, width=4, height=2), depth, features)

    seen = splat_points(source, small, near=0.5)

    np.testing.assert_array_equal(seen.features[..., 0], [[1.0, 3.0]])
    np.testing.assert_array_equal(seen.depth, [[2.0, 3.0]])


def test_points_at_or_before_the_near_plane_are_left_out():
    """The near plane culls points as it culls Gaussians; one that is no plane is refused."""
    source = view_from(TARGET)
    seen = splat_points(source, TARGET, near=SQUARE_Z)

    np.testing.assert_array_equal(seen.alpha > 0, source.depth > SQUARE_Z)
    with pytest.raises(RenderError, match="near must be positive"):
        splat_points(source, TARGET, near=0.0)


@pytest.mark.slow
def test_the_slow_march_is_the_fast_one_in_our_reading():
    """With our reading both marches find the same surface, with a previous depth in the
    field too.
    """
    views = weighted_depths(0.7)
    previous = ray_march(camera_at(0.03), *weighted_depths(), tau=TAU)
    gain = np.full((TARGET.height, TARGET.width), 0.4, np.float32)
    held = PreviousDepth(camera_at(0.03), previous.depth, previous.weight, gain, 15.0)

    for before in (None, held):
        fast = ray_march(TARGET, *views, tau=TAU, previous=before)
        slow = printed_march(TARGET, *views, tau=TAU, previous=before, reading=FieldReading())
        close = (np.abs(fast.depth - slow.depth) < 0.02 * TAU) & (
            np.abs(fast.weight - slow.weight) < 1e-3
        )
        assert close.mean() > 0.99


def test_masks_of_several_views_become_one():
    """The largest of the masks that cover a pixel, or their mean; 1 where none covers it."""
    alphas, masks = ([0.9, 0.9, 0.2], [0.9, 0.2, 0.2]), ([0.6, 0.6, 0.6], [1.0, 0.7, 0.9])
    splats = [
        Splat(
            np.float32([[[0, 0, 0, value] for value in mask]]),
            np.float32([alpha]),
            np.ones((1, 3), np.float32),
        )
        for alpha, mask in zip(alphas, masks, strict=True)
    ]

    np.testing.assert_allclose(target_mask(splats), [[1.0, 0.6, 1.0]])
    np.testing.assert_allclose(target_mask(splats, "mean"), [[0.8, 0.6, 1.0]])


def test_a_mask_of_zero_is_a_mask():
    """With a least weight of 0 what stands still has the mask 0, and is covered nevertheless."""
    splat = Splat(
        np.zeros((1, 2, 4), np.float32), np.float32([[0.9, 0.2]]), np.ones((1, 2), np.float32)
    )
    for views in ("largest", "mean"):
        np.testing.assert_array_equal(target_mask([splat], views), [[0.0, 1.0]])


def test_channels_of_a_difference_become_one():
    """Red alone changes by 60 levels: the largest is 60 / 255, the mean a third of it (Eq. 1)."""
    before = np.full((32, 32, 3), 100, np.uint8)
    after = before + np.array([60, 0, 0], np.uint8)

    np.testing.assert_allclose(difference_mask(after, before), 60 / 255 / 0.7 + 0.6, atol=1e-6)
    np.testing.assert_allclose(
        difference_mask(after, before, channels="mean"), 20 / 255 / 0.7 + 0.6, atol=1e-6
    )


def test_holes_stay_black_without_background():
    """What a camera far to the side does not show is black without background blending and filled
    with it; the rest is equal.
    """
    only = [camera_at(0.8)]
    images = {
        on: GeometryGuided(None, GeometricBlender(background=on))
        .step(instant(0, TARGET, only))
        .image
        for on in (True, False)
    }
    shown = splat(instant(0, TARGET, only).sources, TARGET, near=0.5).alpha
    holes = shown < 0.4

    assert 0.02 < holes.mean() < 0.5
    assert images[False][holes].max() == 0
    assert images[True][holes].min() > 0
    np.testing.assert_allclose(images[False][shown > 0.6], images[True][shown > 0.6], atol=1e-6)


def test_a_label_may_set_options():
    """`ours-geometric+beta_temporal=0.6+mask_views=mean` is the method with these two options, and
    says so.
    """
    spec = find_method("ours-geometric+beta_temporal=0.6+mask_views=mean+normalised_field=false")

    method = spec.make()
    assert isinstance(method, GeometryGuided)
    assert method.options == OnlineOptions(
        beta_temporal=0.6, mask_views="mean", normalised_field=False
    )
    assert (
        spec.title == "GGVS (online), geometric weights, beta_temporal=0.6, mask_views=mean, "
        "normalised_field=false"
    )
    assert spec.ours


@pytest.mark.parametrize(
    ("label", "message"),
    [
        ("ours-geometric+beta_temporl=0.6", "did you mean beta_temporal"),
        ("ours-geometric+mask_views=least", "must be one of 'largest', 'mean', got 'least'"),
        ("ours-geometric+temporal=0.5", "must be true or false, got 0.5"),
        ("ours-geometric+compensated=0.5", "must be true or false, got 0.5"),
        ("no-blending+tau_m=1", "No Blending has no option but scale, got tau_m"),
    ],
)
def test_options_that_are_none_are_refused(label, message):
    """A mistyped option, a value of the wrong kind, or a method that has none is refused in one
    line.
    """
    with pytest.raises(RenderError, match=message) as caught:
        find_method(label)
    assert "\n" not in str(caught.value)
