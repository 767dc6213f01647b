"""ENeRF's networks and where their weights come from."""

from pathlib import Path

from torch import nn

from ggvs_eval.baselines.configuration import FULL, configuration_of
from ggvs_eval.baselines.enerf.cost_network import CostNetwork
from ggvs_eval.baselines.enerf.feature_network import FeatureNetwork
from ggvs_eval.baselines.enerf.radiance_network import RadianceNetwork
from ggvs_eval.files.weights_file import load_strict, read_tensors

# Planes of the coarse volume: 64 of the published training, 32 of the authors' runs on real scenes.
COARSE_PLANES = {"full": 64, "compact": 32}


class Networks(nn.Module):
    """All that is trained, under the names of the published checkpoint; `nerf_0` only serves the training.

    Args:
        configuration: ``full``, or ``compact``, which has the same weights and fewer planes.
    """

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.coarse_planes = COARSE_PLANES[configuration]
        self.feature_net = FeatureNetwork()
        self.cost_reg_0 = CostNetwork(32, deep=False)
        self.nerf_0 = RadianceNetwork(32)
        self.cost_reg_1 = CostNetwork(16, deep=True)
        self.nerf_1 = RadianceNetwork(8)


def load_enerf(path: Path) -> Networks:
    """The networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net``, safetensors whose names begin so, or what our training wrote.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of another network.
    """
    configuration = configuration_of(path, COARSE_PLANES, "ENeRF")
    networks = Networks(configuration or FULL)
    tensors = read_tensors(path, *(() if configuration else ("net",)), of="ENeRF")
    load_strict(tensors, networks, path, "ENeRF")
    return networks.eval().requires_grad_(False)
