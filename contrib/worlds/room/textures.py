"""Procedural albedo of walls, boards, cloth and labels, each from a seeded generator.

Every function returns an sRGB image, uint8 (H, W, 3), at `TEXELS_PER_METRE`; the first image axis
points down.
"""

import numpy as np

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.kernels.portable import blur, cos, enlarge, shrink, sin

PICTURES = (
    "astronaut",
    "chelsea",
    "coffee",
    "rocket",
    "hubble_deep_field",
    "moon",
    "camera",
    "retina",
)
TEXELS_PER_METRE = 400
Colour = tuple[float, float, float]
Size = tuple[float, float]


def picture(name: str, width: int = 320, height: int | None = None) -> Image8:
    """Return one of `PICTURES` at a width and a height in pixels, by default that of its
    proportions, RGB uint8 (H, W, 3).
    """
    from skimage import data

    image = np.asarray(getattr(data, name)())
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, axis=2)
    return np.rint(
        shrink(image, height or round(image.shape[0] * width / image.shape[1]), width)
    ).astype(np.uint8)


def fractal_noise(
    rng: np.random.Generator, shape: tuple[int, int], cell: Size, octaves: int = 4
) -> Map:
    """Smooth noise of mean 0 and standard deviation near 1.

    Args:
        shape: (H, W).
        cell: size of the largest features along rows and columns, pixels.
    """
    total = np.zeros(shape, np.float32)
    for octave in range(octaves):
        rows, columns = (
            max(2, min(int(n * 2**octave / c) + 2, n)) for n, c in zip(shape, cell, strict=True)
        )
        grid = rng.standard_normal((rows, columns)).astype(np.float32)
        total += 0.5**octave * enlarge(grid, *shape)
    return (total - total.mean()) / max(float(total.std()), 1e-6)


def plain(colour: Colour) -> Image8:
    """Return one colour everywhere."""
    return _encode(np.array(colour, np.float32)[None, None])


def plaster(rng: np.random.Generator, size_m: Size, colour: Colour) -> Image8:
    """Painted plaster: trowel marks, faint stains, a fine grain."""
    shape = _shape(size_m)
    stains = fractal_noise(rng, shape, (260, 260), 5)
    trowel = fractal_noise(rng, shape, (16, 42), 3)
    grain = fractal_noise(rng, shape, (3, 3), 1)
    return _encode(_paint(colour, 1 + 0.045 * stains + 0.022 * trowel + 0.018 * grain))


def wallpaper(rng: np.random.Generator, size_m: Size, ground: Colour, figure: Colour) -> Image8:
    """Half-drop repeat of a flower on stripes, faded unevenly so that no two flowers are equal."""
    shape = _shape(size_m)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / TEXELS_PER_METRE
    repeat, petals = rng.uniform(0.16, 0.24), int(rng.integers(4, 8))
    column = np.floor(x / repeat)
    u, v = x / repeat % 1 - 0.5, (y / repeat + 0.5 * (column % 2)) % 1 - 0.5
    radius = np.sqrt(u * u + v * v)
    edge = 0.2 + 0.12 * _cosine_of_multiple(petals, u / np.maximum(radius, 1e-6))
    flower = np.clip((edge - radius) / 0.02, 0, 1) * np.clip((radius - 0.06) / 0.02, 0, 1)
    stem = np.clip((0.014 - np.abs(u + 0.04 * sin(6 * v))) / 0.01, 0, 1)
    pattern = np.clip(flower + 0.6 * stem + 0.12 * (cos(2 * np.pi * x / repeat * 4) > 0), 0, 1)
    pattern *= 0.75 + 0.2 * fractal_noise(rng, shape, (90, 90), 3)
    fading = (
        1
        + 0.05 * fractal_noise(rng, shape, (300, 300), 4)
        + 0.015 * fractal_noise(rng, shape, (3, 3), 1)
    )
    return _encode(_mix(ground, figure, np.clip(pattern, 0, 1)) * fading[..., None])


def bricks(rng: np.random.Generator, size_m: Size, colour: Colour, mortar: Colour) -> Image8:
    """Running bond with a separate tone for each brick and rough mortar."""
    shape = _shape(size_m)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / TEXELS_PER_METRE
    x, y = (a + 0.003 * fractal_noise(rng, shape, (20, 20), 2) for a in (x, y))
    course = np.floor(y / 0.075).astype(int)
    along = x / 0.225 + 0.5 * (course % 2)
    brick = np.floor(along).astype(int)
    tones = rng.normal(1.0, 0.14, (97, 89)).astype(np.float32)[course % 97, brick % 89]
    gap_m = np.minimum(
        np.abs((y / 0.075 + 0.5) % 1 - 0.5) * 0.075, np.abs((along + 0.5) % 1 - 0.5) * 0.225
    )
    wear = (
        1
        + 0.09 * fractal_noise(rng, shape, (24, 24), 4)
        + 0.05 * fractal_noise(rng, shape, (250, 250), 3)
    )
    face = _paint(colour, tones) * wear[..., None]
    return _encode(_blend(face, _paint(mortar, wear), np.clip((0.006 - gap_m) / 0.003, 0, 1)))


def wood(rng: np.random.Generator, size_m: Size, colour: Colour) -> Image8:
    """Planed wood, its grain along the rows."""
    return _encode(_paint(colour, _grain(rng, _shape(size_m))))


def boards(rng: np.random.Generator, size_m: Size, colour: Colour, width_m: float = 0.11) -> Image8:
    """Floor boards along the rows, staggered, each from another tree."""
    shape = _shape(size_m)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / TEXELS_PER_METRE
    board = np.floor(y / width_m).astype(int)
    offset = rng.uniform(0, 1.3, 211).astype(np.float32)[board % 211]
    piece = np.floor((x + offset) / 1.3).astype(int)
    tone = rng.normal(1.0, 0.11, (211, 31)).astype(np.float32)[board % 211, piece % 31]
    gap_m = np.minimum(
        np.abs((y / width_m + 0.5) % 1 - 0.5) * width_m,
        np.abs(((x + offset) / 1.3 + 0.5) % 1 - 0.5) * 1.3,
    )
    gap = 1 - 0.55 * np.clip((0.0035 - gap_m) / 0.0025, 0, 1)
    return _encode(_paint(colour, _grain(rng, shape) * tone * gap))


def fabric(
    rng: np.random.Generator, size_m: Size, ground: Colour, stripe: Colour, kind: str
) -> Image8:
    """Woven cloth; `kind` is ``stripes``, ``check`` or ``plain``."""
    shape = _shape(size_m)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / TEXELS_PER_METRE
    pitch = rng.uniform(0.035, 0.06)
    bands_x, bands_y = (np.clip(3 * cos(2 * np.pi * a / pitch) - 1.2, 0, 1) for a in (x, y))
    pattern = {"stripes": bands_y, "check": 0.5 * bands_x + 0.5 * bands_y, "plain": 0 * x}[kind]
    folds = (
        1
        + 0.05 * fractal_noise(rng, shape, (60, 60), 4)
        + 0.05 * fractal_noise(rng, shape, (3, 3), 1)
    )
    return _encode(_mix(ground, stripe, pattern) * folds[..., None])


def rug(rng: np.random.Generator, size_m: Size, colours: list[Colour]) -> Image8:
    """Return a knotted rug: borders around a field of lozenges."""
    shape = _shape(size_m)
    y, x = np.mgrid[: shape[0], : shape[1]].astype(np.float32) / TEXELS_PER_METRE
    border = np.minimum(np.minimum(x, size_m[0] - x), np.minimum(y, size_m[1] - y))
    lozenge = np.abs(x / 0.17 % 1 - 0.5) + np.abs(y / 0.22 % 1 - 0.5)
    index = np.where(lozenge < 0.16, 1, np.where(lozenge < 0.42, 0, 2))
    index = np.where(border < 0.16, np.floor(border / 0.04).astype(int) % 3, index)
    image = np.array(colours, np.float32)[index]
    return _encode(image * (1 + 0.12 * fractal_noise(rng, shape, (5, 5), 3))[..., None])


def bands(
    rng: np.random.Generator, size_m: Size, colours: list[Colour], edges: list[float]
) -> Image8:
    """Return the horizontal bands from bottom to top, as on a labelled bottle or a book's back.

    Args:
        size_m: width and height, metres.
        edges: upper edge of every band but the last, as fractions of the height.
    """
    shape = _shape(size_m)
    height = 1 - (np.arange(shape[0], dtype=np.float32) + 0.5) / shape[0]
    image = np.array(colours, np.float32)[np.searchsorted(edges, height)][:, None].repeat(
        shape[1], axis=1
    )
    ink = fractal_noise(rng, shape, (9, 16), 2)
    return _encode(image * (1 - 0.25 * (ink > 0.8) + 0.04 * ink)[..., None])


def mottled(
    rng: np.random.Generator, colour: Colour, strength: float = 0.08, cell_m: float = 0.04
) -> Image8:
    """Return a natural surface without a pattern (fruit skin, stone, leaf, clay), 0.5 m square."""
    shape = _shape((0.5, 0.5))
    return _encode(
        _paint(
            colour, 1 + strength * fractal_noise(rng, shape, (cell_m * TEXELS_PER_METRE,) * 2, 4)
        )
    )


def outdoors(rng: np.random.Generator, size_m: Size) -> Image8:
    """Paint the view from a window: a sky, hedges, a lawn, all out of focus."""
    shape = _shape(size_m)
    height = np.linspace(1, 0, shape[0], dtype=np.float32)[:, None] + 0.06 * fractal_noise(
        rng, shape, (60, 60), 4
    )
    sky = _mix((0.95, 0.97, 1.0), (0.62, 0.78, 0.97), np.clip(height, 0, 1))
    leaves = _paint((0.35, 0.48, 0.25), 1 + 0.3 * fractal_noise(rng, shape, (40, 40), 3))
    image = _blend(sky, leaves, np.clip((0.45 - height) / 0.04, 0, 1))
    return _encode(blur(image, 5))


def _grain(rng: np.random.Generator, shape: tuple[int, int]) -> Map:
    rings = fractal_noise(rng, shape, (34, 700), 3)
    pores = fractal_noise(rng, shape, (2, 60), 2)
    return 1 + 0.09 * sin(7 * rings).astype(np.float32) + 0.07 * rings + 0.035 * pores


def _cosine_of_multiple(multiple: int, cosine: Map) -> Map:
    """Return the cosine of a multiple, at least 1, of the angles that have these cosines
    (Chebyshev).
    """
    before, cosine_now = np.ones_like(cosine), cosine
    for _ in range(multiple - 1):
        before, cosine_now = cosine_now, 2 * cosine * cosine_now - before
    return cosine_now


def _shape(size_m: Size) -> tuple[int, int]:
    return max(2, round(size_m[1] * TEXELS_PER_METRE)), max(2, round(size_m[0] * TEXELS_PER_METRE))


def _paint(colour: Colour, tone: Map) -> Map:
    return np.array(colour, np.float32) * tone[..., None]


def _mix(ground: Colour, figure: Colour, share: Map) -> Map:
    return _blend(np.array(ground, np.float32), np.array(figure, np.float32), share)


def _blend(ground: Map, figure: Map, share: Map) -> Map:
    return ground * (1 - share[..., None]) + figure * share[..., None]


def _encode(image: Map) -> Image8:
    return np.rint(np.clip(image, 0.02, 0.97) * 255).astype(np.uint8)
