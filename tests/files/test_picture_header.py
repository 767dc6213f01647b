"""What the header of a picture says of its colours."""

import numpy as np
import pytest
from PIL import Image, ImageCms

from ggvs_eval.files.picture_header import read_picture_header


@pytest.mark.parametrize("suffix", [".png", ".jpg"])
def test_a_colour_profile_is_named(tmp_path, suffix):
    """Other than sRGB's it is a change by reading; none, and sRGB's, are not."""
    picture = Image.fromarray(np.full((48, 64, 3), 120, np.uint8))
    lab, srgb = (ImageCms.ImageCmsProfile(ImageCms.createProfile(kind)) for kind in ("XYZ", "sRGB"))
    for name, profile in (("other", lab), ("srgb", srgb)):
        picture.save(tmp_path / f"{name}{suffix}", icc_profile=profile.tobytes())
    picture.save(tmp_path / f"plain{suffix}")

    header = read_picture_header(tmp_path / f"other{suffix}")

    assert header.profile == ImageCms.getProfileDescription(lab).strip()
    assert header.conversions == [
        f"as if they were sRGB, though their colour profile is {header.profile}"
    ]
    for name in ("srgb", "plain"):
        assert read_picture_header(tmp_path / f"{name}{suffix}").conversions == []
