"""Weights files of the blending network: those that ship, one per guidance, or a file of the user."""

from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path

import torch

from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors, require_shapes
from ggvs_eval.pipelines.online.blend_network import BEYOND_VIEWS, BlendNetwork, BlendNetworkOptions
from ggvs_eval.pipelines.online.network_inputs import Guidance, channel_count
from ggvs_eval.pipelines.online.refiner import EVIDENCE

NETWORK = "a blending network"  # in messages
CPU = torch.device("cpu")
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
        file_names = ", ".join(sorted(file.name for file in folder.glob("blend*.safetensors"))) or "none"
        raise WeightsError(
            f"no blending network with {guidance} guidance ships (wanted {path.name}, there are: {file_names}); "
            "train one (ggvs-eval train blend)"
        )
    return path


@lru_cache(maxsize=4)
def load_blend_network(path: Path, device: torch.device = CPU) -> BlendNetwork:
    """The network of a weights file, in evaluation mode; its configuration is known from the tensors' shapes.

    Args:
        path: safetensors, or a torch checkpoint that is a state dict.
        device: where the network shall lie.

    Raises:
        WeightsError: absent, damaged, or tensors of no blending network.
    """
    tensors = BlendNetwork.completed(read_tensors(path, of=NETWORK))
    network = BlendNetwork(_configuration(tensors, path))
    load_strict(tensors, network, path, NETWORK)
    if device.type != "cpu":
        return network.eval().to(device)
    # Channels that lie side by side are convolved twice as fast.
    return network.eval().to(memory_format=torch.channels_last)  # type: ignore[call-overload]


def _configuration(tensors: Mapping[str, torch.Tensor], path: Path) -> BlendNetworkOptions:
    """The configuration whose parameters these are: by names, shapes and the scale that is kept among them."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    first, last = shapes.get("unet.down.0.0.weight", ()), shapes.get("unet.last.weight", ())
    scale = int(tensors["scale"]) if shapes.get("scale") == () else 0
    if len(first) != 4 or len(last) != 4 or not 1 <= scale <= MOST_SCALE:
        raise WeightsError(f"{path}: {len(shapes)} tensors of no blending network; give weights that `train blend` wrote")
    looks = shapes.get("refiner.looks.0.weight", ())
    features = looks[1] - EVIDENCE if len(looks) == 4 else 0
    views = last[0] - BEYOND_VIEWS - features
    for guidance in SUFFIXES:
        config = BlendNetworkOptions(views, guidance, first[0], scale, features)
        if views > 0 and config.inputs == first[1]:
            with torch.device("meta"):  # a wrong file may ask for any width
                network = BlendNetwork(config)
            require_shapes(tensors, network, path, f"{NETWORK} of width {config.width}")
            return config
    raise WeightsError(
        f"{path}: {last[0]} outputs, {views} views, want {channel_count(views, 'registered')} inputs, "
        f"{channel_count(views, 'channels')} as printed, {channel_count(views, 'none')} without TSDF guidance or "
        f"{channel_count(views, 'naive')} without depth, got {first[1]}; give weights that `train blend` wrote"
    )
