import numpy as np
import pytest
from eikonal_helpers import ROOM
from tqdm import tqdm

from plr_jax import PlaneSpace, Workspace, solve_eikonal
from plr_jax.eikonal import lower
from plr_jax.eikonal.lower import SlopeSolver
from plr_jax.spaces import CellState

THIN_WALL = Workspace(((0, 0), (1, 1)), [[(0.52, 0.0), (0.523, 0.0), (0.523, 0.8), (0.52, 0.8)]])


def solver_of(workspace, max_cells):
    """A solver that is through."""
    solver = SlopeSolver(PlaneSpace(workspace), None, np.array([0.9, 0.1]), max_cells, 0.0)
    solver.refine(tqdm(disable=True))
    return solver


def test_cells_are_likely_blocked_where_a_thin_wall_is_in_the_way_and_free_beside_one():
    wall_beside = Workspace(((0, 0), (1, 1)), [[(0.0, 0.48), (0.8, 0.48), (0.8, 0.483), (0.0, 0.483)]])
    for workspace, is_crossed in ((THIN_WALL, True), (wall_beside, False)):
        solver = solver_of(workspace, 64)
        likely = solver.likely_mesh()
        lo, hi = likely.boxes
        mixed = solver.mesh.state == CellState.MIXED
        assert mixed.any() and (likely.state != CellState.MIXED).all()
        np.testing.assert_array_equal(likely.state[~mixed], solver.mesh.state[~mixed])
        deep = mixed & (hi[:, 1] < 0.5) & (lo[:, 0] > 0.3) if is_crossed else mixed & (hi[:, 0] < 0.6)
        share = np.mean(likely.state[deep] == CellState.BLOCKED)
        assert share > 0.9 if is_crossed else share < 0.9


def test_walls_too_thin_for_their_cells_are_refined_first():
    mesh = solver_of(THIN_WALL, 400).mesh
    lo, hi = mesh.boxes
    at_wall = (lo[:, 0] < 0.523) & (hi[:, 0] > 0.52) & (lo[:, 1] < 0.7)
    assert mesh.widths[at_wall].mean() < 0.3 * mesh.widths[~at_wall].mean()


def test_what_has_not_converged_says_so(monkeypatch):
    monkeypatch.setattr(lower, "_MOST", 11)
    with pytest.warns(UserWarning, match="has not converged in 11 iterations: the bounds hold"):
        solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=100)
