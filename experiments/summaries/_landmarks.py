"""Differential heuristics (ALT): distances from landmarks, and the bounds that the triangle inequality gives.

``|d(l, x) - d(l, y)|`` and the straight line are lower bounds, ``d(l, x) + d(l, y)`` is an upper bound. The estimate
lies between the largest lower and the smallest upper bound; its share of the way is fitted to pairs. The distances
from a landmark are stored at the nodes of a grid, or as a PLR of cones, which is nearly exact.

Landmarks are chosen greedily from a pool of corners and random points: each one lowers the mean error of the lower
bounds most.

A. Goldberg, C. Harrelson, "Computing the shortest path: A* search meets graph theory", SODA 2005.
"""

from collections.abc import Callable
from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array

from experiments.summaries._given import Candidates, CompiledSummary, Given, Pairs, Points, compiled, straight
from experiments.summaries._node_tables import finest_grid, rounded
from plr_jax import construct

_COUNTS = (1, 2, 4, 8, 16, 32, 64, 128)
_BITS = (8, 16)
_PLR_BYTES = (256, 512, 1_024, 2_048, 4_096)  # above, a PLR of these maps gains nothing that landmarks would notice
_MOST_PLRS = 64  # of which those of the largest map take a quarter of an hour
_POOL = 400
_FITTED, _SMOKE_FITTED = 5_000, 500  # pairs that landmarks are chosen and shares fitted by
_SHARES = np.linspace(0, 1, 41)

OfPoint = Callable[[Array], Array]
"""Distances of a point, ``(2,)``, from every landmark."""


def tables(given: Given) -> Candidates:
    """Tables of 8 and 16 bits, for several numbers of landmarks."""
    pairs = _fitted(given)
    landmarks = _greedy(given, pairs)
    for count in _COUNTS[:1] if given.smoke else _COUNTS:
        for bits in _BITS:
            grid = finest_grid(given.workspace, lambda grid: grid.table_bytes(count, bits), given.max_bytes)  # noqa: B023
            if grid is not None:
                table = rounded(given.fields(landmarks[:count], grid.free).T, bits)
                made = partial(grid.read, jnp.asarray(table[grid.nearest]))
                share, summary = _summary(grid.table_bytes(count, bits), made, pairs)
                nodes = f"{len(grid.free):,} nodes of {bits} bits"
                yield f"{count} landmarks, greedy, {nodes}, {share:.3g} of the way", summary


def plrs(given: Given) -> Candidates:
    """A PLR of cones a landmark, for several numbers of landmarks."""
    pairs = _fitted(given)
    landmarks = _greedy(given, pairs)
    counts = sorted({min(_MOST_PLRS, given.max_bytes // size) for size in _PLR_BYTES} - {0})
    for count in counts[:1] if given.smoke else counts:
        size = given.max_bytes // count
        oracles = [given.exact.with_goal(point) for point in landmarks[:count]]
        made = [construct(oracle, given.workspace.bounds, leaf="cone", max_bytes=size) for oracle in oracles]
        num_bytes = sum(plr.num_bytes for plr in made)
        share, summary = _summary(num_bytes, lambda x: jnp.stack([plr(x) for plr in made]), pairs)  # noqa: B023
        yield f"{count} landmarks, greedy, {share:.3g} of the way", summary


def _fitted(given: Given) -> Pairs:
    """Return the pairs by which landmarks and shares are chosen."""
    return given.training.first(_SMOKE_FITTED if given.smoke else _FITTED)


def _summary(num_bytes: int, of_point: OfPoint, pairs: Pairs) -> tuple[float, CompiledSummary]:
    """The share of the way from the lower to the upper bounds that fits pairs best, and the summary of it."""

    def bounds(x: Array, y: Array) -> tuple[Array, Array]:
        at_x, at_y = of_point(x), of_point(y)
        return jnp.maximum(straight(x, y), jnp.abs(at_x - at_y).max()), (at_x + at_y).min()

    ends = (jnp.asarray(column, jnp.float32) for column in (pairs.x, pairs.y))
    lower, upper = map(np.asarray, jax.jit(jax.vmap(bounds))(*ends))
    gap = np.maximum(upper - lower, 0)
    share = float(min(_SHARES, key=lambda share: np.abs(lower + share * gap - pairs.distance).mean()))

    def of_pair(x: Array, y: Array) -> Array:
        lower, upper = bounds(x, y)
        return lower + share * jnp.maximum(upper - lower, 0)

    return share, compiled(num_bytes, of_pair)


def _greedy(given: Given, pairs: Pairs) -> Points:
    """Return landmarks in the order in which they are chosen."""
    rng = np.random.default_rng(given.seed)
    corners = rng.permutation(given.workspace.boundary.vertices)[: _POOL // 2]
    pool = np.concatenate([corners, given.workspace.sample_free(_POOL // 2, seed=given.seed)])
    bounds = np.abs(given.fields(pool, pairs.x) - given.fields(pool, pairs.y))
    best, chosen = np.linalg.norm(pairs.x - pairs.y, axis=1), []
    for _ in range(2 if given.smoke else max(_COUNTS)):
        sums = np.maximum(bounds, best).sum(axis=1)
        sums[chosen] = -1
        chosen.append(int(sums.argmax()))
        best = np.maximum(best, bounds[chosen[-1]])
    return pool[chosen]
