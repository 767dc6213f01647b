"""A cloud of 3D Gaussians as the parameters that an optimiser moves, and the spherical harmonics of
its colours.

Harmonics are real, in the order and with the signs of 3D Gaussian splatting, degrees 0 to 4.
"""

from dataclasses import dataclass, replace
from math import isqrt, pi, sqrt

import torch

from ggvs_eval.errors import RenderError

CONSTANT = 0.5 / sqrt(pi)  # the harmonic of degree 0
# of the spherical harmonics; files of 3D Gaussian splatting stop at 3, MVSplat predicts 4
HIGHEST_DEGREE = 4


@dataclass(frozen=True, eq=False)
class GaussianCloud:
    """Anisotropic Gaussians in the parameters of 3D Gaussian splatting (Kerbl et al. 2023), one row
    per Gaussian.

    Attributes:
        means: centres in the world, (N, 3).
        log_scales: natural logarithms of the standard deviations along the Gaussian's own axes,
            world units, (N, 3).
        quaternions: rotation from its own axes to the world, w first, of any length but 0, (N, 4).
        opacity_logits: opacity before the sigmoid, (N,).
        sh: coefficients of the colour's spherical harmonics, constant one first, (N, (degree +
            1)^2, 3).

    Raises:
        RenderError: the shapes do not fit each other, or the tensors differ in device or in kind of
            float.

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
                "cloud of Gaussians: wanted sh (N, (degree + 1)^2, 3) of degree 0 to "
                f"{HIGHEST_DEGREE}, got {tuple(self.sh.shape)}"
            )
        shapes = {
            "means": (3,),
            "log_scales": (3,),
            "quaternions": (4,),
            "opacity_logits": (),
            "sh": (terms, 3),
        }
        for name, shape in shapes.items():
            tensor = getattr(self, name)
            if tensor.shape != (count, *shape):
                raise RenderError(
                    f"cloud of Gaussians: wanted {name} {(count, *shape)}, got "
                    f"{tuple(tensor.shape)}"
                )
            if (
                tensor.device != self.means.device
                or tensor.dtype != self.means.dtype
                or not tensor.is_floating_point()
            ):
                raise RenderError(
                    f"cloud of Gaussians: wanted {name} in {self.means.dtype} on "
                    f"{self.means.device} like the means, got "
                    f"{tensor.dtype} on {tensor.device}"
                )

    def __len__(self) -> int:
        """Return the number of Gaussians."""
        return self.means.shape[0]

    @property
    def degree(self) -> int:
        """Degree of the spherical harmonics, 0 for a colour that is the same from everywhere."""
        return isqrt(self.sh.shape[1]) - 1

    def parameters(self) -> dict[str, torch.Tensor]:
        """Return the five tensors by name, in the order of the fields."""
        return {
            name: getattr(self, name)
            for name in ("means", "log_scales", "quaternions", "opacity_logits", "sh")
        }

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "GaussianCloud":
        """Return the cloud on another device or in another kind of float."""
        return replace(
            self,
            **{
                name: tensor.to(device=device, dtype=dtype)
                for name, tensor in self.parameters().items()
            },
        )

    @classmethod
    def of_points(
        cls,
        means: torch.Tensor,
        colours: torch.Tensor,
        *,
        scale: float | torch.Tensor,
        opacity: float = 0.1,
        degree: int = 0,
    ) -> "GaussianCloud":
        """Round Gaussians of given colours, the same from everywhere.

        Args:
            means: (N, 3), world units.
            colours: (N, 3), in [0, 1].
            scale: standard deviation, world units; one number or (N,).
            opacity: in (0, 1).
            degree: of the spherical harmonics; terms above the first are 0.
        """
        count = len(means)
        quaternions = means.new_zeros(count, 4)
        quaternions[:, 0] = 1
        sh = means.new_zeros(count, (degree + 1) ** 2, 3)
        sh[:, 0] = coefficients_of(colours)
        scales = torch.as_tensor(scale, dtype=means.dtype, device=means.device).reshape(-1, 1)
        log_scales = scales.log() * means.new_ones(count, 3)
        logits = torch.logit(means.new_full((count,), opacity))
        return cls(means, log_scales, quaternions, logits, sh)


class AntialiasedCloud(GaussianCloud):
    """Gaussians whose opacities shrink as the low-pass filter of the image widens them, for which
    they were trained.

    This is Mip-Splatting's 2D filter as gsplat, brush and 3D Gaussian splatting draw it.
    """


def antialiased(cloud: GaussianCloud) -> AntialiasedCloud:
    """Return the cloud as one that was trained antialiased."""
    return AntialiasedCloud(**cloud.parameters())


def harmonic_basis(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """Evaluate every harmonic up to a degree.

    Args:
        directions: unit vectors, (N, 3).
        degree: 0 to 4.

    Returns:
        (N, (degree + 1)^2); term l^2 + l + m is that of degree l and order m.

    Reading:
        The Condon-Shortley phase is included: terms of odd order are negative along positive x and
        y, as in files of 3D Gaussian splatting.

    Examples:
        >>> harmonic_basis(torch.tensor([[0.0, 0.0, 1.0]]), degree=1)[0, ::2].tolist()
        [0.28209..., 0.48860...]
    """
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, CONSTANT)]
    if degree > 0:
        first = sqrt(3 / (4 * pi))
        terms += [-first * y, first * z, -first * x]
    if degree > 1:
        second = sqrt(15 / (4 * pi))
        terms += [
            second * x * y,
            -second * y * z,
            sqrt(5 / (16 * pi)) * (3 * z * z - 1),
            -second * x * z,
        ]
        terms += [second / 2 * (x * x - y * y)]
    if degree > 2:
        outer, inner = sqrt(35 / (32 * pi)), sqrt(21 / (32 * pi))
        terms += [
            -outer * y * (3 * x * x - y * y),
            sqrt(105 / (4 * pi)) * x * y * z,
            -inner * y * (5 * z * z - 1),
        ]
        terms += [sqrt(7 / (16 * pi)) * z * (5 * z * z - 3), -inner * x * (5 * z * z - 1)]
        terms += [sqrt(105 / (16 * pi)) * z * (x * x - y * y), -outer * x * (x * x - 3 * y * y)]
    if degree > 3:
        outer, middle, inner = (
            3 / 4 * sqrt(35 / pi),
            3 / 4 * sqrt(35 / (2 * pi)),
            3 / 4 * sqrt(5 / pi),
        )
        terms += [outer * x * y * (x * x - y * y), -middle * y * z * (3 * x * x - y * y)]
        terms += [inner * x * y * (7 * z * z - 1), -inner / sqrt(2) * y * z * (7 * z * z - 3)]
        terms += [
            3 / 16 / sqrt(pi) * (z * z * (35 * z * z - 30) + 3),
            -inner / sqrt(2) * x * z * (7 * z * z - 3),
        ]
        terms += [
            inner / 2 * (x * x - y * y) * (7 * z * z - 1),
            -middle * x * z * (x * x - 3 * y * y),
        ]
        terms += [outer / 4 * (x * x * (x * x - 3 * y * y) - y * y * (3 * x * x - y * y))]
    return torch.stack(terms, -1)


def harmonic_colours(sh: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Return the colours of Gaussians seen along unit directions, (N, 3): the sum of harmonics plus
    0.5, not below 0.

    Args:
        sh: (N, (degree + 1)^2, 3).
        directions: from the camera's centre to the Gaussians', (N, 3).
    """
    degree = int(sh.shape[1] ** 0.5) - 1
    return ((harmonic_basis(directions, degree)[..., None] * sh).sum(1) + 0.5).clamp_min(0)


def turned_harmonics(sh: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Coefficients of the same colours after a rotation: what was seen along d is seen along
    ``rotation @ d``.

    Args:
        sh: (N, (degree + 1)^2, 3).
        rotation: (3, 3).

    Returns:
        (N, (degree + 1)^2, 3); terms of one degree mix among themselves alone.

    Examples:
        >>> quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y
        >>> along_x = torch.tensor([0.0, 0, 0, -1])[None, :, None].expand(1, 4, 3)
        >>> turned_harmonics(along_x, quarter)[0, :, 0].round(decimals=6).abs().tolist()
        [0.0, 1.0, 0.0, 0.0]
    """
    degree = int(sh.shape[1] ** 0.5) - 1
    directions = _spread(rotation.device)
    before, after = (
        harmonic_basis(directions @ rotation.double(), degree),
        harmonic_basis(directions, degree),
    )
    # harmonics of turned directions are sums of harmonics: exact
    mixing = torch.linalg.lstsq(after, before).solution
    return torch.einsum("ij,njc->nic", mixing.to(sh.dtype), sh)


def _spread(device: torch.device) -> torch.Tensor:
    """Return the unit vectors, enough to distinguish all harmonics, (100, 3): a spiral of golden
    angles.
    """
    number = torch.arange(100, dtype=torch.float64, device=device)
    z = 1 - (2 * number + 1) / len(number)
    angle, radius = number * pi * (3 - sqrt(5)), (1 - z * z).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), z], -1)


def coefficients_of(colour: torch.Tensor) -> torch.Tensor:
    """Return the constant coefficient that shows a colour, same shape: the inverse of
    `harmonic_colours` at degree 0.
    """
    return (colour - 0.5) / CONSTANT
