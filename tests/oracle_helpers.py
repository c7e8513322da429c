"""Helpers for tests of oracles: boxes as obstacles, roadmaps among them, workspaces, and lengths of paths."""

import numpy as np
from piece_helpers import TEN, box

from plr_jax import Box, Roadmap, Workspace

UNIT = Box((0, 0), (1, 1))
WALL = Workspace(TEN, [box(4, 0, 6, 8)])
MIDDLE = Workspace(TEN, [box(4, 2, 6, 8)])


class Boxes:
    """Open axis-aligned boxes as obstacles, in any dimension; their boundary is free."""

    def __init__(self, *boxes):
        self.lo, self.hi = np.reshape(boxes, (len(boxes), 2, -1)).swapaxes(0, 1) if boxes else np.zeros((2, 0, 1))

    def is_free(self, x):
        return ~((self.lo[:, None] < x) & (x < self.hi[:, None])).all(axis=2).any(axis=0)

    def is_visible(self, a, b):
        """Return whether no open box meets the segment, by the slab method."""
        lo, hi = self.lo[:, None], self.hi[:, None]
        with np.errstate(divide="ignore", invalid="ignore"):
            enter, leave = np.sort([(lo - a) / (b - a), (hi - a) / (b - a)], axis=0)
        inside = (lo < a) & (a < hi)
        enter, leave = np.where(a == b, np.where(inside, 0, 2), enter), np.where(a == b, 1, leave)
        meets = np.maximum(enter.max(axis=2, initial=0), 0) < np.minimum(leave.min(axis=2, initial=1), 1)
        return ~meets.any(axis=0)


NOTHING = Boxes()
GAP = Boxes((0.45, -1.0, 0.55, 0.8), (0.45, 0.9, 0.55, 2.0))  # a wall with a gap for y in [0.8, 0.9]
CUT = Boxes((0.45, -1.0, 0.55, 2.0))  # a wall without a gap


def roadmap(obstacles, goal=(0.1, 0.1), num_samples=300, domain=UNIT, **options):
    options.setdefault("is_visible", obstacles.is_visible)
    return Roadmap(domain, obstacles.is_free, goal, num_samples, **options)


def free_points(obstacles, n, seed=9):
    x = np.random.default_rng(seed).random((n, 2))
    return x[obstacles.is_free(x)]


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
