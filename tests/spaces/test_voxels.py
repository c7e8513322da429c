import numpy as np
import pytest
from space_helpers import states
from voxel_helpers import passes, random_volume, state_of

from plr_jax import VoxelSpace
from plr_jax.plr.tree import Cells
from plr_jax.spaces import CellState, ConfigurationSpace, SeesBoxes

BLOCKED, FREE, MIXED = CellState
CHECKERS = np.array([[True, False], [False, True]])


def half_steps(rng, free, n):
    """Return points at multiples of a half, many of them on faces, edges and corners."""
    return rng.integers(0, 2 * np.array(free.shape) + 1, (n, free.ndim)) / 2


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_free_motions_equal_exact_arithmetic(dim):
    rng = np.random.default_rng(dim)
    counts = np.zeros(2, int)
    for _ in range(10):
        free = random_volume(rng, dim, share=0.2 + 0.3 * rng.random())
        q0, q1 = half_steps(rng, free, 24), half_steps(rng, free, 24)
        # A third in any direction, crossing mostly single faces; a third through corners, where rounding matters.
        q0[8:] = rng.random((16, dim)) * free.shape
        q1[8:16] = rng.random((8, dim)) * free.shape
        q1[16:] = np.round(q0[16:]) + (np.round(q0[16:]) - q0[16:]) * rng.choice([1, 2], (8, 1))
        answers = VoxelSpace(free).are_free(q0, q1)
        expected = [passes(free, a, b) for a, b in zip(q0, q1, strict=True)]
        assert answers.tolist() == expected
        counts += np.bincount(answers, minlength=2)
    assert counts.min() > 10


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_states_of_boxes_equal_their_samples(dim):
    rng = np.random.default_rng(dim)
    found = []
    for _ in range(8 if dim < 4 else 3):
        free = random_volume(rng, dim, 4 if dim < 4 else 2)
        lo = half_steps(rng, free, 8) - 0.5
        hi = lo + rng.integers(1, 4 if dim < 4 else 3, lo.shape) / 2
        state = VoxelSpace(free).classify(lo, hi)
        assert state.tolist() == [state_of(free, *box) for box in zip(lo, hi, strict=True)]
        found += state.tolist()
    assert set(found) == set(CellState)


def test_no_path_passes_edges_where_voxels_touch():
    plane = VoxelSpace(CHECKERS)
    boxes = (0, 0, 1, 1), (0, 0, 0.9, 1), (0.5, 0.5, 1.5, 1.5), (1, 0, 2, 1)
    assert states(plane, *boxes) == [MIXED, FREE, MIXED, BLOCKED]
    ends = [[0.5, 0.5], [0.5, 0.5], [1.0, 1.0]], [[1.5, 1.5], [1.0, 1.0], [1.0, 1.0]]
    assert plane.are_free(*ends).tolist() == [False, True, True]
    q = [[1, 1], [1.0, 0.5], [1.5, 0.5], [0, 0], [2, 0]]
    assert plane.is_free(q).tolist() == [True, True, False, True, False]
    # If all is free above, paths may pass the upper end of the edge.
    space = VoxelSpace(np.stack([CHECKERS, np.ones((2, 2), bool)], axis=2))
    assert states(space, (0, 0, 0, 1, 1, 0.5), (0, 0, 1, 1, 1, 2), (0, 0, 0, 0.9, 1, 1)) == [MIXED, FREE, FREE]
    ends = [[0.5, 0.5, 0.5], [0.5, 0.5, 1.0], [1, 1, 0]], [[1.5, 1.5, 0.5], [1.5, 1.5, 1], [1, 1, 2]]
    assert space.are_free(*ends).tolist() == [False, True, True]


def test_balls_touch_walls_of_tight_passages():
    free = np.ones((4, 3, 3), bool)
    free[1:3, 0] = free[1:3, 2] = False
    space = VoxelSpace(free, radius=0.5)
    assert space.are_free([[0.5, 1.5, 0.5]], [[3.5, 1.5, 0.5]])[0]
    assert not space.are_free([[0.5, 1.5, 0.5]], [[3.5, 1.51, 0.5]])[0]
    # Past an edge at exactly the radius: a tangent of the cylinder around the edge.
    free = np.ones((6, 6, 3), bool)
    free[2, 2] = False
    across, out = np.array([0.7, -0.7, 0.14]), np.array([[1.0], [1 - 1e-6]]) / np.sqrt(2)
    tangent = np.array([3.0, 3.0, 1.5]) + out * [1.0, 1.0, 0.0]
    assert VoxelSpace(free, radius=1.0).are_free(tangent - across, tangent + across).tolist() == [True, False]


def test_voxels_of_unequal_sides_fill_the_bounds():
    free = np.ones((2, 5, 1), bool)
    free[1, 2] = False
    space = VoxelSpace(free, ((0, -1, 3), (4, 0, 3.1)), radius=0.02)
    assert space.domain.width.tolist() == pytest.approx([4, 1, 0.1])
    q = [[2.5, -0.5, 3.05], [2.5, -0.62, 3.05], [2.5, -0.61, 3.05], [1.97, -0.5, 3.05]]
    assert space.is_free(q).tolist() == [False, True, False, True]
    assert isinstance(space, ConfigurationSpace) and isinstance(space, SeesBoxes)
    assert space.motion_cost.lengths([[0, -1, 3]], [[3, -1, 3]], space.domain) == 3
    with pytest.raises(ValueError, match="read-only"):
        space.free[0, 0, 0] = False


def test_walls_on_faces_of_cells_stay_there_after_rounding():
    """Walls flush with cells of a partition stay flush if sides are not binary fractions."""
    free = np.kron(np.random.default_rng(0).random((16, 4)) < 0.5, np.ones((3, 3))) > 0
    free[0, 0] = True
    cells = Cells.root(2)
    for axis in (0, 0, 0, 0, 1, 1):
        cells = cells.split(np.full(len(cells), axis))
    units = VoxelSpace(free)
    of_units = units.classify(*cells.boxes(units.domain))
    assert set(of_units.tolist()) >= {CellState.FREE, CellState.BLOCKED}
    for lo, side in ((0, 0.05), (-0.4, 0.3), (1e3, 0.7)):
        space = VoxelSpace(free, ((lo, lo), (lo + 48 * side, lo + 12 * side)))
        np.testing.assert_array_equal(space.classify(*cells.boxes(space.domain)), of_units)


@pytest.mark.parametrize("radius", [0.0, 0.1])
def test_points_and_boxes_outside_are_not_free(radius):
    space, one = VoxelSpace(np.ones((2, 2), bool), radius=radius), np.ones((5, 2))
    q = np.array([[np.nan, 1], [np.inf, 1], [2.1, 1], [1, -1e-12], [1e300, 0]])
    assert not (space.is_free(q) | space.are_free(q, one) | space.are_free(one, q)).any()
    assert states(space, (2, 0, 3, 1), (-3, -3, 5, 5), (1.5, 0, 2.5, 1)) == [BLOCKED, MIXED, MIXED]


def test_seen_boxes_have_only_visible_samples():
    rng = np.random.default_rng(0)
    counts = np.zeros(2, int)
    for _ in range(8):
        free = random_volume(rng, 3, 4)
        space = VoxelSpace(free)
        lo = half_steps(rng, free, 40) - 0.25
        hi = lo + rng.integers(1, 5, lo.shape) / 4
        q = np.where(rng.random(lo.shape) < 0.5, lo, hi)
        sees = space.sees_boxes(q, lo, hi)
        x = (lo[:, None] + rng.integers(0, 5, (40, 60, 3)) / 4 * (hi - lo)[:, None]).reshape(-1, 3)
        free = space.is_free(x)
        visible = (space.are_free(x, np.repeat(q, 60, axis=0)) | ~free).reshape(40, 60).all(axis=1)
        assert visible[sees].all()
        counts += [sees.sum(), (visible & free.reshape(40, 60).any(axis=1) & space.is_free(q) & ~sees).sum()]
    assert counts[0] > 2 * counts[1]
    assert not VoxelSpace(CHECKERS).sees_boxes([[1, 1]], [[0.5, 0.5]], [[1, 1]])[0]
    assert not VoxelSpace(np.ones((2, 2), bool), radius=0.1).sees_boxes([[1, 1]], [[0.5, 0.5]], [[1, 1]])[0]
