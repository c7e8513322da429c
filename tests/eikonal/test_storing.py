import numpy as np
import pytest
from eikonal_helpers import EMPTY, ROOM, check_bounds, random_mesh

from plr_jax import PlaneSpace, VisibilityGraph, solve_eikonal
from plr_jax.eikonal.solve import _changes_beside, _field, _intersections, _with_proof
from plr_jax.plr._file import Contents
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import CornerLeafModel
from plr_jax.plr.partition.cells import PLACING, Cells, levels_of, tree_of
from plr_jax.plr.partition.faces import overlapping_leaves


def random_tree(seed, dim, splits=40):
    """Leaves halved along one axis at a time."""
    rng = np.random.default_rng(seed)
    cells = Cells.root(dim)
    for _ in range(splits):
        one = rng.integers(len(cells))
        rest = np.delete(np.arange(len(cells)), one)
        cells = cells[rest].append(cells[[one]].split(rng.integers(dim, size=1)))
    return tree_of(cells)


def ends(cells):
    return np.ldexp(cells.position.astype(float), -cells.depth), np.ldexp(cells.position + 1.0, -cells.depth)


@pytest.mark.parametrize("dim", [1, 2, 3])
def test_what_overlapping_leaves_have_in_common(dim):
    for seed in range(5):
        a, b = random_tree(seed, dim), random_mesh(seed, dim, rounds=2).tree
        first, second = overlapping_leaves(a, b)
        (lo_a, hi_a), (lo_b, hi_b) = ends(a.leaves), ends(b.leaves)
        lo, hi = _intersections(a.leaves, first, b.leaves, second)
        np.testing.assert_allclose((hi - lo).prod(axis=1).sum(), 1, rtol=1e-12)
        np.testing.assert_array_equal(lo, np.maximum(lo_a[first], lo_b[second]))
        np.testing.assert_array_equal(hi, np.minimum(hi_a[first], hi_b[second]))


def test_functions_change_beside_leaves_by_no_more_than_is_said():
    rng = np.random.default_rng(0)
    cells = random_tree(1, 2).leaves
    corners = rng.normal(size=(len(cells), 4))
    most = _changes_beside(cells, corners)
    share = PLACING * np.ldexp(1.0, cells.depth)
    for _ in range(200):
        inside = rng.integers(0, 2, (len(cells), 2)).astype(float)
        beside = inside + (2 * inside - 1) * share * rng.integers(0, 2, (len(cells), 2))
        value = [
            np.sum(np.stack([(1 - t) * (1 - s), (1 - t) * s, t * (1 - s), t * s], axis=1) * corners, axis=1)
            for t, s in (inside.T, beside.T)
        ]
        assert (np.abs(value[1] - value[0]) <= most * (1 + 1e-9)).all()


def test_a_leaf_a_cell_or_fewer_leaves_in_so_many_bytes():
    one_a_cell = solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=200)
    few = solve_eikonal(PlaneSpace(ROOM), (0.3, 0.4), max_leaves=200, max_bytes=150)
    assert (one_a_cell.cells.depth[:, 0] == one_a_cell.cells.depth[:, 1]).all()
    assert (few.cells.depth[:, 0] != few.cells.depth[:, 1]).any() and few.num_bytes <= 150
    check_bounds(few, ROOM, VisibilityGraph(ROOM, (0.3, 0.4)))
    x = ROOM.sample_free(2000, 0)
    assert np.asarray(few.bounds(x)[0]).mean() < np.asarray(one_a_cell.bounds(x)[0]).mean()


def test_nothing_is_proven_of_leaves_that_answer_inf_for_open_cells():
    field = _field(EMPTY, None, np.array([0.1, 0.1]), 64, 0.0)
    mesh, model = field.mesh, leaf_model("continuous")
    closed = mesh.boxes[0].max(axis=1) > 0.3
    assert isinstance(model, CornerLeafModel) and closed.any()
    tied = ~closed[mesh.all_faces.lower] & ~closed[mesh.all_faces.upper]
    stored = model.of_corners(mesh.tree, mesh.all_faces, tied, closed, field.corner_values, 1e-3)
    contents = Contents(mesh.domain, model, levels_of(mesh.cells)[0], mesh.cells, stored)
    with pytest.raises(ValueError, match=r"some leaves answer inf, .* Allow more max_bytes"):
        _with_proof(contents, tree_of(contents.cells), field)
