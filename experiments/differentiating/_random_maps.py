"""Random maps of polygons in the unit square: convex, concave, touching, overlapping, padded, and discs."""

from typing import NamedTuple

import numpy as np
import shapely
from jaxtyping import Float

from plr_jax.traced import polygons_of_discs

KINDS = ("convex", "concave", "touching", "overlapping", "padded", "discs", "mixed")
# Numbers of corners of a map, and the padded shapes (polygons, corners): each shape is one compiled program.
_NUM_CORNERS = (8, 12, 16, 24, 32, 48, 64, 96, 128, 192, 256)
_SHAPES = ((8, 8), (16, 8), (32, 8), (64, 4))
_GRID = 32  # touching polygons have corners on a grid of this many cells a side

Polygons = Float[np.ndarray, "m k 2"]


class RandomMap(NamedTuple):
    """Polygons padded by rows of NaN, in 64 bits but exact in 32, and the same polygons without padding."""

    kind: str
    polygons: Polygons
    rings: list[Float[np.ndarray, "k 2"]]


def random_map(seed: int, kind: str | None = None, num_corners: int | None = None) -> RandomMap | None:
    """Return a map of up to 256 corners; None if a random polygon crosses itself or has no area."""
    rng = np.random.default_rng(seed)
    kind = kind or KINDS[seed % len(KINDS)]
    total = num_corners or int(rng.choice(_NUM_CORNERS))
    k = int(rng.choice([3, 4, 5, 8]))
    number = min(max(1, total // k), 64 if k <= 4 else 32)
    m, width = next(shape for shape in _SHAPES if number <= shape[0] and k <= shape[1])
    polygons = np.full((m, width, 2), np.nan)
    size = rng.uniform(0.25, 0.6) / np.sqrt(number)
    for i in range(number):
        polygon = _polygon(rng, kind, k, size)
        polygons[i, : len(polygon)] = polygon[:: rng.choice([-1, 1])]
    polygons = polygons.astype(np.float32).astype(float)
    rings = rings_of(polygons)
    is_simple = all(len(ring) > 2 and shapely.Polygon(ring).is_valid and shapely.Polygon(ring).area for ring in rings)
    return RandomMap(kind, polygons, rings) if is_simple else None


def _polygon(rng: np.random.Generator, kind: str, k: int, size: float) -> Float[np.ndarray, "k 2"]:
    center = rng.random(2)
    if kind == "touching":
        # Boxes and triangles on a grid share sides and corners.
        corner, (w, h) = rng.integers(0, _GRID - 4, 2), rng.integers(1, max(2, int(_GRID * size)) + 1, 2)
        box = (corner + np.array([(0, 0), (w, 0), (w, h), (0, h)])) / _GRID
        return box[[0, 1, rng.integers(2, 4)]] if k == 3 else box
    if kind == "discs":
        return np.asarray(polygons_of_discs(center[None], 0.8 * size, k), float)[0]
    if kind == "padded":
        # Repeated corners, of which any is the first.
        polygon = _star(rng, center, int(rng.integers(3, k + 1)), size, is_concave=False)
        return np.roll(np.repeat(polygon, rng.integers(1, k // len(polygon) + 1), axis=0), rng.integers(k), axis=0)
    is_concave = k > 3 and (kind in ("concave", "mixed") or (kind == "overlapping" and rng.random() < 0.5))
    return _star(rng, center, k, size * {"overlapping": 2, "mixed": 1.5}.get(kind, 1), is_concave)


def _star(
    rng: np.random.Generator, center: Float[np.ndarray, "2"], k: int, size: float, is_concave: bool
) -> Float[np.ndarray, "k 2"]:
    """Return corners around a center; on a circle if the star is convex."""
    angle = (np.arange(k) + 0.8 * rng.random(k)) * 2 * np.pi / k + 2 * np.pi * rng.random()
    radius = size * (rng.uniform(0.4, 1, k) if is_concave else np.ones(k))
    return center + radius[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def _without_padding(polygon: Float[np.ndarray, "k 2"]) -> Float[np.ndarray, "k 2"]:
    ring = polygon[~np.isnan(polygon).any(axis=1)]
    return ring[(ring != np.roll(ring, 1, axis=0)).any(axis=1)]


def rings_of(polygons: Polygons) -> list[Float[np.ndarray, "k 2"]]:
    """Return polygons without rows of NaN and without repeated vertices, as ``Workspace`` takes them."""
    rings = [_without_padding(polygon) for polygon in polygons]
    return [ring for ring in rings if len(ring)]
