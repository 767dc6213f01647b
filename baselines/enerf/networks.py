"""ENeRF's networks and where their weights come from."""

from pathlib import Path

from torch import nn

from ggvs_eval.baselines.enerf.cost_network import CostNetwork
from ggvs_eval.baselines.enerf.feature_network import FeatureNetwork
from ggvs_eval.baselines.enerf.radiance_network import RadianceNetwork
from ggvs_eval.weights_file import pour_strictly, read_tensors


class Networks(nn.Module):
    """All that is trained, under the names of the published checkpoint; `nerf_0` only served its training."""

    def __init__(self) -> None:
        super().__init__()
        self.feature_net = FeatureNetwork()
        self.cost_reg_0 = CostNetwork(32, deep=False)
        self.nerf_0 = RadianceNetwork(32)
        self.cost_reg_1 = CostNetwork(16, deep=True)
        self.nerf_1 = RadianceNetwork(8)


def load_enerf(path: Path) -> Networks:
    """The networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net``, or safetensors whose names begin so.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of another network.
    """
    networks = Networks()
    pour_strictly(read_tensors(path, "net", of="ENeRF"), networks, path, "ENeRF")
    return networks.eval().requires_grad_(False)
