"""The largest error that can be found: dense samples where the largest is proven, then boxes that shrink."""

import numpy as np
import shapely
from jaxtyping import Float, Int

from plr_jax import PLR, VisibilityGraph, certify
from plr_jax.geometry.polygons import polygons_of, triangulate

_LEAVES, _POINTS, _SMOKE_POINTS = 30, 20_000, 500
_BEST, _POINTS_A_BOX, _ROUNDS = 12, 2_000, 5
_FIRST_BOX, _SHRINKING = 0.1, 0.2  # of the sides of a leaf; of the box before

Points = Float[np.ndarray, "n 2"]


def leaf_errors(plr: PLR, oracle: VisibilityGraph) -> Float[np.ndarray, "leaves"]:
    """Proven bound of the error of each leaf."""
    return widest_bounds(certify(plr, oracle, leaf_bounds=True))


def widest_bounds(plr: PLR) -> Float[np.ndarray, "leaves"]:
    """The larger of the two bounds of each leaf of a PLR that has them."""
    assert plr.band is not None
    return np.abs(np.asarray(plr.band)).max(axis=0)[: plr.num_leaves].astype(float)


def largest_found(plr: PLR, oracle: VisibilityGraph, x: Points, errors: Float[np.ndarray, "n"], smoke: bool) -> float:
    """The largest error at any of the points given, and at those that are looked for.

    Those lie in the leaves of the largest proven error, all over their free parts and beside the edges of these,
    where proofs are tight; then in ever smaller boxes around the worst.
    """
    rng = np.random.default_rng(7)
    lo, hi = plr.leaf_boxes
    worst = np.argsort(-leaf_errors(plr, oracle))[:_LEAVES]
    dense, side = dense_points(oracle, lo, hi, worst, _SMOKE_POINTS if smoke else _POINTS, rng)
    points, found = np.concatenate([x, dense]), np.concatenate([errors, _errors(plr, oracle, dense)])
    sides = np.concatenate([np.full(x.shape, np.median(hi - lo, axis=0)), side])
    largest = float(found.max(initial=0.0))
    best = np.argsort(-found)[:_BEST]
    center, side = points[best], _FIRST_BOX * sides[best]
    for _ in range(_ROUNDS):
        near = center[:, None] + side[:, None] * rng.uniform(-1, 1, (len(center), _POINTS_A_BOX, 2))
        near[:, 0] = center
        error = _errors(plr, oracle, near.reshape(-1, 2)).reshape(len(center), -1)
        center = near[np.arange(len(center)), error.argmax(axis=1)]
        largest, side = max(largest, float(error.max())), _SHRINKING * side
    return largest


def dense_points(
    oracle: VisibilityGraph,
    lo: Float[np.ndarray, "leaves 2"],
    hi: Float[np.ndarray, "leaves 2"],
    leaves: Int[np.ndarray, "some"],
    count: int,
    rng: np.random.Generator,
) -> tuple[Points, Points]:
    """Points of the free parts of some leaves, half of them next to the edges; and the sides of their leaves."""
    points, sides = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for leaf in leaves:
        free = polygons_of(shapely.intersection(oracle.workspace.free_space, shapely.box(*lo[leaf], *hi[leaf])))
        if free:
            triangles = triangulate(shapely.MultiPolygon(free))
            points.append(points_of_triangles(triangles, count, rng))
            sides.append(np.broadcast_to(hi[leaf] - lo[leaf], points[-1].shape))
    return np.concatenate(points), np.concatenate(sides)


def points_of_triangles(triangles: Float[np.ndarray, "n 3 2"], count: int, rng: np.random.Generator) -> Points:
    """Random points of triangles, half of them uniform, half near edges and vertices, in all triangles alike."""
    (a, b), c = triangles[:, 1:].transpose(1, 0, 2) - triangles[:, :1].transpose(1, 0, 2), triangles[:, 0]
    area = np.abs(a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0])
    uniform = rng.choice(len(area), count // 2, p=area / area.sum())
    pick = np.concatenate([uniform, rng.integers(len(area), size=count - count // 2)])
    weight = rng.exponential(size=(count, 3))
    weight[count // 2 :] **= rng.choice([1.0, 4.0, 16.0], (count - count // 2, 1))
    weight /= weight.sum(axis=1, keepdims=True)
    return c[pick] + weight[:, 1:2] * a[pick] + weight[:, 2:] * b[pick]


def _errors(plr: PLR, oracle: VisibilityGraph, x: Points) -> Float[np.ndarray, "n"]:
    """Errors where the goal can be reached, 0 elsewhere and outside the domain."""
    distance = oracle(x)
    error = np.abs(np.asarray(plr(x), float) - np.where(np.isfinite(distance), distance, 0.0))
    return np.where(np.isfinite(distance) & np.isfinite(error), error, 0.0)
