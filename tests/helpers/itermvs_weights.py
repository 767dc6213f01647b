"""A checkpoint of IterMVS as its authors write it, with seeded weights."""

from pathlib import Path

import torch

from ggvs_eval.pipelines.offline.itermvs.network import IterMvsNetwork
from helpers.seeded_baselines import seed_weights


def write_checkpoint(path: Path, network: IterMvsNetwork | None = None) -> Path:
    """Write the weights of a network, by default those drawn by their names."""
    network = seed_weights(IterMvsNetwork()) if network is None else network
    state = {f"module.{name}": tensor for name, tensor in network.state_dict().items()}
    torch.save({"epoch": 15, "model": state, "optimizer": {"state": {}}}, path)
    return path
