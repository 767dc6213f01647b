"""What the textures of the stereo scenes show: pictures, dead leaves, clouds, stripes, tiles, writing, building materials."""

from collections.abc import Callable

import cv2
import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Image8, Map
from ggvs_eval.synthetic.room import textures
from ggvs_eval.synthetic.room.textures import picture

SIDE = 512  # texels along each axis

# The packaged pictures of scikit-image but its stereo pair, which others evaluate on.
PICTURES = (
    *("astronaut", "chelsea", "coffee", "rocket", "hubble_deep_field", "moon", "camera", "retina"),
    *("brick", "gravel", "grass", "coins", "page", "immunohistochemistry"),
)

Colour = tuple[float, float, float]


def coloured_pattern(rng: np.random.Generator) -> Image8:
    """A texture of a random kind, uint8 (SIDE, SIDE, 3)."""
    kinds: list[tuple[float, Callable[[np.random.Generator], Image8]]] = [
        (0.34, _photograph),
        (0.1, _leaves),
        (0.14, _cloudy),
        (0.08, _stripes),
        (0.05, _checks),
        (0.05, _cells),
        (0.06, _writing),
        (0.18, _material),
    ]
    weights = np.array([weight for weight, _ in kinds])
    image = kinds[int(rng.choice(len(kinds), p=weights / weights.sum()))][1](rng)
    # Most things are less colourful than a random palette.
    grey = image.mean(2, keepdims=True, dtype=np.float32)
    return _encode((grey + np.float32(rng.uniform(0.1, 0.8)) * (image - grey)) / 255)


def _photograph(rng: np.random.Generator) -> Image8:
    """A turned crop of a packaged picture in other colours."""
    image = picture(str(rng.choice(PICTURES)), 512)
    height, width = image.shape[:2]
    side = rng.uniform(0.4, 1.0) * min(height, width)
    angle = rng.choice([0, 90, 180, 270]) + rng.normal(0, 15)
    centre = (width * rng.uniform(0.3, 0.7), height * rng.uniform(0.3, 0.7))
    turn = cv2.getRotationMatrix2D(centre, angle, SIDE / side)
    turn[:, 2] += SIDE / 2 - np.array(centre)
    crop = np.asarray(
        cv2.warpAffine(image, turn, (SIDE, SIDE), flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REFLECT_101), np.float32
    )
    mix = np.eye(3) * 0.6 + rng.dirichlet(np.ones(3), 3) * 0.4
    # Print is never quite black; large black parts would hold nothing to match.
    low, high = rng.uniform(0.03, 0.25), rng.uniform(0.75, 1)
    return _encode(low + (high - low) * (crop / 255 @ mix.T.astype(np.float32)))


def _leaves(rng: np.random.Generator) -> Image8:
    """Dead leaves: patches of all sizes upon each other, the statistics of natural pictures."""
    image = np.full((SIDE, SIDE, 3), rng.uniform(0.2, 0.8, 3), np.float32)
    palette = rng.uniform(0.05, 0.95, (int(rng.integers(3, 9)), 3))
    count = int(rng.integers(150, 700))
    radii = np.clip(4 / np.sqrt(rng.uniform(0.0008, 1, count)), 3, 120)
    for radius in radii:
        colour = np.clip(palette[rng.integers(len(palette))] + rng.normal(0, 0.07, 3), 0, 1)
        centre = rng.uniform(0, SIDE, 2)
        corners = int(rng.integers(3, 9))
        angles = np.sort(rng.uniform(0, 2 * np.pi, corners))
        points = centre + radius * np.stack([np.cos(angles), np.sin(angles)], 1) * rng.uniform(0.5, 1.3, (corners, 1))
        cv2.fillPoly(image, [np.rint(points * 8).astype(np.int32)], colour.tolist(), cv2.LINE_AA, 3)
    grain = 1 + rng.uniform(0, 0.08) * textures.fractal_noise(rng, (SIDE, SIDE), (4, 4), 2)
    return _encode(image * grain[..., None])


def _cloudy(rng: np.random.Generator) -> Image8:
    """Fractal noise between colours; coarse or fine, smooth or in steps, isotropic or drawn out."""
    cell = float(np.exp(rng.uniform(np.log(6), np.log(250))))
    size = (cell, cell * float(np.exp(rng.normal(0, 0.6))))
    noise = textures.fractal_noise(rng, (SIDE, SIDE), size, int(rng.integers(2, 7)))
    if rng.random() < 0.3:
        noise = np.sin(noise * rng.uniform(2, 8)).astype(np.float32)
    share = np.clip(0.5 + 0.35 * noise, 0, 1)
    if rng.random() < 0.3:
        share = np.clip((share - 0.5) * rng.uniform(3, 12) + 0.5, 0, 1)
    low, high = rng.uniform(0.05, 0.95, (2, 3)).astype(np.float32)
    grain = 1 + rng.uniform(0, 0.1) * textures.fractal_noise(rng, (SIDE, SIDE), (2.5, 2.5), 1)
    return _encode((low + share[..., None] * (high - low)) * grain[..., None])


def _stripes(rng: np.random.Generator) -> Image8:
    """Parallel stripes, evenly repeated or not."""
    y, x = np.mgrid[:SIDE, :SIDE].astype(np.float32)
    pitch = float(np.exp(rng.uniform(np.log(8), np.log(90))))
    wobble = rng.choice([0.0, 0.05, 0.4]) * textures.fractal_noise(rng, (SIDE, SIDE), (120, 120), 2)
    phase = (x if rng.random() < 0.5 else y) / pitch + wobble
    tone = np.clip(0.5 + rng.uniform(0.5, 6) * np.sin(2 * np.pi * phase), 0, 1)
    if rng.random() < 0.5:
        tone = tone * rng.uniform(0.3, 1, 512)[np.floor(phase).astype(int) % 512]
    return _two_coloured(rng, tone.astype(np.float32))


def _checks(rng: np.random.Generator) -> Image8:
    """Chequers, tiles with joints or dots on a grid."""
    y, x = np.mgrid[:SIDE, :SIDE].astype(np.float32)
    pitch = float(np.exp(rng.uniform(np.log(14), np.log(110))))
    u, v = x / pitch, y / (pitch * rng.uniform(0.6, 1.7))
    kind = rng.integers(3)
    if kind == 0:
        tone = ((np.floor(u) + np.floor(v)) % 2).astype(np.float32)
    elif kind == 1:
        joint = np.minimum(np.abs(u % 1 - 0.5), np.abs(v % 1 - 0.5))
        tone = (
            np.clip(joint * pitch / 2 - 0.5, 0, 1)
            * rng.uniform(0.7, 1, (64, 64))[np.floor(u).astype(int) % 64, np.floor(v).astype(int) % 64]
        )
    else:
        tone = np.clip((rng.uniform(0.15, 0.42) - np.hypot(u % 1 - 0.5, v % 1 - 0.5)) * pitch, 0, 1)
    return _two_coloured(rng, tone.astype(np.float32))


def _cells(rng: np.random.Generator) -> Image8:
    """Voronoi cells with a tone each: pebbles, scales, cracked paint."""
    count = int(rng.integers(30, 500))
    seeds = np.ones((SIDE, SIDE), np.uint8)
    seeds[rng.integers(0, SIDE, count), rng.integers(0, SIDE, count)] = 0
    distance, labels = cv2.distanceTransformWithLabels(seeds, cv2.DIST_L2, 5, labelType=cv2.DIST_LABEL_PIXEL)
    tones = rng.uniform(0.2, 1, int(labels.max()) + 1).astype(np.float32)[labels]
    dome = 1 - rng.uniform(0, 0.6) * np.asarray(distance) / np.asarray(distance).max()
    return _two_coloured(rng, np.asarray(tones * dome, np.float32))


def _writing(rng: np.random.Generator) -> Image8:
    """Lines of signs in several sizes: labels, posters, pages."""
    paper, ink = rng.uniform(0.5, 1, 3), rng.uniform(0, 0.5, 3)
    if rng.random() < 0.3:
        paper, ink = ink, paper
    inked = np.zeros((SIDE, SIDE), np.uint8)
    row = 0.0
    while row < SIDE:
        scale = float(np.exp(rng.uniform(np.log(0.4), np.log(2.5))))
        row += 34 * scale
        signs = "".join(chr(code) for code in rng.integers(33, 122, 60))
        origin = (int(rng.uniform(0, 60)), int(row))
        cv2.putText(inked, signs, origin, int(rng.integers(0, 5)), scale, 255, max(1, round(2 * scale)), cv2.LINE_AA)
    stains = 1 + 0.05 * textures.fractal_noise(rng, (SIDE, SIDE), (90, 90), 4)
    return _encode((paper + (inked / 255)[..., None] * (ink - paper)) * stains[..., None])


def _material(rng: np.random.Generator) -> Image8:
    """A building material or cloth of `ggvs_eval.synthetic.room.textures`."""
    size_m = (SIDE / textures.TEXELS_PER_METRE,) * 2
    first, second, third = (_colour(rng) for _ in range(3))
    makers: list[Callable[[], Image8]] = [
        lambda: textures.plaster(rng, size_m, first),
        lambda: textures.wallpaper(rng, size_m, first, second),
        lambda: textures.bricks(rng, size_m, first, second),
        lambda: textures.wood(rng, size_m, first),
        lambda: textures.boards(rng, size_m, first),
        lambda: textures.fabric(rng, size_m, first, second, str(rng.choice(["stripes", "check", "plain"]))),
        lambda: textures.rug(rng, size_m, [first, second, third]),
        lambda: textures.mottled(rng, first, float(rng.uniform(0.05, 0.25)), float(rng.uniform(0.01, 0.1))),
    ]
    image = makers[int(rng.integers(len(makers)))]()
    return np.asarray(cv2.resize(image, (SIDE, SIDE), interpolation=cv2.INTER_CUBIC), np.uint8)


def grey_pattern(rng: np.random.Generator) -> Image8:
    """Grain, speckle, scratches or stains around mid-grey, uint8 (SIDE, SIDE)."""
    cell = float(np.exp(rng.uniform(np.log(2), np.log(200))))
    stretch = float(rng.choice([1, 1, 1, 4, 12]))
    noise = textures.fractal_noise(rng, (SIDE, SIDE), (cell, cell * stretch), int(rng.integers(1, 6)))
    if rng.random() < 0.3:
        noise = noise * (np.abs(noise) > rng.uniform(0.5, 1.8))
    return np.rint(np.clip(128 + 42 * noise, 0, 255)).astype(np.uint8)


def _two_coloured(rng: np.random.Generator, tone: Map) -> Image8:
    low, high = rng.uniform(0.05, 0.95, (2, 3)).astype(np.float32)
    wear = 1 + rng.choice([0.0, 0.05, 0.12]) * textures.fractal_noise(rng, (SIDE, SIDE), (60, 60), 6)
    return _encode((low + tone[..., None] * (high - low)) * wear[..., None])


def _colour(rng: np.random.Generator) -> Colour:
    red, green, blue = np.clip(rng.uniform(0.1, 0.9) + rng.normal(0, 0.15, 3), 0.04, 0.96)
    return float(red), float(green), float(blue)


def _encode(image: NDArray[np.floating]) -> Image8:
    return np.rint(np.clip(image, 0, 1) * 255).astype(np.uint8)
