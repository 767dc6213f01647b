"""Where the weights of RAFT-Stereo come from: the compact network that ships, or a checkpoint of the authors."""

import hashlib
from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from pathlib import Path

import torch

from ggvs_eval.errors import WeightsError
from ggvs_eval.files.weights_file import load_strict, read_tensors
from ggvs_eval.pipelines.offline.stereo.raft_config import COMPACT, PUBLISHED, RaftOptions
from ggvs_eval.pipelines.offline.stereo.raft_stereo import RaftStereo

SHIPPED = "raft-compact.safetensors"
NETWORK = "RAFT-Stereo"  # in messages


def shipped_weights() -> Path:
    """File of the compact network's weights."""
    return Path(str(resources.files("ggvs_eval.pipelines") / "weights" / SHIPPED))


def weights_digest(path: Path) -> str:
    """sha256 of a weights file, part of a depth map's key.

    Raises:
        WeightsError: no such file.
    """
    try:
        return hashlib.sha256(path.read_bytes()).hexdigest()
    except OSError as error:
        raise WeightsError(f"{path}: wanted weights of {NETWORK}, got no readable file ({error.strerror})") from error


@lru_cache(maxsize=2)
def load_network(path: Path) -> RaftStereo:
    """The network of a weights file, in evaluation mode; its configuration is known from the tensors.

    Args:
        path: safetensors of ours, or a ``.pth`` of the authors: a state dict whose names may begin with ``module.``.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of no configuration of RAFT-Stereo.
    """
    tensors = read_tensors(path, of=NETWORK)
    network = RaftStereo(_configuration(tensors, path))
    load_strict(tensors, network, path, NETWORK)
    return network.eval()


def _configuration(tensors: Mapping[str, torch.Tensor], path: Path) -> RaftOptions:
    """The configuration whose parameters these are, by names and shapes."""
    shapes = {name: tuple(tensor.shape) for name, tensor in tensors.items()}
    nearest, fewest = "", len(shapes) + 1
    for title, config in {"compact": COMPACT, **PUBLISHED}.items():
        with torch.device("meta"):
            wanted = {name: tuple(tensor.shape) for name, tensor in RaftStereo(config).state_dict().items()}
        different = {name for name in shapes.keys() | wanted.keys() if shapes.get(name) != wanted.get(name)}
        if not different:
            return config
        if len(different) < fewest:
            name = min(different)
            nearest = f"{len(different)} differ from '{title}', first {name}: {shapes.get(name)}, wanted {wanted.get(name)}"
            fewest = len(different)
    raise WeightsError(f"{path}: {len(shapes)} tensors of no known RAFT-Stereo; {nearest or 'none of its names is known'}")
