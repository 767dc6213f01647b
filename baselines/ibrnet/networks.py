"""IBRNet's three networks and where their weights come from."""

from pathlib import Path

from torch import nn

from ggvs_eval.baselines.ibrnet.feature_network import FeatureNetwork
from ggvs_eval.baselines.ibrnet.ray_network import RayNetwork
from ggvs_eval.weights_file import pour_strictly, read_tensors

PARTS = ("net_coarse", "net_fine", "feature_net")  # as the checkpoint calls them


class Networks(nn.Module):
    """All that is trained, under the names of the published checkpoint's three state dicts."""

    def __init__(self) -> None:
        super().__init__()
        self.net_coarse = RayNetwork()
        self.net_fine = RayNetwork()
        self.feature_net = FeatureNetwork()


def load_ibrnet(path: Path) -> Networks:
    """The networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net_coarse``, ``net_fine`` and ``feature_net``, or safetensors whose names
            begin so.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of another network.
    """
    networks = Networks()
    for part in PARTS:
        of = f"IBRNet's {part}"
        pour_strictly(read_tensors(path, part, of=of), networks.get_submodule(part), path, of)
    return networks.eval().requires_grad_(False)
