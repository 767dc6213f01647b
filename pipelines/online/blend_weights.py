"""Where the weights of the blending network come from: those that ship, one file per guidance, or a file of the user."""

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path

import torch
from safetensors import SafetensorError
from safetensors.torch import load_file

from ggvs_eval.errors import WeightsError
from ggvs_eval.pipelines.online.blend_maps import Guidance
from ggvs_eval.pipelines.online.blend_network import BEYOND_VIEWS, BlendConfig, BlendNetwork
from ggvs_eval.pipelines.online.network_inputs import channel_count

MOST_SCALE = 8  # of a weights file, lest a wrong one asks for anything
SUFFIXES: dict[Guidance, str] = {"registered": "", "channels": "-as-printed", "none": "-no-tsdf", "naive": "-naive"}


def weights_name(guidance: Guidance) -> str:
    """Name of a network's weights, without file suffix."""
    return f"blend{SUFFIXES[guidance]}"


def shipped_blend_weights(guidance: Guidance = "registered") -> Path:
    """File of the weights that ship.

    Raises:
        WeightsError: none ship for that guidance.
    """
    folder = Path(str(resources.files("ggvs_eval.pipelines") / "weights"))
    path = folder / f"{weights_name(guidance)}.safetensors"
    if not path.is_file():
        known = ", ".join(sorted(file.name for file in folder.glob("blend*.safetensors"))) or "none"
        raise WeightsError(
            f"no blending network with {guidance} guidance ships (wanted {path.name}, there are: {known}); "
            "train one (ggvs-eval train blend)"
        )
    return path


@lru_cache(maxsize=4)
def load_blend_network(path: Path) -> BlendNetwork:
    """The network of a weights file, in evaluation mode; its configuration is known from the tensors' shapes.

    Args:
        path: safetensors, nothing else.

    Raises:
        WeightsError: absent, damaged, or tensors of no blending network.
    """
    tensors = _read(path)
    network = BlendNetwork(_configuration(tensors, path))
    network.load_state_dict({name: tensor.float() for name, tensor in tensors.items()})
    # Channels that lie side by side are convolved twice as fast.
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _read(path: Path) -> dict[str, torch.Tensor]:
    try:
        return load_file(path)
    except OSError as error:
        raise WeightsError(f"{path}: wanted weights of a blending network, got no readable file ({error.strerror})") from error
    except SafetensorError as error:
        raise WeightsError(f"{path}: damaged, or not safetensors ({error}); fetch it again") from error


def _configuration(tensors: Mapping[str, torch.Tensor], path: Path) -> BlendConfig:
    """The configuration whose parameters these are: by names, shapes and the scale that is kept among them."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    first, last = shapes.get("unet.down.0.0.weight", ()), shapes.get("unet.last.weight", ())
    scale = int(tensors["scale"]) if shapes.get("scale") == () else 0
    if len(first) != 4 or len(last) != 4 or not 1 <= scale <= MOST_SCALE:
        raise WeightsError(f"{path}: {len(shapes)} tensors of no blending network; give weights that `train blend` wrote")
    views = last[0] - BEYOND_VIEWS
    for guidance in SUFFIXES:
        config = BlendConfig(views, guidance, first[0], scale)
        if views > 0 and config.inputs == first[1]:
            _check_shapes(shapes, config, path)
            return config
    raise WeightsError(
        f"{path}: {last[0]} outputs, {views} views, want {channel_count(views, 'registered')} inputs, "
        f"{channel_count(views, 'channels')} as printed, {channel_count(views, 'none')} without TSDF guidance or "
        f"{channel_count(views, 'naive')} without depth, got {first[1]}; give weights that `train blend` wrote"
    )


def _check_shapes(shapes: Mapping[str, tuple[int, ...]], config: BlendConfig, path: Path) -> None:
    with torch.device("meta"):
        wanted = {name: tuple(tensor.shape) for name, tensor in BlendNetwork(config).state_dict().items()}
    different = sorted(name for name in shapes.keys() | wanted.keys() if shapes.get(name) != wanted.get(name))
    if different:
        name = different[0]
        raise WeightsError(
            f"{path}: {len(different)} tensors differ from a blending network of width {config.width}, first {name}: "
            f"{shapes.get(name)}, wanted {wanted.get(name)}; give weights that `train blend` wrote"
        )
