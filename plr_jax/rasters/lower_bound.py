"""Proven lower bounds of cost distances over a raster, computed from the costs of known paths."""

import numpy as np

from plr_jax.eikonal.elements import rescaling_of
from plr_jax.rasters.search import AtCorners, Points, Raster, Sides, cells_of

_SLACK = 0.015  # share by which lower bounds start below the distances
_PROJECTIONS = 400  # rounds of projections; where costs jump, 400 halve the gap that 100 leave
_RELAXATION = 0.85  # step of a round, as a multiple of the step that projections ask for; diverges from 1.3
ROUNDING = 1e-9  # relative error of the cost of a path: far more than its sums round


def lower_bound(cost: Raster, side: Sides, points: Points, at_centers: Raster, at_corners: AtCorners) -> Raster:
    """Return a proven lower bound of the least cost of a path from each cell's center to the sources ``points``.

    A function is a lower bound if it is at most 0 at the sources and nowhere steeper than the cost of the cell. The
    costs of known paths from centers and corners, linear in the four triangles around each center, are nearly such a
    function. Repeated projections make steep triangles less steep, and a final rescaling removes the rest.
    """
    # 1. Divide costs by the least, so that squares neither overflow nor vanish.
    least = cost.min()
    cost, at_centers, at_corners = cost / least, at_centers / least, at_corners / least
    # 2. List the triangles of a cell, one at each side. Triangle k has the side from corner k to the next corner,
    #    along an axis, and the center m. The corners k of all cells are the part places[k] of the table of corners.
    #
    #      3-------2
    #      | \ 2 / |
    #      |3  m  1|
    #      | / 0 \ |
    #      0-------1
    #
    places = np.s_[:-1, :-1], np.s_[:-1, 1:], np.s_[1:, 1:], np.s_[1:, :-1]
    triangles = list(zip(places, (*places[1:], places[0]), (0, 1, 0, 1), strict=True))
    is_known = np.isfinite(at_corners)  # paths do not pass where two barriers touch: nothing binds such a corner
    most = [np.where(is_known[p] & is_known[q], cost, np.inf) for p, q, _ in triangles]  # largest slopes
    middle, corner = (np.where(np.isfinite(u), (1 - _SLACK) * u, 0.0) for u in (at_centers, at_corners))

    def steepness(triangle: int) -> Raster:
        # The slope of the linear function over its largest value. Along the side of length s, it is (u_q - u_p) / s.
        # Across, from the center to the middle of the side, half the other side of the cell away, it is
        # ((u_p + u_q) / 2 - u_m) / (t / 2).
        p, q, axis = triangles[triangle]
        along = (corner[q] - corner[p]) / side[axis]
        across = (corner[p] + corner[q] - 2 * middle) / side[1 - axis]
        return np.sqrt(along * along + across * across) / most[triangle]

    # 3. Project: move the three values of a steep triangle towards their mean, until its slope is allowed. All
    #    triangles are treated at once, and each value takes the mean of the changes that steep triangles ask for.
    #    As in Nesterov's method, each round first goes on in the direction of the last round. Values do not rise
    #    above their start, so that they stay low at the sources.
    first = before = middle, corner
    for k in range(_PROJECTIONS):
        ahead = [now + k / (k + 3) * (now - last) for now, last in zip((middle, corner), before, strict=True)]
        before, (middle, corner) = (middle, corner), ahead
        change, count = ([np.zeros_like(values) for values in (middle, corner)] for _ in range(2))
        for triangle, (p, q, _) in enumerate(triangles):
            excess = np.maximum(steepness(triangle), 1.0)
            mean = (corner[p] + corner[q] + middle) / 3
            shrinkage, is_steep = 1 / excess - 1, excess > 1
            for kind, values, place in ((0, middle, ...), (1, corner, p), (1, corner, q)):
                change[kind][place] += shrinkage * (values[place] - mean)
                count[kind][place] += is_steep
        columns = zip(ahead, change, count, first, strict=True)
        middle, corner = (np.minimum(u + _RELAXATION * d / np.maximum(n, 1), start) for u, d, n, start in columns)
    # 4. Rescale. The range of a cell's values includes reflections of its corners in the center, for
    #    corners that nothing binds.
    factor = (1 + ROUNDING) * np.max([steepness(triangle) for triangle in range(4)], axis=0)
    around = np.stack([u for p in places for u in (corner[p], 2 * middle - corner[p])])
    lower = np.interp(middle, *rescaling_of(*(u.ravel() for u in (around.min(0), around.max(0), factor))))
    # 5. Subtract the largest value that a source may have: that of its cell's center, and the cost of the motion
    #    there.
    row, column = cells_of(points, side, cost.shape).T
    to_center = np.linalg.norm(points - (np.stack([column, row], axis=1) + 0.5) * side, axis=1)
    at_sources = np.max(lower[row, column] + cost[row, column] * to_center)
    lower = np.maximum(lower - at_sources - ROUNDING * np.abs(lower).max(), 0.0)
    return np.where(np.isfinite(at_centers), least * lower, np.inf)
