"""Helpers for tests of configuration spaces: random workspaces and boxes, and checks by dense samples."""

import itertools

import numpy as np
import shapely
from piece_helpers import box as rectangle

from plr_jax.geometry.workspace import Workspace
from plr_jax.spaces._space import CellState

BOUNDS = ((0.0, 0.0), (4.0, 3.0))
CENTERS, RADII = np.array([[2, 2, 1.5], [1, 1, 2.4], [3.2, 1, 0.8]]), np.array([0.6, 0.3, 0.4])


def random_workspace(seed):
    """Return a workspace of overlapping triangles and rectangles, two of which touch along a side."""
    rng = np.random.default_rng(seed)
    corner, size = rng.uniform(0, (3.5, 2.5), (4, 2)), rng.uniform(0.1, 0.9, (4, 2))
    obstacles = [rectangle(*a, *(a + b)) for a, b in zip(corner, size, strict=True)]
    x, y = corner[0] + size[0]
    obstacles.append(rectangle(x, y - 0.3, x + 0.4, y + 0.2))
    for center in rng.uniform(0, (4, 3), (3, 2)):
        obstacles.append(center + rng.uniform(0.1, 0.5, 1) * [[1, 0], [-0.6, 0.8], [-0.6, -0.8]])
    return Workspace(BOUNDS, obstacles)


def of_drone(q):
    """Clearance of a ball of radius 0.2 among spheres."""
    return np.min(np.linalg.norm(q[:, None] - CENTERS, axis=2) - RADII, axis=1) - 0.2


def random_boxes(rng, domain, n, deepest=7):
    """Return random cells of dyadic grids over a domain, with at least two cells per axis."""
    count = 2 ** rng.integers(1, deepest + 1, (n, domain.dim))
    width = domain.width / count
    lo = domain.lo + np.floor(rng.random((n, domain.dim)) * count) * width
    return lo, lo + width


def keep_clear(workspace, shapes, distance):
    """Return whether shapes, grown by a distance, lie in free space, by brute force and up to rounding."""
    free, walls = workspace.free_space.buffer(1e-8), workspace.free_space.boundary
    shapely.prepare([free, walls])
    return shapely.covers(free, shapes) & ((distance == 0) | ~shapely.dwithin(walls, shapes, max(distance - 1e-8, 0)))


def check_classification(space, is_free, lo, hi, per_axis, margin=1e-6):
    """Check that samples of boxes agree with the states proven for them; return the states.

    Samples of blocked boxes keep a margin from their boundary, where touching points may be free.
    """
    state = space.classify(lo, hi)
    assert state.dtype == np.int8 and state.shape == (len(lo),)
    share = np.array(list(itertools.product(np.linspace(0, 1, per_axis), repeat=lo.shape[1])))
    for expected, shares in ((CellState.FREE, share), (CellState.BLOCKED, margin + (1 - 2 * margin) * share)):
        some = state == expected
        samples = (lo[some, None] + shares * (hi - lo)[some, None]).reshape(-1, lo.shape[1])
        for test in (is_free, space.is_free):
            assert (test(samples) == (expected == CellState.FREE)).all()
    return state


def check_motions(space, is_free, q0, q1, num_samples=65):
    """Check that samples of motions proven free are free; return the proofs, and whether all samples are free."""
    share = np.linspace(0, 1, num_samples)[None, :, None]
    width, change = space.domain.width, q1 - q0
    change = np.where(space.domain.periodic, (change + width / 2) % width - width / 2, change)
    samples = q0[:, None] + share * change[:, None]
    sampled = is_free(samples.reshape(-1, q0.shape[1])).reshape(samples.shape[:2]).all(axis=1)
    proven = space.are_free(q0, q1)
    assert sampled[proven].all()
    return proven, sampled


def states(space, *boxes):
    """Return the states of boxes, each given as a row of lower and upper corner."""
    lo, hi = np.array(boxes, dtype=float).reshape(-1, 2, space.domain.dim).transpose(1, 0, 2)
    return space.classify(lo, hi).tolist()


def nothing_known(x):
    return np.zeros(len(x))


def far_from(goal):
    """Return the distance to a goal without walls, as a function."""
    return lambda x: np.hypot(*(x - np.asarray(goal)).T)


class Slow:
    """A cost factor for motions inside a box."""

    def __init__(self, lo, hi, factor):
        self.lo, self.hi, self.factor = np.array(lo), np.array(hi), factor

    def __call__(self, q):
        q = np.asarray(q)
        return np.where(((q > self.lo) & (q < self.hi)).all(axis=1), self.factor, 1.0)

    def bounds(self, lo, hi):
        meets = ((hi > self.lo) & (lo < self.hi)).all(axis=1)
        inside = ((lo > self.lo) & (hi < self.hi)).all(axis=1)
        return np.where(inside, self.factor, 1.0), np.where(meets, self.factor, 1.0)


class Climb:
    """The cost of length and of climbing, at a rate, on ground with a given gradient of the height."""

    def __init__(self, gradient_fn, rate, lipschitz, steepest):
        self.gradient_fn, self.rate, self.lipschitz, self.steepest = gradient_fn, rate, lipschitz, steepest

    def __call__(self, q):
        return 1 + self.rate * np.linalg.norm(self.gradient_fn(q), axis=1)

    def bounds(self, lo, hi):
        return np.ones(len(lo)), np.full(len(lo), 1 + self.rate * self.steepest)

    def pulls(self, lo, hi):
        spread = self.rate * self.lipschitz * np.linalg.norm(hi - lo, axis=1) / 2
        uphill = self.rate * self.gradient_fn((lo + hi) / 2)
        return np.zeros_like(uphill), uphill, 1 - spread, 1 + spread


class SteadyCurrent:
    """Travel time of a vehicle of speed 1 in a uniform current."""

    def __init__(self, w):
        self.w = np.array(w)
        self.a = 1 - self.w @ self.w

    def __call__(self, q):
        return np.full(len(q), 1 / (1 - np.linalg.norm(self.w)))

    def bounds(self, lo, hi):
        speed = np.linalg.norm(self.w)
        return np.full(len(lo), 1 / (1 + speed)), np.full(len(lo), 1 / (1 - speed))

    def pulls(self, lo, hi):
        pull, one = np.tile(-self.w / self.a, (len(lo), 1)), np.ones(len(lo))
        return pull, pull, one / np.sqrt(self.a), one / self.a

    def time(self, v):
        """Return the least time in which the vehicle, carried along by the current, covers the vector ``v``."""
        along = v @ self.w
        return (-along + np.sqrt(along**2 + self.a * np.sum(v * v, axis=1))) / self.a
