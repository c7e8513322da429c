"""The lower bounds by which a query of pairs orders corners."""

import numpy as np

from plr_jax.pairs.tables import NO_WAY, STEEPEST, _bounds_to_leaves


def test_bounds_to_leaves_are_below_and_near_shortest_paths():
    rng, (leaves, longest, size) = np.random.default_rng(0), (8, 4, 12)
    corners, middles = rng.random((size, 2)), rng.random((leaves, 2))
    halves, distances = rng.uniform(0.01, 0.1, (leaves, 2)), rng.random((size, size)) + 0.5
    corners[0] = middles[0]  # the distance to this corner has no gradient there
    listed = np.stack([rng.permutation(size - 1)[:longest] for _ in range(leaves)])
    listed[1:3, 1:], listed[3], corners[-1] = size - 1, size - 1, np.inf  # padding
    distances[-1], distances[:, -1], distances[listed[4], 5] = np.inf, np.inf, np.inf
    corners, middles, halves, distances = (each.astype(np.float32) for each in (corners, middles, halves, distances))
    step = np.array(2**-15, np.float32)
    packed = _bounds_to_leaves(distances, listed.astype(np.uint16), corners, middles, halves, step)
    away = (rng.uniform(-1, 1, (200, leaves, 2)) * halves).astype(np.float64)
    legs = np.linalg.norm((middles + away)[:, :, None] - corners.astype(np.float64)[listed], axis=3)
    paths = (legs[..., None] + distances.astype(np.float64)[listed]).min(axis=2)
    slopes = np.stack([packed >> 16 & 255, packed >> 24], axis=-1).astype(np.float64) - STEEPEST
    length = packed & NO_WAY
    bounds = length * float(step) + (away[:, :, None] * slopes / STEEPEST).sum(axis=-1)
    reached = np.isfinite(paths[0])
    np.testing.assert_array_equal(length < NO_WAY, reached)
    assert not reached[3].any() and not reached[4, 5]
    assert (bounds <= paths)[:, reached].all()
    # Slopes of two paths differ by 2 at most.
    assert (paths - bounds <= 4 * halves.sum(axis=1)[:, None] + 2 * step)[:, reached].all()
    alone = paths[:, 1:3, :-1] - bounds[:, 1:3, :-1]  # a single path bends little
    assert alone.max() < 0.1
