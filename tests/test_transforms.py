"""Changes of frames are what they are called, and their inverse takes them back."""

import numpy as np
import pytest
from skimage import data

from ggvs_eval.transforms import TRANSFORMS

IMAGE = np.ascontiguousarray(data.astronaut()[60:132, 80:176])
SIZE = 96, 72
CHANGES = {
    "mirrored": ({"axes": (0, 1)}, 0),
    "channel order": ({"order": (2, 0, 1)}, 0),
    "shift": ({"shift_x_px": 2.0, "shift_y_px": -1.0}, 0),
    "value range": ({"slope": 0.86}, 1),
    "tone curve": ({"power": 1.2}, 2),
    "gain": ({"gain": 0.9}, 1),
    "focal length": ({"scale_x": 1.01, "scale_y": 1.01}, 6),
}


@pytest.mark.parametrize("name", CHANGES)
def test_what_is_done_is_taken_back(name):
    """Bit for bit where nothing is interpolated or rounded, but for the border."""
    values, most_255 = CHANGES[name]
    transform = TRANSFORMS[name](values, SIZE)
    changed = transform.apply(IMAGE)
    border_px = transform.border_px
    inner = slice(border_px, SIZE[1] - border_px), slice(border_px, SIZE[0] - border_px)
    errors = np.abs(transform.inverse(changed)[inner].astype(int) - IMAGE[inner])

    assert transform.is_exact == (most_255 == 0)
    assert np.quantile(errors, 0.99) <= most_255
    assert not np.array_equal(changed, IMAGE)


def test_a_shift_goes_to_the_right_and_downwards_and_an_enlargement_from_the_centre():
    """The signs are those of the doctor's findings."""
    right = TRANSFORMS["shift"]({"shift_x_px": 1.0, "shift_y_px": 0.0}, SIZE).apply(IMAGE)
    larger = TRANSFORMS["wrong resize"]({"scale_x": 3.0, "scale_y": 1.0}, (97, 72))
    middle = np.pad(IMAGE, ((0, 0), (0, 1), (0, 0)), mode="edge")

    assert np.array_equal(right[:, 1:], IMAGE[:, :-1])
    assert np.array_equal(larger.apply(middle)[:, 48 + 3 * 5], middle[:, 48 + 5])
    assert np.array_equal(
        TRANSFORMS["channel order"]({"order": (2, 0, 1)}, SIZE).apply(IMAGE), IMAGE[..., [1, 2, 0]]
    )
