"""Helpers for tests of voxels: random volumes, and their free points by exact arithmetic."""

import itertools
import math
from fractions import Fraction

import numpy as np


def random_volume(rng, dim, most=5, share=0.35):
    """Return a small volume with a share of blocked voxels and at least one free voxel."""
    free = rng.random(rng.integers(1, most + 1, dim)) > share
    free[(0,) * dim] = True
    return free


def voxels_around(x):
    """Return the voxels of side 1 that contain a point, as tuples."""
    return list(itertools.product(*[{math.ceil(c) - 1, math.floor(c)} for c in x]))


def free_around(free, x):
    """Return the free voxels that contain a point."""
    inside = [v for v in voxels_around(x) if all(0 <= k < n for k, n in zip(v, free.shape, strict=True))]
    return {v for v in inside if free[v]}


def reached(some, among):
    """Return the voxels of a set that are connected to given ones through faces."""
    found, stack = set(some), list(some)
    while stack:
        at = stack.pop()
        near = [v for v in among - found if sum(abs(a - b) for a, b in zip(v, at, strict=True)) == 1]
        found.update(near)
        stack += near
    return found


def is_contact(free, x):
    """Return whether the free voxels around a point are disconnected."""
    around = free_around(free, x)
    return bool(around) and reached({next(iter(around))}, around) != around


def passes(free, q0, q1):
    """Return whether a straight motion is free, followed from face to face."""
    q0, q1 = ([Fraction(c) for c in q.tolist()] for q in (q0, q1))

    def at(t):
        return [a + t * (b - a) for a, b in zip(q0, q1, strict=True)]

    times = {Fraction(0), Fraction(1)}
    for a, b in zip(q0, q1, strict=True):
        if a != b:
            times |= {(k - a) / (b - a) for k in range(math.ceil(min(a, b)), math.floor(max(a, b)) + 1)}
    times = sorted(times)
    if q0 == q1:
        return bool(free_around(free, q0))
    live = free_around(free, at(times[1] / 2))
    for before, time, after in zip(times, times[1:], times[2:], strict=False):
        assert before < time < after
        live = reached(live, free_around(free, at(time))) & free_around(free, at((time + after) / 2))
    return bool(live)


def state_of(free, lo, hi, step=4):
    """Return 1 for a free box, 0 for a blocked one, 2 for a mixed one, by samples."""
    # Corners are multiples of 2 / step.
    ticks = [np.arange(a, b + 1 / step, 1 / step) for a, b in zip(lo, hi, strict=True)]
    samples = list(itertools.product(*[t.tolist() for t in ticks]))
    inner = [x for x in samples if all(a < c < b for a, c, b in zip(lo, x, hi, strict=True))]
    if not any(free_around(free, x) for x in inner):
        return 0
    return 1 if all(free_around(free, x) and not is_contact(free, x) for x in samples) else 2


def clearances(free, x):
    """Return distances of points to blocked voxels of side 1 and to the outside; 0 there."""
    gaps = [np.maximum(np.maximum(k - x, x - k - 1), 0) for k in np.argwhere(~free)]
    nearest = np.min([np.linalg.norm(gap, axis=1) for gap in gaps], axis=0, initial=np.inf)
    return np.maximum(np.minimum(nearest, np.minimum(x, free.shape - x).min(axis=1)), 0)
