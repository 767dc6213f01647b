"""MVSplat as a method: each instant from its own source frames alone."""

from dataclasses import dataclass
from pathlib import Path

from ggvs_eval.compute_device import clock_s, compute_device, rendering_on
from ggvs_eval.contrib.more_baselines.mvsplat.gaussians import pixel_cloud, rendered_part
from ggvs_eval.contrib.more_baselines.mvsplat.network import MvsplatNetwork, load_network
from ggvs_eval.contrib.more_baselines.mvsplat.views import see_views
from ggvs_eval.errors import RenderError
from ggvs_eval.gaussians.cloud import GaussianCloud
from ggvs_eval.gaussians.render import render_gaussians
from ggvs_eval.method import Instant, Rendering

FEWEST_VIEWS = 2  # a cost volume compares one with another


@dataclass(frozen=True)
class Mvsplat:
    """MVSplat (Chen et al., ECCV 2024); depth maps are not used, nothing is remembered.

    Attributes:
        weights: file of its weights, see `load_network`.

    Reading:
        The authors render with the principal point in the middle of the image and in units of the
        nearest depth; here it stays where it is. Their weights were trained with two views and take
        more.
    """

    weights: Path
    device: str = "cpu"

    def __post_init__(self) -> None:
        """Refuse a device that is not there."""
        compute_device(self.device)

    def step(self, instant: Instant) -> Rendering:
        """Synthesise one instant."""
        if len(instant.sources) < FEWEST_VIEWS:
            raise RenderError(
                f"MVSplat wants at least {FEWEST_VIEWS} source views, got {len(instant.sources)}; "
                f"raise k in the protocol"
            )
        device = compute_device(self.device)
        network = load_network(self.weights, device)
        with rendering_on(device):
            started = clock_s(device)
            cloud = instant_cloud(network, instant)
            regressed = clock_s(device)
            picture = render_gaussians(cloud, instant.target, near=instant.near_plane)
            image, depth = (
                picture.image.clamp(max=1).numpy(force=True),
                picture.depth.numpy(force=True),
            )
        return Rendering(
            image, depth, {"network": regressed - started, "splat": clock_s(device) - regressed}
        )


def instant_cloud(network: MvsplatNetwork, instant: Instant) -> GaussianCloud:
    """Return the Gaussians of an instant's sources, as they are rendered.

    Gradients reach the network's parameters.
    """
    views = see_views(instant, network.config.size_multiple)
    cloud = pixel_cloud(network(views), views, network.config.published)
    return rendered_part(cloud) if network.config.published else cloud
