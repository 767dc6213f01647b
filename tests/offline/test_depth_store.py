"""The depth store: what is written is read, every input counts, damage is named."""

import json
import socket
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ggvs_eval.depth_store import DepthMap, DepthStore, describe_depth
from ggvs_eval.errors import DepthError
from helpers.refusals import refused
from helpers.stereo_scenes import look_from

CAMERA, PARTNER = look_from(0, 0, "a"), look_from(1, 0, "b")
DIGESTS = {"a": "1", "b": "2", "c": "3"}
OPTIONS = {"algorithm": "x 1", "partners": 1}


def make_map(seed: int = 0, shape: tuple[int, int] = (7, 9)) -> DepthMap:
    random = np.random.default_rng(seed)
    return DepthMap(
        random.uniform(0, 5, shape).astype(np.float32),
        random.uniform(0, 1, shape).astype(np.float32),
    )


@settings(deadline=None)
@given(seed=st.integers(0, 2**32 - 1), height=st.integers(1, 20), width=st.integers(1, 20))
def test_round_trip(tmp_path_factory, seed, height, width):
    """Depth comes back bit for bit, confidence within half of 1 / 255, for any size."""
    store = DepthStore(tmp_path_factory.mktemp("store"))
    written = make_map(seed, (height, width))
    store.write("key", 3, written)
    read = store.read("key", 3)
    assert np.array_equal(read.depth, written.depth)
    assert np.abs(read.confidence - written.confidence).max() <= 0.5 / 255 + 1e-6
    assert read.depth.dtype == read.confidence.dtype == np.float32


def test_what_is_there(tmp_path):
    """Only the instant that was written is there, and no temporary file is left."""
    store = DepthStore(tmp_path)
    store.write("key", 3, make_map())
    assert store.has("key", 3)
    assert not store.has("key", 2)
    assert not store.has("other", 3)
    assert [file.name for file in store.folder("key").iterdir()] == ["000003.npz"]


CHANGES = {
    "camera pose": lambda: describe_depth(look_from(0.001, 0, "a"), [PARTNER], DIGESTS, OPTIONS),
    "camera K": lambda: describe_depth(
        replace(CAMERA, K=CAMERA.K * [[1.001], [1], [1]]), [PARTNER], DIGESTS, OPTIONS
    ),
    "camera size": lambda: describe_depth(replace(CAMERA, width=100), [PARTNER], DIGESTS, OPTIONS),
    "near": lambda: describe_depth(replace(CAMERA, near=1.0), [PARTNER], DIGESTS, OPTIONS),
    "far": lambda: describe_depth(replace(CAMERA, far=100.0), [PARTNER], DIGESTS, OPTIONS),
    "camera frames": lambda: describe_depth(CAMERA, [PARTNER], DIGESTS | {"a": "9"}, OPTIONS),
    "partner frames": lambda: describe_depth(CAMERA, [PARTNER], DIGESTS | {"b": "9"}, OPTIONS),
    "partner pose": lambda: describe_depth(CAMERA, [look_from(1, 0.001, "b")], DIGESTS, OPTIONS),
    "another partner": lambda: describe_depth(
        CAMERA, [PARTNER, look_from(2, 0, "c")], DIGESTS, OPTIONS
    ),
    "options": lambda: describe_depth(CAMERA, [PARTNER], DIGESTS, OPTIONS | {"partners": 2}),
    "algorithm": lambda: describe_depth(CAMERA, [PARTNER], DIGESTS, OPTIONS | {"algorithm": "x 2"}),
}


@pytest.mark.parametrize("change", CHANGES)
def test_every_input_changes_the_key(change):
    """The key changes with each thing the depth depends on, and only then."""
    original = DepthStore.key(describe_depth(CAMERA, [PARTNER], DIGESTS, OPTIONS))
    assert (
        DepthStore.key(
            describe_depth(
                look_from(0, 0, "a"), [look_from(1, 0, "b")], dict(DIGESTS), dict(OPTIONS)
            )
        )
        == original
    )
    assert DepthStore.key(CHANGES[change]()) != original


def test_spec_is_readable(tmp_path):
    """The folder of a key says in JSON which cameras, frames and options it stands for."""
    store = DepthStore(tmp_path)
    key = store.write_spec(describe_depth(CAMERA, [PARTNER], DIGESTS, OPTIONS))
    record = json.loads((store.folder(key) / "job.json").read_text())
    assert record["sha256"] == key
    spec = record["identity"]
    assert spec["camera"]["name"] == "a"
    assert [partner["name"] for partner in spec["partners"]] == ["b"]
    assert spec["options"] == OPTIONS


def test_absent_map(tmp_path):
    """A map that is not stored is an error that names the file and the step that makes it."""
    with refused(DepthError, "000007.npz", "prepare"):
        DepthStore(tmp_path).read("key", 7)


@pytest.mark.parametrize("kept", [0, 10, 200, -30])
def test_truncated_map(tmp_path, kept):
    """A truncated file is an error that names the file and what to do with it."""
    store = DepthStore(tmp_path)
    store.write("key", 0, make_map())
    path = store.path("key", 0)
    path.write_bytes(path.read_bytes()[:kept])
    with refused(DepthError, "000000.npz", "move this file away"):
        store.read("key", 0)


@pytest.mark.parametrize(
    ("depth", "confidence"),
    [
        (np.ones((2, 2), np.float64), np.ones((2, 2), np.uint8)),
        (np.ones((2, 2), np.float32), np.ones((2, 3), np.uint8)),
        (np.full((2, 2), np.nan, np.float32), np.ones((2, 2), np.uint8)),
        (np.full((2, 2), -1, np.float32), np.ones((2, 2), np.uint8)),
        (np.array([[{"a": 1}]], dtype=object), np.ones((1, 1), np.uint8)),
    ],
)
def test_foreign_content(tmp_path, depth, confidence):
    """Wrong types, shapes and values are refused, and nothing is unpickled."""
    store = DepthStore(tmp_path)
    store.folder("key").mkdir()
    np.savez(store.path("key", 0), depth=depth, confidence=confidence)
    with refused(DepthError, "000000.npz", "move this file away"):
        store.read("key", 0)


def test_what_a_killed_process_was_writing_is_swept(tmp_path):
    """When the folder of a key is opened again, whichever instant it was."""
    store = DepthStore(tmp_path)
    key = store.write_spec({"camera": "a"})
    store.write(key, 1, make_map())
    left = (
        store.folder(key)
        / f".000002.npz.0a1b2c3d.{socket.gethostname().replace('.', '-')}.4194304000.tmp"
    )
    left.touch()

    store.write_spec({"camera": "a"})

    assert sorted(file.name for file in store.folder(key).iterdir()) == ["000001.npz", "job.json"]


@pytest.mark.parametrize("odd", [-1.2, np.nan, np.inf])
def test_what_is_no_depth_is_stored_as_unknown(tmp_path, odd):
    """Depth that is negative or not finite comes back as 0, with confidence 0; so does a guess."""
    store, depth_map = DepthStore(tmp_path), make_map()
    depth_map = replace(depth_map, guess=depth_map.depth + 1)
    depth_map.depth[2, 3], depth_map.guess[4, 5] = odd, odd

    store.write("key", 0, depth_map)
    found = store.read("key", 0)

    assert (found.depth[2, 3], found.confidence[2, 3], found.guess[4, 5]) == (0, 0, 0)
    assert np.count_nonzero(found.guess == 0) == 1


def test_a_clean_map_is_not_copied():
    """What holds no odd depth is the same object."""
    whole = make_map().clean()
    assert whole.clean() is whole
