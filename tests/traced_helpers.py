"""Helpers for tests of traced grids: many random levels of one shape, and points in them."""

import numpy as np

SIZE, LEVELS, POINTS = 7, 120, 40  # one shape for all tests, so that each function is compiled once


def random_levels(seed, levels=LEVELS, size=SIZE):
    """Return maps of four densities, and goals at centers, on sides and corners of a free cell, or inside it."""
    rng = np.random.default_rng(seed)
    free = rng.random((levels, size, size)) > rng.choice([0.1, 0.25, 0.4, 0.6], (levels, 1, 1))
    free[:, 3, 3] |= ~free.any(axis=(1, 2))
    cells = np.stack([rng.permutation(np.argwhere(each))[0] for each in free])
    offsets = rng.choice([0.0, 0.5, 1.0, -1.0], (levels, 2))
    return free, cells[:, ::-1] + np.where(offsets < 0, rng.random((levels, 2)), offsets)


def random_points(seed, levels=LEVELS, size=SIZE):
    """Return points of a grid, a third of them at centers, middles of sides and corners of cells."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(0, size, (levels, POINTS, 2))
    return np.where(rng.random((levels, POINTS, 1)) < 1 / 3, np.round(2 * points) / 2, points)
