"""Packed maps: what goes in comes out, and files of other makers are read as they are."""

import io

import numpy as np
import pytest

from ggvs_eval.files.packed_maps import unpack, write_packed


def packed(**maps) -> dict[str, np.ndarray]:
    """The members of the archive that holds these maps."""
    file = io.BytesIO()
    write_packed(file, maps)
    file.seek(0)
    with np.load(file, allow_pickle=False) as members:
        return dict(members)


@pytest.mark.parametrize("shape", [(1, 1), (7, 3), (60, 80)])
def test_every_bit_comes_back(shape):
    """Numbers that are none and views with strides too."""
    random = np.random.default_rng(0)
    depth = random.uniform(0, 9, (shape[1], shape[0])).astype(np.float32).T
    depth[0, 0] = np.nan
    confidence = random.integers(0, 256, shape, np.uint8)

    maps = unpack(packed(depth=depth, confidence=confidence))

    assert list(maps) == ["depth", "confidence"]
    assert np.array_equal(
        maps["depth"].view(np.uint32), np.ascontiguousarray(depth).view(np.uint32)
    )
    assert np.array_equal(maps["confidence"], confidence)


def test_smooth_depth_takes_half():
    rows, columns = np.mgrid[:200, :300].astype(np.float32)
    depth = (3 + rows / 200 + np.sin(columns / 40)).astype(np.float32)
    assert sum(each.nbytes for each in packed(depth=depth).values()) < 0.6 * depth.nbytes


def test_plain_arrays_stay_as_they_are():
    """Also where one of them is called like ours."""
    members = {"depth": np.ones((2, 3), np.float32), "size": np.array([5, 5])}
    assert unpack(members) == members


@pytest.mark.parametrize(
    "change",
    [
        {"size": np.array([600, 80])},
        {"size": np.array([2**20, 2**20])},
        {"depth.float32.zstd": np.zeros(9, np.uint8)},
    ],
)
def test_damage_is_an_error(change):
    with pytest.raises((ValueError, OSError)):
        unpack(packed(depth=np.ones((60, 80), np.float32)) | change)
