"""Gradients by vertices, goal and points beside central differences of ``VisibilityGraph``, in 32 and in 64 bits.

At each place, all vertices of a map, its goal and a point move along one random direction. Differences are of fourth
order. Their step is large, as the oracle rounds coordinates; so places are left out where the shortest path changes
its corners within the step, or has a segment shorter than 100 steps, where distances bend. Places with straight paths
are left out too. Errors are shares of the gradient's norm, the typical derivative along a random direction.
"""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Float

from experiments.differentiating._random_maps import RandomMap, random_map, rings_of
from plr_jax import VisibilityGraph, Workspace, polygon_distance

PLACES = 2_000
ALLOWED = {32: 1e-4, 64: 1e-7}
_STEP = 2e-4
_SHORTEST_SEGMENT = 100  # steps
_PLACES_A_MAP = 40
_KINDS = ("convex", "concave", "overlapping", "padded", "discs", "mixed")  # touching polygons would come apart
_CORNERS = (8, 16, 24, 32, 48, 64)
_BOUNDS = ((-2.0, -2.0), (3.0, 3.0))
_NODES = np.array([-2, -1, 1, 2])  # fourth-order differences: steps, and their weights
_WEIGHTS = np.array([1, -8, 8, -1]) / 12


class _Place(NamedTuple):
    """Vertices, a goal and points, or their velocities."""

    polygons: Float[np.ndarray, "m k 2"]
    goal: Float[np.ndarray, "2"]
    x: Float[np.ndarray, "n 2"]


def measure(seed: int, smoke: bool) -> dict[str, Any]:
    number_of_places = 5 if smoke else PLACES
    differences, number = [], 1_000_000 * seed
    left_out = {"straight": 0, "path changes or has a short segment": 0, "not free or unreachable": 0}
    slopes: dict[int, list[np.ndarray]] = {bits: [] for bits in ALLOWED}
    norms, segments = [], []
    while sum(map(len, differences)) < number_of_places:
        number += 1
        kind = _KINDS[number % len(_KINDS)]
        given = random_map(number, kind, 16 if smoke else _CORNERS[number % len(_CORNERS)])
        if given is None:
            continue
        place, velocity = _drawn(given, number)
        difference, count, is_finite = _differences(place, velocity)
        kept = count > 1
        for reason, which in zip(left_out, (count == 1, is_finite & (count == 0), ~is_finite), strict=True):
            left_out[reason] += int(which.sum())
        differences.append(difference[kept])
        segments.append(count[kept])
        for bits in ALLOWED:
            with jax.enable_x64(bits == 64):
                slope, norm = _slopes(place, velocity, np.dtype(f"float{bits}"))
            slopes[bits].append(slope[kept])
        norms.append(norm[kept])
    truth, norm = (np.concatenate(each)[:number_of_places] for each in (differences, norms))
    errors = {bits: np.abs(np.concatenate(each)[: len(truth)] - truth) / norm for bits, each in slopes.items()}
    return {
        "places": len(truth),
        "left_out": left_out,
        "mean_segments": float(np.concatenate(segments).mean()),
        "rows": [
            {"bits": bits, "allowed": ALLOWED[bits], "wrong": int((error > ALLOWED[bits]).sum())}
            | {"largest": float(error.max()), "mean": float(error.mean())}
            for bits, error in errors.items()
        ],
    }


def _drawn(given: RandomMap, seed: int) -> tuple[_Place, _Place]:
    rng = np.random.default_rng(seed)
    workspace = Workspace(_BOUNDS, given.rings)
    goal, *x = workspace.sample_free(200, seed=seed)
    near = np.array(x)[np.argsort(np.abs(np.array(x) - 0.5).max(axis=1))[:_PLACES_A_MAP]]  # among the polygons
    place = _Place(*(each.astype(np.float32).astype(float) for each in (given.polygons, goal, near)))
    # Equal vertices move alike: padding has the velocity of the vertex that it repeats.
    vertices, index = np.unique(place.polygons.reshape(-1, 2), axis=0, return_inverse=True)
    polygons = rng.standard_normal(vertices.shape)[index.ravel()].reshape(place.polygons.shape)
    return place, _Place(polygons, rng.standard_normal(2), rng.standard_normal(near.shape))


def _differences(place: _Place, velocity: _Place) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return differences, numbers of path segments (0 at places to leave out), and which places have a path."""
    distances, paths = [], []
    for share in (0, *_NODES):
        at = _Place(*(a + share * _STEP * b for a, b in zip(place, velocity, strict=True)))
        oracle = VisibilityGraph(Workspace(_BOUNDS, rings_of(at.polygons)), at.goal)
        distances.append(oracle(at.x))
        paths.append([_corners(oracle.shortest_path(point), at.polygons) for point in at.x])
    is_finite = np.asarray(np.isfinite(distances).all(axis=0))
    count = np.zeros(len(place.x), int)
    for i in np.flatnonzero(is_finite):
        (corners, shortest), *others = (path[i] for path in paths)
        is_same = all(each == corners for each, _ in others)
        if is_same and shortest > _SHORTEST_SEGMENT * _STEP:
            count[i] = len(corners) + 1
    with np.errstate(invalid="ignore"):
        return _WEIGHTS @ np.array(distances[1:]) / _STEP, count, is_finite


def _corners(path: Float[np.ndarray, "vertices 2"], polygons: Float[np.ndarray, "m k 2"]) -> tuple[list[int], float]:
    """Return the numbers of the vertices at which a path turns, and the length of its shortest segment."""
    if len(path) < 2:
        return [], 0.0
    vertices = np.nan_to_num(polygons.reshape(-1, 2), nan=np.inf)
    turns = np.abs(path[1:-1, None] - vertices[None]).max(axis=2).argmin(axis=1)
    return turns.tolist(), float(np.linalg.norm(np.diff(path, axis=0), axis=1).min())


@jax.jit
def _gradients(polygons: Any, goal: Any, x: Any) -> Any:
    def distance(polygons, goal, x):
        return polygon_distance(polygons, goal, bounds=_BOUNDS)(x)

    return jax.vmap(jax.grad(distance, (0, 1, 2)), (None, None, 0))(polygons, goal, x)


def _slopes(place: _Place, velocity: _Place, dtype: Any) -> tuple[np.ndarray, np.ndarray]:
    """Return derivatives along the velocities, and the norms of the gradients."""
    gradients = [np.asarray(each, float) for each in _gradients(*(each.astype(dtype) for each in place))]
    is_padding = np.isnan(place.polygons)
    gradients[0] = np.where(is_padding, 0, gradients[0])
    along = np.where(is_padding, 0, velocity.polygons), velocity.goal, velocity.x
    axes = [tuple(range(1, each.ndim)) for each in gradients]
    slopes = [(a * b).sum(axis=axis) for a, b, axis in zip(gradients, along, axes, strict=True)]
    squares = [(a**2).sum(axis=axis) for a, axis in zip(gradients, axes, strict=True)]
    return np.sum(slopes, axis=0), np.sqrt(np.sum(squares, axis=0))
