"""A cloud of 3D Gaussians as the parameters that an optimiser moves."""

from dataclasses import dataclass, replace
from math import isqrt

import torch

from ggvs_eval.errors import RenderError

HIGHEST_DEGREE = 4  # of the spherical harmonics; files of 3D Gaussian splatting stop at 3, MVSplat predicts 4


@dataclass(frozen=True, eq=False)
class GaussianCloud:
    """Anisotropic Gaussians in the parameters of 3D Gaussian splatting (Kerbl et al. 2023), one row per Gaussian.

    Attributes:
        means: centres in the world, (N, 3).
        log_scales: natural logarithms of the standard deviations along the Gaussian's own axes, world units, (N, 3).
        quaternions: rotation from its own axes to the world, w first, of any length but 0, (N, 4).
        opacity_logits: opacity before the sigmoid, (N,).
        sh: coefficients of the colour's spherical harmonics, constant one first, (N, (degree + 1)^2, 3).

    Raises:
        RenderError: the shapes do not fit each other, or the tensors differ in device or in kind of float.

    Examples:
        >>> cloud = GaussianCloud.of_points(torch.zeros(5, 3), torch.full((5, 3), 0.5), scale=0.1)
        >>> len(cloud), cloud.degree
        (5, 0)
    """

    means: torch.Tensor
    log_scales: torch.Tensor
    quaternions: torch.Tensor
    opacity_logits: torch.Tensor
    sh: torch.Tensor

    def __post_init__(self) -> None:
        """Refuse tensors that are no cloud together."""
        count = self.means.shape[0] if self.means.ndim else 0
        terms = self.sh.shape[1] if self.sh.ndim == 3 else 0
        if terms not in [(degree + 1) ** 2 for degree in range(HIGHEST_DEGREE + 1)]:
            raise RenderError(
                f"cloud of Gaussians: wanted sh (N, (degree + 1)^2, 3) of degree 0 to {HIGHEST_DEGREE}, got "
                f"{tuple(self.sh.shape)}"
            )
        shapes = {"means": (3,), "log_scales": (3,), "quaternions": (4,), "opacity_logits": (), "sh": (terms, 3)}
        for name, shape in shapes.items():
            tensor = getattr(self, name)
            if tensor.shape != (count, *shape):
                raise RenderError(f"cloud of Gaussians: wanted {name} {(count, *shape)}, got {tuple(tensor.shape)}")
            if tensor.device != self.means.device or tensor.dtype != self.means.dtype or not tensor.is_floating_point():
                raise RenderError(
                    f"cloud of Gaussians: wanted {name} in {self.means.dtype} on {self.means.device} like the means, got "
                    f"{tensor.dtype} on {tensor.device}"
                )

    def __len__(self) -> int:
        """Number of Gaussians."""
        return self.means.shape[0]

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 for a colour that is the same from everywhere."""
        return isqrt(self.sh.shape[1]) - 1

    def parameters(self) -> dict[str, torch.Tensor]:
        """The five tensors by name, in the order of the fields."""
        return {name: getattr(self, name) for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")}

    def to(self, device: torch.device | str | None = None, dtype: torch.dtype | None = None) -> "GaussianCloud":
        """The cloud on another device or in another kind of float."""
        return replace(self, **{name: tensor.to(device=device, dtype=dtype) for name, tensor in self.parameters().items()})

    @classmethod
    def of_points(
        cls, means: torch.Tensor, colours: torch.Tensor, *, scale: float | torch.Tensor, opacity: float = 0.1, degree: int = 0
    ) -> "GaussianCloud":
        """Round Gaussians of given colours, the same from everywhere.

        Args:
            means: (N, 3), world units.
            colours: (N, 3), in [0, 1].
            scale: standard deviation, world units; one number or (N,).
            opacity: in (0, 1).
            degree: of the spherical harmonics; terms above the first are 0.
        """
        from ggvs_eval.gaussians.harmonics import coefficients_of

        count = len(means)
        quaternions = means.new_zeros(count, 4)
        quaternions[:, 0] = 1
        sh = means.new_zeros(count, (degree + 1) ** 2, 3)
        sh[:, 0] = coefficients_of(colours)
        scales = torch.as_tensor(scale, dtype=means.dtype, device=means.device).reshape(-1, 1)
        log_scales = scales.log() * means.new_ones(count, 3)
        logits = torch.logit(means.new_full((count,), opacity))
        return cls(means, log_scales, quaternions, logits, sh)
