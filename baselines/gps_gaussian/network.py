"""GPS-Gaussian as a whole: features of both images, stereo between them, Gaussians of every pixel."""

from torch import Tensor, nn

from ggvs_eval.baselines.gps_gaussian.encoders import Pyramid, PyramidEncoder
from ggvs_eval.baselines.gps_gaussian.regressor import GaussianMaps, GaussianRegressor
from ggvs_eval.baselines.gps_gaussian.stereo import Stereo

WIDTHS = (32, 48, 96)
SIZE_MULTIPLE = 8  # sides of the images are multiples of it
ITERATIONS = 3  # of the published network, in training and after


class GpsGaussianNetwork(nn.Module):
    """The network; parameters bear the names of the published checkpoint."""

    def __init__(self) -> None:
        super().__init__()
        self.img_encoder = PyramidEncoder(3, WIDTHS)
        self.raft_stereo = Stereo(WIDTHS[-1])
        self.gs_parm_regresser = GaussianRegressor(WIDTHS)

    def features(self, images: Tensor) -> Pyramid:
        """Features of a rectified pair (2, 3, H, W) in [-1, 1], left image first, at 1/2, 1/4 and 1/8 of the size."""
        pyramid: Pyramid = self.img_encoder(images)
        return pyramid

    def flow(self, features: Pyramid, iterations: int = ITERATIONS) -> Tensor:
        """Column of each pixel's match in the other image less its own, pixels, (2, 1, H, W)."""
        flow: Tensor = self.raft_stereo(features[2], iterations)
        return flow

    def gaussians(self, images: Tensor, inverse_depth: Tensor, features: Pyramid) -> GaussianMaps:
        """The Gaussian of every pixel; inverse depth is per metre, (2, 1, H, W), 0 = unknown."""
        maps: GaussianMaps = self.gs_parm_regresser(images, inverse_depth, features)
        return maps
