"""Draws both views of a stereo scene: exact disparity by a ray through each pixel's centre, smooth edges, textures, light."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ggvs_eval.arrays import Map
from ggvs_eval.synthetic.stereo.stereo_paint import Light, Look, paint
from ggvs_eval.synthetic.stereo.stereo_shapes import Shape
from ggvs_eval.synthetic.stereo.stereo_textures import TextureBank
from ggvs_eval.synthetic.stereo.stereo_tubes import Tubes

Index = NDArray[np.int64]

CHUNK = 8192  # points painted at once: what stays in a core's cache

# Offsets of the four rays that smooth an edge pixel, pixels: a turned square.
EDGE_RAYS = np.array([[-0.375, -0.125], [0.125, -0.375], [0.375, 0.125], [-0.125, 0.375]], np.float32)


@dataclass(frozen=True, eq=False)
class Scene:
    """What both eyes see.

    Attributes:
        focal_px: focal length of both cameras, pixels.
        centre_px: principal point of both cameras, array index of column and row.
        shapes: sheets and balls; part k is shape k.
        tubes: the pieces of all tubes; piece k is part len(shapes) + k.
        tube_of: which tube each piece belongs to, (pieces,).
        looks: of the shapes, then of the tubes.
        light: the lamp.
    """

    focal_px: float
    centre_px: tuple[float, float]
    shapes: list[Shape]
    tubes: Tubes
    tube_of: Index
    looks: list[Look]
    light: Light


@dataclass(frozen=True, eq=False)
class View:
    """One drawn view.

    Attributes:
        image: colour, float32 (H, W, 3) in [0, 255], neither clipped nor rounded.
        disparity: disparity at the pixels' centres, float32 (H, W).
        part: index of the part at the pixels' centres, (H, W).
    """

    image: Map
    disparity: Map
    part: Index


def draw_view(scene: Scene, bank: TextureBank, width: int, height: int, eye: float) -> View:
    """Draw what the eye at (eye, 0, 0) sees; eye is 0 on the left and 1 on the right."""
    x = ((np.arange(width) - scene.centre_px[0]) / scene.focal_px).astype(np.float32)
    y = ((np.arange(height) - scene.centre_px[1]) / scene.focal_px).astype(np.float32)
    inverse, part = _cast_pixels(scene, x, y, eye)
    rays_x, rays_y = np.broadcast_to(x, inverse.shape).ravel(), np.broadcast_to(y[:, None], inverse.shape).ravel()
    edge = _edge_pixels(part)
    near = _neighbours(part, edge)
    edge_x = (rays_x[edge, None] + EDGE_RAYS[:, 0] / np.float32(scene.focal_px)).ravel()
    edge_y = (rays_y[edge, None] + EDGE_RAYS[:, 1] / np.float32(scene.focal_px)).ravel()
    edge_inverse, edge_part = _cast_edges(scene, edge_x, edge_y, near, inverse.ravel()[edge], eye)
    # One list to paint: the pixels that need one ray, then the rays of the others.
    plain = np.setdiff1d(np.arange(inverse.size), edge, assume_unique=True)
    x_all, y_all = np.append(rays_x[plain], edge_x), np.append(rays_y[plain], edge_y)
    inverse_all, part_all = np.append(inverse.ravel()[plain], edge_inverse), np.append(part.ravel()[plain], edge_part)
    colour = _paint(scene, bank, x_all, y_all, inverse_all, part_all, eye)
    image = np.empty((inverse.size, 3), np.float32)
    image[plain] = colour[: len(plain)]
    image[edge] = colour[len(plain) :].reshape(-1, len(EDGE_RAYS), 3).mean(1)
    return View(image.reshape(height, width, 3), inverse * np.float32(scene.focal_px), part)


def _cast_pixels(scene: Scene, x: Map, y: Map, eye: float) -> tuple[Map, Index]:
    """Inverse distance and part at the centre of each pixel."""
    inverse = np.zeros((len(y), len(x)), np.float32)
    part = np.zeros(inverse.shape, np.int64)
    for index, shape in enumerate(scene.shapes):
        left, right, top, bottom = shape.bounds(eye)
        rows = slice(int(np.searchsorted(y, top)), int(np.searchsorted(y, bottom, "right")))
        columns = slice(int(np.searchsorted(x, left)), int(np.searchsorted(x, right, "right")))
        if rows.start >= rows.stop or columns.start >= columns.stop:
            continue
        found = shape.cast(x[None, columns], y[rows, None], eye)
        nearer = found > inverse[rows, columns]
        np.copyto(inverse[rows, columns], found, where=nearer)
        part[rows, columns][nearer] = index
    if len(scene.tubes.radius):
        _cast_tubes(scene, x, y, eye, inverse, part)
    return inverse, part


def _cast_tubes(scene: Scene, x: Map, y: Map, eye: float, inverse: Map, part: Index) -> None:
    """Add the tubes to the maps: all pixels of all pieces' bounding boxes in one list."""
    boxes = scene.tubes.boxes(eye)
    left, right = np.searchsorted(x, boxes[:, 0]), np.searchsorted(x, boxes[:, 1], "right")
    top, bottom = np.searchsorted(y, boxes[:, 2]), np.searchsorted(y, boxes[:, 3], "right")
    widths = right - left
    counts = widths * (bottom - top)
    piece = np.repeat(np.arange(len(counts)), counts)
    within = np.arange(len(piece)) - np.repeat(np.cumsum(counts) - counts, counts)
    row, column = np.divmod(within, widths[piece])
    row, column = row + top[piece], column + left[piece]
    found = scene.tubes.cast(x[column], y[row], eye, piece)
    _keep_nearest(inverse.reshape(-1), part.reshape(-1), row * len(x) + column, found, len(scene.shapes) + piece)


def _keep_nearest(inverse: Map, part: Index, place: Index, found: Map, found_part: Index) -> None:
    """Enter what was found at places of the flat maps, where it is nearer; a place may occur several times."""
    seen = np.flatnonzero(found > inverse[place])
    # The nearest last, so that it stays where several pieces cover a place.
    order = seen[np.argsort(found[seen], kind="stable")]
    inverse[place[order]] = found[order]
    part[place[order]] = found_part[order]


def _edge_pixels(part: Index) -> Index:
    """Flat indices of the pixels with another part beside them."""
    edge = np.zeros(part.shape, bool)
    across, down = part[:, 1:] != part[:, :-1], part[1:] != part[:-1]
    edge[:, 1:] |= across
    edge[:, :-1] |= across
    edge[1:] |= down
    edge[:-1] |= down
    return np.flatnonzero(edge)


def _neighbours(part: Index, pixels: Index) -> Index:
    """Parts at the pixels and around them, (E, 9)."""
    padded = np.pad(part, 1, mode="edge")
    row, column = np.divmod(pixels, part.shape[1])
    return np.stack([padded[row + i, column + j] for i in range(3) for j in range(3)], 1)


def _cast_edges(scene: Scene, x: Map, y: Map, near: Index, centre: Map, eye: float) -> tuple[Map, Index]:
    """Inverse distance and part for the rays of the edge pixels, each against the parts around its pixel."""
    rays = len(EDGE_RAYS)
    inverse, part = np.zeros(len(x), np.float32), np.repeat(near[:, 4], rays)
    pixel, candidate = _candidates(near)
    ray = (pixel[:, None] * rays + np.arange(rays)).ravel()
    bounds = np.searchsorted(candidate, np.arange(len(scene.shapes) + 1)) * rays
    for index in np.unique(candidate[candidate < len(scene.shapes)]):
        own = ray[bounds[index] : bounds[index + 1]]
        found = scene.shapes[index].cast(x[own], y[own], eye)
        nearer = found > inverse[own]
        inverse[own[nearer]] = found[nearer]
        part[own[nearer]] = index
    own, tube = ray[bounds[-1] :], np.repeat(candidate, rays)[bounds[-1] :]
    if len(own):
        _keep_nearest(inverse, part, own, scene.tubes.cast(x[own], y[own], eye, tube - len(scene.shapes)), tube)
    # A ray that meets none of them (a chink) sees what the pixel's centre sees.
    return np.where(inverse > 0, inverse, np.repeat(centre, rays)), part


def _candidates(near: Index) -> tuple[Index, Index]:
    """Pairs (pixel, part near it), each once, ordered by the part."""
    ordered = np.sort(near, axis=1)
    first = np.ones(near.shape, bool)
    first[:, 1:] = ordered[:, 1:] != ordered[:, :-1]
    pixel, _ = np.nonzero(first)
    candidate = ordered[first]
    by_part = np.argsort(candidate, kind="stable")
    return pixel[by_part], candidate[by_part]


def _paint(scene: Scene, bank: TextureBank, x: Map, y: Map, inverse: Map, part: Index, eye: float) -> Map:
    """Colour of each ray's surface point, [0, 255], (N, 3), thing by thing."""
    colour = np.empty((len(x), 3), np.float32)
    shapes = len(scene.shapes)
    thing_of = np.concatenate([np.arange(shapes), shapes + scene.tube_of]).astype(np.int16)
    thing = thing_of.take(part)
    order = np.argsort(thing, kind="stable")
    ends = np.cumsum(np.bincount(thing, minlength=len(scene.looks)))
    for index, look in enumerate(scene.looks):
        first = int(ends[index - 1]) if index else 0
        for begin in range(first, int(ends[index]), CHUNK):
            members = order[begin : min(begin + CHUNK, int(ends[index]))]
            z = np.reciprocal(np.maximum(inverse.take(members), np.float32(1e-6)))
            points = np.stack([x.take(members) * z + np.float32(eye), y.take(members) * z, z])
            if index < shapes:
                surface = scene.shapes[index].surface(points)
            else:
                surface = scene.tubes.surface(points, part.take(members) - shapes)
            colour[members] = paint(look, scene.light, bank, points, surface, scene.focal_px, eye)
    return colour


def visible_on_the_right(left: View, right: View) -> NDArray[np.bool_]:
    """Pixels of the left view whose match lies inside the right one with nothing before it.

    What the nearest right pixel shows hides the point if it is another part, nearer by more than a pixel of disparity. Parts do
    not hide themselves; and where that pixel's ray passes beside a thin thing the point itself is still seen.
    """
    height, width = left.disparity.shape
    column = np.arange(width, dtype=np.float32) - left.disparity
    nearest = np.clip(np.rint(column), 0, width - 1).astype(np.int64) + np.arange(height)[:, None] * width
    other = right.part.take(nearest) != left.part
    nearer = right.disparity.take(nearest) > left.disparity + 1
    return np.asarray((column >= 0) & ~(other & nearer))
