"""Our LZF encoder: h5py reads back what it wrote, and equal content gives equal bytes."""

import h5py
import numpy as np
import pytest

from ggvs_eval.synthetic.d3dmv_scene import create_lzf, encode_lzf, write_chunk

RNG = np.random.default_rng(3)
NOISE = RNG.integers(0, 256, (48, 64, 3), np.uint8)
GROUND = np.zeros((48, 64, 3), np.uint8)
CUT_OUT = np.where(np.arange(64)[:, None] > 40, NOISE, GROUND)
IMAGES = {
    "noise": NOISE,
    "ground": GROUND,
    "another ground": GROUND + np.uint8(7),
    "cut-out": np.where(np.arange(48)[:, None, None] > 30, NOISE, GROUND),
    "cut-out in columns": CUT_OUT,
    "not whole blocks": CUT_OUT[:37, :51],
    "less than a block": CUT_OUT[:5, 39:44],
    "one pixel": NOISE[:1, :1],
}


def written(path, image):
    """What h5py reads of an image written as two chunks, and how many bytes each chunk takes."""
    with h5py.File(path, "w") as file:
        dataset = create_lzf(file, "rgb", (1, 2, *image.shape), (1, 1, *image.shape))
        write_chunk(dataset, (0, 1), image)
        write_chunk(dataset, (0, 0), image)
    with h5py.File(path) as file:
        return file["rgb"][0], file["rgb"].id.get_storage_size() // 2


@pytest.mark.parametrize("name", IMAGES)
def test_h5py_reads_what_was_written(tmp_path, name):
    """Every image comes back bit for bit, whatever its size and content, and never takes more than
    its own bytes.
    """
    read, stored = written(tmp_path / "images.h5", IMAGES[name])

    np.testing.assert_array_equal(read, np.stack([IMAGES[name]] * 2))
    assert stored <= IMAGES[name].size


def test_a_black_ground_takes_little_room(tmp_path):
    """An empty image shrinks to a twentieth, one that is two thirds empty to less than a half,
    noise is stored as it is.
    """
    stored = {
        name: written(tmp_path / f"{name}.h5", image)[1] / image.size
        for name, image in IMAGES.items()
    }

    assert stored["ground"] < 1 / 20
    assert stored["cut-out"] < 0.5
    assert stored["noise"] == 1.0


def test_encoding_is_the_known_one():
    """Equal bytes are 32 literals at a time and then references back by one of 256 bytes each; what
    is left is literals.
    """
    run = bytes([31]) + bytes([9]) * 32

    assert encode_lzf(np.full(3 * 256 + 2, 9, np.uint8)) == 8 * run + 2 * bytes(
        [0xE0, 247, 0]
    ) + bytes([1, 9, 9])
