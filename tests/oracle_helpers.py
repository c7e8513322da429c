"""What the tests of oracles share: obstacles that are boxes, roadmaps among them, and lengths of paths."""

import numpy as np
import shapely

from plr_jax.geometry.box import Box
from plr_jax.oracles import Roadmap

UNIT = Box((0, 0), (1, 1))
TEN = ((0, 0), (10, 10))


class Boxes:
    """Axis-aligned obstacles in any dimension, open, so that their boundary is free."""

    def __init__(self, *boxes):
        dim = len(boxes[0]) // 2 if boxes else 0
        self.lo, self.hi = np.array([b[:dim] for b in boxes]), np.array([b[dim:] for b in boxes])

    def is_free(self, x):
        return np.array([not any(np.all((lo < p) & (p < hi)) for lo, hi in self.each()) for p in x], dtype=bool)

    def is_visible(self, a, b):
        return np.array(
            [not any(crosses(p, q, *box) for box in self.each()) for p, q in zip(a, b, strict=True)], bool
        )

    def each(self):
        return zip(self.lo, self.hi, strict=True)

    def union(self):
        return shapely.union_all([shapely.box(*lo, *hi) for lo, hi in self.each()])


def crosses(a, b, lo, hi):
    """Whether the open box meets the segment: slab by slab."""
    enter, leave = 0.0, 1.0
    for start, end, low, high in zip(a, b, lo, hi, strict=True):
        if start == end:
            if not low < start < high:
                return False
            continue
        t = sorted([(low - start) / (end - start), (high - start) / (end - start)])
        enter, leave = max(enter, t[0]), min(leave, t[1])
    return enter < leave


NOTHING = Boxes()
# A wall from floor to ceiling but for a gap in y in [0.8, 0.9].
GAP = Boxes((0.45, -1.0, 0.55, 0.8), (0.45, 0.9, 0.55, 2.0))
# A wall without a gap.
CUT = Boxes((0.45, -1.0, 0.55, 2.0))


def roadmap(obstacles, goal=(0.1, 0.1), num_samples=300, domain=UNIT, **options):
    options.setdefault("is_visible", obstacles.is_visible)
    return Roadmap(domain, obstacles.is_free, goal, num_samples, **options)


def free_points(obstacles, n, seed=9):
    x = np.random.default_rng(seed).random((n, 2))
    return x[obstacles.is_free(x)]


def box(x0, y0, x1, y1):
    """Corners of a box, counterclockwise."""
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def length(path):
    return np.linalg.norm(np.diff(path, axis=0), axis=1).sum()
