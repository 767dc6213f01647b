"""Weights files: what is read from each format, what is refused, and that no file runs code."""

from pathlib import Path

import pytest
import torch
from safetensors.torch import save_file
from torch import nn

from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import configuration_of, load_strict, read_tensors, require_shapes
from helpers.hostile import Hostile
from helpers.refusals import refused

NETWORK = "a network of one convolution"


def small_network() -> nn.Module:
    """A convolution and its statistics: floating-point tensors and one whole number."""
    torch.manual_seed(3)
    return nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))


@pytest.fixture(scope="module")
def tensors() -> dict[str, torch.Tensor]:
    """Those of the small network."""
    return small_network().state_dict()


def assert_equal(found: dict[str, torch.Tensor], wanted: dict[str, torch.Tensor]) -> None:
    """Same names, same bits."""
    assert found.keys() == wanted.keys()
    assert all(
        torch.equal(found[name], wanted[name]) and found[name].dtype == wanted[name].dtype
        for name in wanted
    )


def write(path: Path, tensors: dict[str, torch.Tensor]) -> Path:
    """A file in the format of its suffix; ``.old.pth`` is torch's format before it was a zip
    archive.
    """
    if path.suffix == ".safetensors":
        save_file(tensors, path)
    else:
        torch.save(tensors, path, _use_new_zipfile_serialization=".old" not in path.name)
    return path


FORMATS = ("weights.safetensors", "weights.pth", "weights.old.pth", "weights.ckpt")


@pytest.mark.parametrize("name", FORMATS)
@pytest.mark.parametrize("parallel", ["", "module."])
def test_every_format_gives_the_tensors_that_were_written(name, parallel, tensors, tmp_path):
    """Safetensors and torch's formats, names with and without DataParallel's prefix: equal names,
    equal bits.
    """
    path = write(tmp_path / name, {parallel + key: tensor for key, tensor in tensors.items()})

    assert_equal(read_tensors(path), tensors)


def test_a_state_dict_is_found_under_its_keys(tensors, tmp_path):
    """A checkpoint's mappings are followed key by key, whatever else lies beside; safetensors by
    the keys with dots.
    """
    prefixed = {f"module.{name}": tensor for name, tensor in tensors.items()}
    torch.save(
        {"step": 7, "model": {"net": prefixed, "other": {"x": torch.zeros(1)}}},
        tmp_path / "nested.pth",
    )
    dotted = {f"model.net.{name}": tensor for name, tensor in prefixed.items()}
    save_file({**dotted, "model.other.x": torch.zeros(1)}, tmp_path / "nested.safetensors")

    for name in ("nested.pth", "nested.safetensors"):
        assert_equal(read_tensors(tmp_path / name, "model", "net"), tensors)


def test_absent_keys_are_refused_by_name(tensors, tmp_path):
    """A missing key is told with those that there are; a key whose value is no state dict with what
    it is.
    """
    torch.save({"net": tensors, "epoch": 3, "ema": {"decay": 0.9}}, tmp_path / "a.pth")
    save_file(tensors, tmp_path / "a.safetensors")

    for keys, message in (
        (("model",), r"a\.pth: wanted a state dict under model, got net, epoch, ema"),
        (("epoch", "net"), r"a\.pth: wanted a state dict under epoch/net, got int"),
        (
            ("ema",),
            r"a\.pth: wanted a state dict \(name -> tensor\) under ema, got a dict with non-tensor "
            r"values",
        ),
        ((), r"a\.pth: wanted a state dict \(name -> tensor\), got a dict with non-tensor values"),
    ):
        with pytest.raises(WeightsError, match=message):
            read_tensors(tmp_path / "a.pth", *keys)
    with refused(WeightsError, "a.safetensors", "under model", "got none", NETWORK):
        read_tensors(tmp_path / "a.safetensors", "model", model=NETWORK)


@pytest.mark.parametrize("name", FORMATS)
def test_no_part_of_a_file_passes_for_the_file(name, tensors, tmp_path):
    """Cut anywhere, down to nothing: refused in one line that names the file, by no other error
    than ours.
    """
    content = write(tmp_path / name, tensors).read_bytes()
    cut = tmp_path / f"cut.{name}"
    for length in (*range(0, len(content), max(1, len(content) // 60)), len(content) - 1):
        cut.write_bytes(content[:length])
        with pytest.raises(
            WeightsError,
            match=rf"cut\.{name}: (damaged, or not safetensors|wanted a file of tensors only)",
        ):
            read_tensors(cut)


@pytest.mark.parametrize(
    "value", [5, torch.zeros(3), [torch.zeros(3)], {"a": 3}, {1: torch.zeros(3)}]
)
def test_a_checkpoint_of_other_things_is_refused(value, tmp_path):
    """Readable, but no mapping from names to tensors."""
    torch.save(value, tmp_path / "other.pth")

    with refused(WeightsError, "other.pth", "state dict"):
        read_tensors(tmp_path / "other.pth")


@pytest.mark.parametrize("suffix", ["pth", "safetensors"])
def test_absent_files_and_folders_are_refused(suffix, tmp_path):
    """Both say whose weights were wanted and name the path."""
    (tmp_path / f"folder.{suffix}").mkdir()

    for name in ("absent", "folder"):
        with refused(WeightsError, f"{name}.{suffix}", NETWORK):
            read_tensors(tmp_path / f"{name}.{suffix}", model=NETWORK)


@pytest.mark.parametrize("name", ["hostile.pth", "hostile.old.pth", "hostile.safetensors"])
def test_no_file_runs_code(name, tmp_path):
    """A pickle that would call a function is refused under any name, and has called nothing."""
    torch.save(
        {"a": torch.zeros(1), "b": Hostile(tmp_path / "ran")},
        tmp_path / name,
        _use_new_zipfile_serialization=".old" not in name,
    )

    with pytest.raises(
        WeightsError, match=r"wanted a file of tensors only|damaged, or not safetensors"
    ):
        read_tensors(tmp_path / name)
    assert not (tmp_path / "ran").exists()
    with (tmp_path / name).open("rb") as file:
        torch.load(file, weights_only=False)
    assert (tmp_path / "ran").exists()  # unguarded it would have run


def test_poured_weights_are_the_files(tensors, tmp_path):
    """Single precision arrives bit for bit; half precision is widened, whole numbers stay whole."""
    half = {
        name: tensor.half() if tensor.is_floating_point() else tensor + 7
        for name, tensor in tensors.items()
    }
    for stored in (tensors, half):
        network = nn.Sequential(nn.Conv2d(3, 4, 3), nn.BatchNorm2d(4))
        load_strict(stored, network, tmp_path, NETWORK)
        assert_equal(
            network.state_dict(),
            {
                name: tensor.float() if tensor.is_floating_point() else tensor
                for name, tensor in stored.items()
            },
        )


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            {"0.bias": torch.zeros(5)},
            r"1 tensors differ from .*, first 0\.bias: wanted \(4,\), got \(5,\)",
        ),
        (
            {"0.weight": torch.zeros(4, 27)},
            r"1 tensors differ from .*, first 0\.weight: wanted \(4, 3, 3, 3\), got \(4, 27\)",
        ),
        (
            {"2.weight": torch.zeros(1)},
            r"1 tensors differ from .*, first 2\.weight: wanted None, got \(1,\)",
        ),
        (
            {"0.bias": None, "1.bias": None},
            r"2 tensors differ from .*, first 0\.bias: wanted \(4,\), got None",
        ),
    ],
)
def test_other_shapes_and_names_are_refused(change, message, tensors, tmp_path):
    """Wrong, additional and missing tensors are counted, the first is named with both shapes; the
    network keeps its weights.
    """
    stored = {name: tensor for name, tensor in (tensors | change).items() if tensor is not None}
    network = small_network()
    with torch.device("meta"):
        weightless = small_network()

    for refuse, given in ((load_strict, network), (require_shapes, weightless)):
        with pytest.raises(WeightsError, match=rf"any\.pth: {message}; give weights of {NETWORK}"):
            refuse(stored, given, tmp_path / "any.pth", NETWORK)
    assert_equal(network.state_dict(), tensors)


def test_weights_of_an_unknown_configuration_are_refused(tmp_path: Path) -> None:
    """A name that this version does not have is refused in one line; a file that says nothing is
    the full configuration.
    """
    save_file({"a": torch.zeros(1)}, tmp_path / "new.safetensors", {"configuration": "tiny"})
    save_file({"a": torch.zeros(1)}, tmp_path / "old.safetensors")
    with refused(WeightsError, "new.safetensors", "full, compact", "tiny"):
        configuration_of(tmp_path / "new.safetensors", ("full", "compact"), "FWD")
    assert configuration_of(tmp_path / "old.safetensors", ("full",), "FWD") is None
    assert configuration_of(tmp_path / "authors.pth", ("full",), "FWD") is None
