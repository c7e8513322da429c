import heapq
import itertools
import math

import numpy as np
import pytest
from voxel_helpers import random_volume

from plr_jax import Box, VoxelGraph
from plr_jax._types import DimensionedFn

CUBE = np.ones((3, 3, 3), bool)


def dijkstra(free, start, most, sides):
    """Distance of every voxel from one, by the book."""
    distance, heap = np.full(free.shape, np.inf), [(0.0, start)]
    distance[start] = 0.0
    while heap:
        length, at = heapq.heappop(heap)
        for step in itertools.product((-1, 0, 1), repeat=3):
            box = [tuple(map(sum, zip(at, part, strict=True))) for part in itertools.product(*[{0, s} for s in step])]
            inside = all(0 <= k < n for voxel in box for k, n in zip(voxel, free.shape, strict=True))
            if not 0 < np.count_nonzero(step) <= most or not inside or not all(free[voxel] for voxel in box):
                continue
            to = tuple(map(sum, zip(at, step, strict=True)))
            if (there := length + math.hypot(*(s * side for s, side in zip(step, sides, strict=True)))) < distance[
                to
            ]:
                distance[to] = there
                heapq.heappush(heap, (there, to))
    return distance


@pytest.mark.parametrize(("moves", "most"), [(6, 1), (18, 2), (26, 3)])
def test_distances_are_those_of_a_search_by_the_book(moves, most):
    rng = np.random.default_rng(moves)
    for sides in ((1, 1, 1), (1, 1, 1), (1, 0.3, 2), (0.01, 1, 3)):
        free = random_volume(rng, 3, 7, 0.3)
        graph = VoxelGraph(free, (0, 0, 0), moves, Box((0, 0, 0), np.array(free.shape) * sides))
        x = (np.argwhere(np.ones_like(free)) + 0.5) * sides
        np.testing.assert_allclose(graph(x), dijkstra(free, (0, 0, 0), most, sides).ravel(), rtol=1e-12)


def test_all_points_of_a_voxel_have_its_distance_and_those_elsewhere_none():
    free = CUBE.copy()
    free[1, 1] = False
    graph = VoxelGraph(free, (0.2, 0.9, 0.5), 6)
    assert graph([[2, 0, 0], [2.9, 0.5, 0.999], [3, 3, 3], [0, 1, 0]]).tolist() == [2, 2, 6, 1]
    assert graph([[1.5, 1.5, 1], [-0.1, 0, 0], [3.1, 0, 0], [np.nan, 0, 0], [np.inf, 0, 0]]).tolist() == [np.inf] * 5
    assert graph(np.zeros((0, 3))).shape == (0,)
    assert (
        graph.dim == 3 and isinstance(graph, DimensionedFn) and repr(graph) == "VoxelGraph(3 x 3 x 3 voxels, 6 moves)"
    )
    other = graph.with_goal((2.5, 0.5, 0.5))
    assert other([[0, 0, 0]]) == [2] and other.goal.tolist() == [2.5, 0.5, 0.5] and graph([[0, 0, 0]]) == [0]


def test_diagonal_steps_need_all_voxels_of_their_box():
    free = np.ones((2, 2, 2), bool)
    assert VoxelGraph(free, (0, 0, 0))([[1, 1, 1]]) == pytest.approx(3**0.5)
    free[1, 0, 1] = False
    assert VoxelGraph(free, (0, 0, 0))([[1, 1, 1]]) == pytest.approx(1 + 2**0.5)
    parted = np.zeros((2, 2, 2), bool)
    parted[0, 0, 0] = parted[1, 1, 1] = True
    assert VoxelGraph(parted, (0, 0, 0))([[1, 1, 1]]) == [np.inf]


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: VoxelGraph(CUBE.astype(int), (0, 0, 0)), "booleans of 3 axes.*got int64"),
        (lambda: VoxelGraph(CUBE[0], (0, 0)), "booleans of 3 axes"),
        (lambda: VoxelGraph(CUBE[:0], (0, 0, 0)), "at least one free"),
        (lambda: VoxelGraph(CUBE, (0, 0, 0), 8), "moves must be 6, 18 or 26, got 8"),
        (lambda: VoxelGraph(CUBE, (0, 0, 4)), "The goal must be in a free voxel"),
        (lambda: VoxelGraph(CUBE, (0, 0)), "The goal must be"),
        (lambda: VoxelGraph(CUBE, (0, 0, 0), bounds=((0, 0), (1, 1))), "bounds must have 3 axes"),
        (lambda: VoxelGraph(CUBE, (0, 0, 0))(np.zeros((1, 2))), r"x must have shape \(n, 3\)"),
    ],
)
def test_bad_input_is_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
