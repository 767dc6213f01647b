"""IBRNet's three networks and where their weights come from."""

from dataclasses import dataclass
from pathlib import Path

from torch import nn

from ggvs_eval.baselines.configuration import FULL, configuration_of
from ggvs_eval.baselines.ibrnet.feature_network import FeatureNetwork
from ggvs_eval.baselines.ibrnet.ray_network import RayNetwork
from ggvs_eval.files.weights_file import load_strict, read_tensors

PARTS = ("net_coarse", "net_fine", "feature_net")  # as the checkpoint calls them


@dataclass(frozen=True)
class IbrnetOptions:
    """Shape of the networks, and how finely a ray is sampled.

    Attributes:
        width: channels of the feature network's first stage.
        blocks: residual blocks of its stages.
        samples: of the coarse pass of a ray; the fine pass adds as many.
    """

    width: int = 64
    blocks: tuple[int, int, int] = (3, 4, 6)
    samples: int = 64


CONFIGURATIONS = {"full": IbrnetOptions(), "compact": IbrnetOptions(16, (2, 2, 2), 32)}


class Networks(nn.Module):
    """All that is trained, under the names of the published checkpoint's three state dicts.

    Args:
        configuration: which of `CONFIGURATIONS`.
    """

    def __init__(self, configuration: str = FULL) -> None:
        super().__init__()
        self.configuration = configuration
        self.config = config = CONFIGURATIONS[configuration]
        self.net_coarse = RayNetwork()
        self.net_fine = RayNetwork()
        self.feature_net = FeatureNetwork(config.width, config.blocks)


def load_ibrnet(path: Path) -> Networks:
    """The networks of a weights file, in evaluation mode.

    Args:
        path: the authors' checkpoint, a dict with ``net_coarse``, ``net_fine`` and ``feature_net``, or safetensors whose names
            begin so.

    Raises:
        WeightsError: absent, damaged, more than tensors inside, or tensors of another network.
    """
    networks = Networks(configuration_of(path, CONFIGURATIONS, "IBRNet") or FULL)
    for part in PARTS:
        of = f"IBRNet's {part}"
        load_strict(read_tensors(path, part, of=of), networks.get_submodule(part), path, of)
    return networks.eval().requires_grad_(False)
