"""Construction of pairs: budgets, bytes, what is refused, and the lattice and the lists that a file is made of."""

import numpy as np
import pytest
from pair_helpers import MAZE
from piece_helpers import TEN, WORKSPACES, box

from plr_jax import VisibilityGraph, Workspace, construct_pairs
from plr_jax.geometry.corners import CornerVisibility
from plr_jax.pairs.construct import corners_of_cells, corners_seen, grow_lists, lattice_step
from plr_jax.plr.certificate import Proof
from plr_jax.plr.leaves import leaf_model
from plr_jax.plr.leaves.base import GivenLimits, check_limits
from plr_jax.plr.tree import Cells

LIMITS = check_limits(leaf_model("cone"), 2, Proof.NONE, 13, GivenLimits(max_bytes=10_000))


def test_smaller_budgets_give_fewer_leaves_and_equal_budgets_equal_bytes():
    budgets = np.array([200, 400, 800])
    sizes = [construct_pairs(MAZE, max_bytes=size) for size in budgets.tolist()]
    assert (np.array([pairs.num_bytes for pairs in sizes]) <= budgets).all()
    assert sizes[0].num_leaves < sizes[1].num_leaves < sizes[2].num_leaves
    assert construct_pairs(MAZE, max_bytes=200).to_bytes() == sizes[0].to_bytes()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("workspace", "max_bytes", "message"),
    [
        (np.zeros((3, 3)), None, "Workspace"),
        ([[0, 0]], None, "Workspace"),
        (None, None, "Workspace"),
        (MAZE, 50, "alone take .*max_bytes=50"),
        (MAZE, 0, "max_bytes"),
        (Workspace(((0, 0), (1e20, 1e20))), None, "wide"),
    ],
)
def test_wrong_arguments_raise(workspace, max_bytes, message):
    with pytest.raises(ValueError, match=message):
        construct_pairs(workspace, max_bytes=max_bytes)


def test_error_names_the_default_budget(monkeypatch):
    monkeypatch.setattr("plr_jax.pairs.construct.DEFAULT_MAX_BYTES", 50)
    with pytest.raises(ValueError, match="max_bytes=50"):
        construct_pairs(MAZE)


@pytest.mark.parametrize(
    ("obstacle", "x", "y", "length"),
    [
        (box(5, 0, 5 + 1e-5, 8), (4, 1), (6, 1), 2 * 50**0.5),
        (np.array([(5, 0), (5 + 1e-8, 0), (5 + 1e-8, 8), (5, 8)]), (4, 1), (6, 1), 2 * 50**0.5),
        # A needle, whose blunt end and tip paths go around.
        (np.array([(2, 4), (8, 5), (2, 4 + 1e-7)]), (4, 3), (4, 6), 5**0.5 + 8**0.5),
        (np.array([(2, 4), (8, 5), (2, 4 + 1e-7)]), (7, 4), (7, 6), 2 * 2**0.5),
        # A corner cut off by less.
        (np.array([(2, 4), (8, 4), (8, 6 - 1e-7), (8 - 1e-7, 6), (2, 6)]), (7, 7), (9, 5), 2 * 2**0.5),
    ],
)
def test_paths_lead_around_walls_thinner_than_32_bits_resolve(obstacle, x, y, length):
    pairs = construct_pairs(Workspace(TEN, [obstacle]), max_bytes=512).numpy()
    lower, upper = pairs.bounds(x, y)
    assert pairs(x, y) == pytest.approx(length, abs=5e-5) and lower <= length <= upper


@pytest.mark.parametrize("step", [2.0, 0.25, 0.1, 0.001, 2.0**-12])
def test_lattice_is_the_widest_that_holds_all_points(step):
    points = step * np.random.default_rng(0).integers(-40, 40, (50, 2))
    points[0] = step  # odd, so that no wider one holds it
    assert lattice_step(points, 4096.0, 1e-9, np.inf) == pytest.approx(step, rel=1e-12)


def test_lattice_is_fine_if_none_holds_the_points():
    points = np.array([[np.pi, 1.0]])
    assert lattice_step(points, 8.0, 1e-12, np.inf) == 8 * 2.0**-24
    assert lattice_step(points, 8.0, 1e-12, 2.0**-30) == 2.0**-32
    assert lattice_step(points, 8.0, 1e-12, 1e-20) == 8 * 2.0**-37


def grown(workspace, most_leaves):
    """Corners, the leaves' lists of them, and their boxes."""
    visibility = CornerVisibility.of(workspace)
    bounds = workspace.bounds
    root = corners_seen(visibility, workspace.triangulation, bounds)
    cells, lists = grow_lists(root, workspace.bounds, LIMITS, most_leaves, lambda leaves: 0)
    assert np.ldexp(1.0, -cells.depth.sum(axis=1)).sum() == 1
    return visibility.corners, lists, *cells.boxes(workspace.bounds)


def listed_at(grown_lists, x):
    """The corners that are listed for the first leaf that holds a point."""
    corners, lists, lo, hi = grown_lists
    cell = np.flatnonzero(((lo <= x) & (x <= hi)).all(axis=1))[0]
    return corners.points[lists[[cell]].indices]


@pytest.mark.parametrize("kind", WORKSPACES)
@pytest.mark.parametrize("seed", range(2))
def test_lists_hold_first_turns_of_all_paths(kind, seed):
    workspace = kind(np.random.default_rng(seed))
    goals, starts = workspace.sample_free(3, seed), workspace.sample_free(8, seed + 1)
    oracle = VisibilityGraph(workspace, goals[0])
    paths = [oracle.with_goal(goal).shortest_path(x) for goal in goals for x in starts]
    for most_leaves in (1, 40):
        lists = grown(workspace, most_leaves)
        assert len(lists[2]) >= most_leaves // 4
        for start, turn, *_ in (path for path in paths if len(path) > 2):
            assert (np.abs(listed_at(lists, start) - turn).max(axis=1, initial=0.0) <= 1e-9).any()


@pytest.mark.parametrize("kind", WORKSPACES)
def test_corners_seen_by_a_whole_cell_are_seen_from_its_points(kind):
    workspace, cells = kind(np.random.default_rng(7)), Cells.root(2)
    visibility, domain = CornerVisibility.of(workspace), workspace.bounds
    visible = corners_seen(visibility, workspace.triangulation, domain)
    for axis in (0, 1, 0, 1, 0):
        cells, parent = cells.split(np.full(len(cells), axis)), np.repeat(np.arange(len(cells)), 2)
        is_upper = np.arange(len(cells)) % 2 == 1
        visible = visible.parts(parent, np.full(len(cells), axis), is_upper, *cells.grown_boxes(domain))
    cell, corner, by_all = corners_of_cells(visible)
    assert by_all.any()
    for points in np.random.default_rng(8).uniform(*cells.boxes(domain), (20, len(cells), 2)):
        own, seen = points[cell[by_all]], visibility.corners.points[corner[by_all]]
        free = workspace.is_free(own)
        assert workspace.is_visible(own[free], seen[free]).all()
