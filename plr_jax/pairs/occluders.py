"""Occluders: a few long chords of obstacles that hide most points from one another.

A line that crosses a chord inside an obstacle is blocked, whatever the walls are. A few dozen chords stand for most
walls: those are taken that hide the most of some random pairs of points, as long as each saves more than it costs.
"""

from typing import Any

import numpy as np
from jaxtyping import Bool, Float

from plr_jax.geometry.box import Box

_PAIRS = 2**12  # of random points, of which those that an occluder hides are counted
_MOST_VERTICES, _MOST_CHORDS = 96, 64  # of an obstacle, that are tried
_CLEAR = 2e-6  # widths of the domain from an occluder's line, nearer than which rounding may put a point across it


def occluders_of(region: Any, domain: Box, depth: float, num_walls: int) -> Float[np.ndarray, "occluders 7"]:
    """The occluders of what a region of free space leaves of the domain.

    Args:
        region: Free space, a Shapely geometry.
        domain: The domain.
        depth: How deep inside obstacles they lie, at least.
        num_walls: How many walls are tested for each pair that no occluder hides.

    Returns:
        A row of each, counted from the middle of the domain: both ends, and a linear function that is 0 on the line
        through them and 1 at the distance at which a point is certainly beside it.
    """
    import shapely  # which PLRs do not need

    middle, width = (domain.lo + domain.hi) / 2, float(domain.width.max())
    rng = np.random.default_rng(0)
    chords = _chords(region, domain, depth, rng)
    x, y = domain.lo + rng.random((2, _PAIRS, 2)) * domain.width
    shapely.prepare(region)
    is_free = shapely.intersects_xy(region, *x.T) & shapely.intersects_xy(region, *y.T)
    crosses, chosen = _cross(chords, x[is_free], y[is_free]), []
    while crosses.any():
        hidden = crosses.sum(axis=1)
        best = int(hidden.argmax())
        if hidden[best] * num_walls < 2 * is_free.sum():
            break
        chosen.append(best)
        crosses &= ~crosses[best]
    ends = chords[chosen] - middle
    along = ends[:, 1] - ends[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    beside = np.column_stack([normal, (normal * ends[:, 0]).sum(axis=1)]) / (_CLEAR * width)
    return np.concatenate([ends.reshape(-1, 4), beside], axis=1)


def _chords(region: Any, domain: Box, depth: float, rng: np.random.Generator) -> Float[np.ndarray, "chords 2 2"]:
    """The longest segments between vertices of obstacles that lie as deep inside them, some for each obstacle."""
    import shapely

    solid = shapely.buffer(
        shapely.difference(shapely.box(*domain.lo, *domain.hi), region), -depth, join_style="mitre"
    )
    found = [np.zeros((0, 2, 2))]
    for part in shapely.get_parts(solid):
        vertices = np.unique(shapely.get_coordinates(part), axis=0)
        vertices = vertices[rng.permutation(len(vertices))[:_MOST_VERTICES]]
        ends = vertices[np.stack(np.triu_indices(len(vertices), 1), axis=1)]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        ends = ends[np.argsort(-length, kind="stable")[: _MOST_VERTICES * 8]]
        shapely.prepare(part)
        found.append(ends[shapely.covers(part, shapely.linestrings(ends))][:_MOST_CHORDS])
    return np.concatenate(found)


def _cross(
    chords: Float[np.ndarray, "chords 2 2"], x: Float[np.ndarray, "n 2"], y: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, "chords n"]:
    """Whether chords and the lines between points cross."""

    def left_of(a: Any, b: Any, p: Any) -> Any:
        (ax, ay), (bx, by), (px, py) = a, b, p
        return (bx - ax) * (py - ay) - (by - ay) * (px - ax) > 0

    a, b = (end.T[:, :, None] for end in (chords[:, 0], chords[:, 1]))
    return (left_of(a, b, x.T) != left_of(a, b, y.T)) & (left_of(x.T, y.T, a) != left_of(x.T, y.T, b))
