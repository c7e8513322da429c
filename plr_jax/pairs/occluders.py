"""Occluders: a few long chords of obstacles that hide most points from one another.

A line that crosses a chord inside an obstacle is blocked, whatever the walls are. A few dozen chords stand for most
walls. The chords that hide most of some random pairs of points are chosen, as long as each saves more time than its
own test takes.
"""

from typing import Any

import numpy as np
from jaxtyping import Float

from plr_jax.geometry.box import Box

_PAIRS = 2**12  # random pairs of points, among which hidden pairs are counted
_MOST_VERTICES, _MOST_CHORDS = 96, 64  # vertices and chords of an obstacle that are tried
_CLEAR = 2e-6  # widths of the domain: rounding may put a point that is nearer across an occluder's line


def occluders_of(region: Any, domain: Box, depth: float, num_walls: int) -> Float[np.ndarray, "occluders 7"]:
    """Choose the occluders of what a region of free space leaves of the domain.

    Args:
        region: Free space, a Shapely geometry.
        domain: The domain.
        depth: How deep inside obstacles the occluders lie, at least.
        num_walls: How many walls are tested for each pair that no occluder hides.

    Returns:
        A row for each occluder, counted from the middle of the domain: both ends, and a linear function that is 0 on
        the line through the ends, and 1 at the distance at which a point is certainly beside the line.
    """
    import shapely  # PLRs do not need it

    # 1. Chords: the longest segments between vertices of obstacles that lie deep inside the obstacles.
    rng = np.random.default_rng(0)
    box = shapely.box(*domain.lo, *domain.hi)
    solid = shapely.buffer(shapely.difference(box, region), -depth, join_style="mitre")
    found = [np.zeros((0, 2, 2))]
    for part in shapely.get_parts(solid):
        vertices = np.unique(shapely.get_coordinates(part), axis=0)
        vertices = vertices[rng.permutation(len(vertices))[:_MOST_VERTICES]]
        ends = vertices[np.stack(np.triu_indices(len(vertices), 1), axis=1)]
        length = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        ends = ends[np.argsort(-length, kind="stable")[: _MOST_VERTICES * 8]]
        shapely.prepare(part)
        found.append(ends[shapely.covers(part, shapely.linestrings(ends))][:_MOST_CHORDS])
    chords = np.concatenate(found)
    # 2. Random free pairs, and the chords that their lines cross.
    x, y = domain.lo + rng.random((2, _PAIRS, 2)) * domain.width
    shapely.prepare(region)
    is_free = shapely.intersects_xy(region, *x.T) & shapely.intersects_xy(region, *y.T)
    p, q, (a, b) = x[is_free].T, y[is_free].T, chords.transpose(1, 2, 0)[..., None]

    def left_of(a: Any, b: Any, p: Any) -> Any:
        (ax, ay), (bx, by), (px, py) = a, b, p
        return (bx - ax) * (py - ay) - (by - ay) * (px - ax) > 0

    crosses = (left_of(a, b, p) != left_of(a, b, q)) & (left_of(p, q, a) != left_of(p, q, b))
    # 3. Greedily the chord that hides most of the pairs that are left.
    chosen = []
    while crosses.any():
        hidden = crosses.sum(axis=1)
        best = int(hidden.argmax())
        if hidden[best] * num_walls < 2 * is_free.sum():
            break
        chosen.append(best)
        crosses &= ~crosses[best]
    ends = chords[chosen] - (domain.lo + domain.hi) / 2
    along = ends[:, 1] - ends[:, 0]
    normal = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.linalg.norm(along, axis=1, keepdims=True)
    beside = np.column_stack([normal, (normal * ends[:, 0]).sum(axis=1)]) / (_CLEAR * float(domain.width.max()))
    return np.concatenate([ends.reshape(-1, 4), beside], axis=1)
