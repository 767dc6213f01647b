"""Real spherical harmonics in the order and with the signs of 3D Gaussian splatting, degrees 0 to 4."""

from math import pi, sqrt

import torch

CONSTANT = 0.5 / sqrt(pi)  # the harmonic of degree 0


def basis(directions: torch.Tensor, degree: int) -> torch.Tensor:
    """Evaluate every harmonic up to a degree.

    Args:
        directions: unit vectors, (N, 3).
        degree: 0 to 4.

    Returns:
        (N, (degree + 1)^2); term l^2 + l + m is that of degree l and order m.

    Reading:
        The Condon-Shortley phase is included: terms of odd order are negative along positive x and y, as in files of 3D Gaussian
        splatting.

    Examples:
        >>> basis(torch.tensor([[0.0, 0.0, 1.0]]), degree=1)[0, ::2].tolist()
        [0.28209..., 0.48860...]
    """
    x, y, z = directions.unbind(-1)
    terms = [torch.full_like(x, CONSTANT)]
    if degree > 0:
        first = sqrt(3 / (4 * pi))
        terms += [-first * y, first * z, -first * x]
    if degree > 1:
        second = sqrt(15 / (4 * pi))
        terms += [second * x * y, -second * y * z, sqrt(5 / (16 * pi)) * (3 * z * z - 1), -second * x * z]
        terms += [second / 2 * (x * x - y * y)]
    if degree > 2:
        outer, inner = sqrt(35 / (32 * pi)), sqrt(21 / (32 * pi))
        terms += [-outer * y * (3 * x * x - y * y), sqrt(105 / (4 * pi)) * x * y * z, -inner * y * (5 * z * z - 1)]
        terms += [sqrt(7 / (16 * pi)) * z * (5 * z * z - 3), -inner * x * (5 * z * z - 1)]
        terms += [sqrt(105 / (16 * pi)) * z * (x * x - y * y), -outer * x * (x * x - 3 * y * y)]
    if degree > 3:
        outer, middle, inner = 3 / 4 * sqrt(35 / pi), 3 / 4 * sqrt(35 / (2 * pi)), 3 / 4 * sqrt(5 / pi)
        terms += [outer * x * y * (x * x - y * y), -middle * y * z * (3 * x * x - y * y)]
        terms += [inner * x * y * (7 * z * z - 1), -inner / sqrt(2) * y * z * (7 * z * z - 3)]
        terms += [3 / 16 / sqrt(pi) * (z * z * (35 * z * z - 30) + 3), -inner / sqrt(2) * x * z * (7 * z * z - 3)]
        terms += [inner / 2 * (x * x - y * y) * (7 * z * z - 1), -middle * x * z * (x * x - 3 * y * y)]
        terms += [outer / 4 * (x * x * (x * x - 3 * y * y) - y * y * (3 * x * x - y * y))]
    return torch.stack(terms, -1)


def colours(sh: torch.Tensor, directions: torch.Tensor) -> torch.Tensor:
    """Colours of Gaussians seen along unit directions, (N, 3): the sum of harmonics plus 0.5, not below 0.

    Args:
        sh: (N, (degree + 1)^2, 3).
        directions: from the camera's centre to the Gaussians', (N, 3).
    """
    degree = int(sh.shape[1] ** 0.5) - 1
    return ((basis(directions, degree)[..., None] * sh).sum(1) + 0.5).clamp_min(0)


def turned(sh: torch.Tensor, rotation: torch.Tensor) -> torch.Tensor:
    """Coefficients of the same colours after a rotation: what was seen along d is seen along ``rotation @ d``.

    Args:
        sh: (N, (degree + 1)^2, 3).
        rotation: (3, 3).

    Returns:
        (N, (degree + 1)^2, 3); terms of one degree mix among themselves alone.

    Examples:
        >>> quarter = torch.tensor([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])  # x to y
        >>> along_x = torch.tensor([0.0, 0, 0, -1])[None, :, None].expand(1, 4, 3)
        >>> turned(along_x, quarter)[0, :, 0].round(decimals=6).abs().tolist()
        [0.0, 1.0, 0.0, 0.0]
    """
    degree = int(sh.shape[1] ** 0.5) - 1
    directions = _spread(rotation.device)
    before, after = basis(directions @ rotation.double(), degree), basis(directions, degree)
    mixing = torch.linalg.lstsq(after, before).solution  # harmonics of turned directions are sums of harmonics: exact
    return torch.einsum("ij,njc->nic", mixing.to(sh.dtype), sh)


def _spread(device: torch.device) -> torch.Tensor:
    """Unit vectors in directions enough to tell all harmonics apart, (100, 3): a spiral of golden angles."""
    number = torch.arange(100, dtype=torch.float64, device=device)
    z = 1 - (2 * number + 1) / len(number)
    angle, radius = number * pi * (3 - sqrt(5)), (1 - z * z).sqrt()
    return torch.stack([radius * angle.cos(), radius * angle.sin(), z], -1)


def coefficients_of(colour: torch.Tensor) -> torch.Tensor:
    """The constant coefficient that shows a colour, same shape: the inverse of `colours` at degree 0."""
    return (colour - 0.5) / CONSTANT
