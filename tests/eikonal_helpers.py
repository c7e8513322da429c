"""Helpers for tests of the eikonal solver: boxes as obstacles in any dimension, random meshes, hard points."""

from itertools import product

import numpy as np
import shapely
from space_helpers import BOUNDS, rectangle

from plr_jax import PlaneSpace, VisibilityGraph, Workspace
from plr_jax.eikonal import estimate
from plr_jax.eikonal.mesh import Mesh
from plr_jax.geometry.box import Box
from plr_jax.plr.tree import Cells, tree_of
from plr_jax.spaces import CellState, MotionCost

EMPTY = PlaneSpace(Workspace(((0, 0), (1, 1))))
ROOM = Workspace(BOUNDS, [rectangle(1, 1, 2, 2), rectangle(2.3, 0, 2.4, 1.3)])


def use_few_nodes(monkeypatch, num=10_000):
    """Let estimates use grids of about this many nodes, which is quick; proven bounds do not depend on it."""
    for name in ("_NODES", "_CELL_NODES", "_STENCIL_NODES"):
        monkeypatch.setattr(estimate, name, dict.fromkeys((1, 2, 3), num))


class BoxSpace:
    """A space with open axis-aligned boxes as obstacles, none of which crosses the seam of a periodic axis."""

    def __init__(self, domain, *obstacles, blocks=None):
        self.domain = domain
        obstacles = np.array(obstacles, float).reshape(-1, 2, domain.dim)
        turns = np.array(list(product(*[(-1, 0, 1) if p else (0,) for p in domain.periodic])))[:, None]
        self.lo, self.hi = ((obstacles[:, k] + turns * domain.width).reshape(-1, domain.dim) for k in (0, 1))
        self.motion_cost = MotionCost(blocks or ((tuple(range(domain.dim)), 1.0),))

    def _meets(self, lo, hi):
        return np.any(np.all((lo[:, None] < self.hi) & (hi[:, None] > self.lo), axis=2), axis=1)

    def is_free(self, q):
        q = np.asarray(q, float)
        return self.domain.contains(q) & ~self._meets(q, q)

    def classify(self, lo, hi):
        held = np.any(np.all((lo[:, None] >= self.lo) & (hi[:, None] <= self.hi), axis=2), axis=1)
        state = np.where(self._meets(lo, hi), CellState.MIXED, CellState.FREE)
        return np.where(held, CellState.BLOCKED, state).astype(np.int8)

    def straight(self, q, goal):
        """Return the cost of straight motions to a goal."""
        return self.motion_cost.lengths(q, np.broadcast_to(goal, q.shape), self.domain)

    def are_free(self, q0, q1):
        """Test motions by the slab method."""
        q0 = self.domain.wrapped(q0)
        change = self.domain.difference(q1, q0)
        still = change[:, None] == 0
        with np.errstate(divide="ignore", invalid="ignore"):
            ends = np.sort([(end - q0[:, None]) / change[:, None] for end in (self.lo, self.hi)], axis=0)
        enter, leave = np.where(still, -np.inf, ends[0]), np.where(still, np.inf, ends[1])
        within = np.all(~still | ((self.lo < q0[:, None]) & (q0[:, None] < self.hi)), axis=2)
        crosses = within & (np.maximum(enter.max(axis=2), 0) < np.minimum(leave.min(axis=2), 1))
        return self.is_free(q0) & self.is_free(q1) & ~crosses.any(axis=1)


def random_mesh(seed, dim, *, rounds=3, blocked=0.3, periodic=None):
    """Return a mesh of cells in random states, split at random along all axes or one; it is not balanced."""
    rng = np.random.default_rng(seed)
    cells = Cells.root(dim)
    for _ in range(2 if periodic is not None else 1):
        cells = halved(cells)
    for _ in range(rounds):
        which, once = rng.random(len(cells)) < 0.3, rng.random(len(cells)) < 0.3
        axis = rng.integers(dim, size=len(cells))
        alone = cells[once & ~which].split(axis[once & ~which])
        cells = cells[~which & ~once].append(halved(cells[which]), alone)
    state = rng.choice(list(CellState), len(cells), p=[blocked, (1 - blocked) / 2, (1 - blocked) / 2])
    state[0] = CellState.FREE
    return mesh_of(Box(np.zeros(dim), 1 + np.arange(dim), periodic), cells, state.astype(np.int8))


def mesh_of(domain, cells, state):
    tree = tree_of(cells)
    return Mesh(domain, tree, state[tree.order], np.zeros(len(state), bool))


def halved(cells):
    for axis in range(cells.dim):
        cells = cells.split(np.full(len(cells), axis))
    return cells


def hard_points(plr, workspace, n, seed=0):
    """Return ``2 * n`` points, uniform free ones and hard ones: on walls, at vertices, and at faces of leaves."""
    rng = np.random.default_rng(seed)
    lo, hi = plr.leaf_boxes
    points = [workspace.sample_free(n, seed), workspace.boundary.vertices]
    segments = workspace.boundary.segments[rng.integers(len(workspace.boundary.edges), size=n // 4)]
    points.append(segments[:, 0] + rng.random((len(segments), 1)) * (segments[:, 1] - segments[:, 0]))
    for beside in (0.0, 1e-9, -1e-9, 1e-7, -1e-7, 4e-7, -4e-7):
        leaf, axis, each = rng.integers(len(lo), size=n // 8), rng.integers(2, size=n // 8), np.arange(n // 8)
        x = lo[leaf] + rng.random((len(leaf), 2)) * (hi - lo)[leaf]
        x[each, axis] = np.where(rng.random(len(leaf)) < 0.5, lo[leaf, axis], hi[leaf, axis])
        x[each, axis] += beside * plr.domain.width[axis]
        points.append(x)
    x = np.concatenate(points[::-1])
    return np.resize(x[shapely.intersects_xy(workspace.free_space, *x.T)], (2 * n, 2))


def check_between(plr, x, distance, rounding=1e-9):
    """Check that the bounds contain finite distances; return the distances, lower and upper bounds."""
    lower, upper = (np.asarray(bound, np.float64) for bound in plr.numpy().bounds(x))
    known = np.isfinite(distance)
    assert known.any()
    assert (lower <= distance + rounding)[known].all(), x[known][np.argmax((lower - distance)[known])]
    assert (distance <= upper + rounding)[known].all(), x[known][np.argmax((distance - upper)[known])]
    return distance[known], lower[known], upper[known]


def check_bounds(plr, workspace, goals, seed=0, n=4000):
    """Check the bounds at hard points by the exact distance to the nearest goal; return it, and both bounds."""
    x = hard_points(plr, workspace, n, seed)
    distance = np.min([VisibilityGraph(workspace, goal)(x) for goal in np.atleast_2d(goals)], axis=0)
    return check_between(plr, x, distance, 1e-12 * (1 + distance))  # rounding error of the oracle
