"""Cells of oracles, for one goal and several: pieces are the free parts, sources bound the distance there."""

import numpy as np
import pytest
import shapely
from oracle_helpers import MIDDLE
from piece_helpers import SEEDS, TEN, box, points_of, polygons, random_workspace

from plr_jax import Box, NearestGoal, VisibilityGraph, Workspace
from plr_jax.geometry.convex_pieces import areas
from plr_jax.plr.tree import Cells

# The workspaces go from 0 to 10 along both axes.
DOMAINS = (Box(*TEN), Box((-3, -1), (12, 14)), Box((2.3, 1.9), (7.1, 6)), Box((5, 5), (5.5, 7.5)))


def random_oracle(seed):
    workspace = random_workspace(seed)
    return VisibilityGraph(workspace, workspace.sample_free(1, seed)[0]), np.random.default_rng(seed)


def halved(cells, lo, hi, rng, times=1, share=0.8):
    """Halve a random share of cells, several times; return cells and boxes in random order."""
    for _ in range(times):
        split, alone = np.split(rng.permutation(len(lo)), [int(np.ceil(share * len(lo)))])
        parent, upper = rng.permutation([(each, side) for each in split for side in (0, 1)]).T
        axis, row = rng.integers(2, size=len(lo))[parent], np.arange(len(parent))
        new_lo, new_hi, middle = lo[parent], hi[parent], ((lo + hi) / 2)[parent, axis]
        new_lo[row, axis] = np.where(upper, middle, new_lo[row, axis])
        new_hi[row, axis] = np.where(upper, new_hi[row, axis], middle)
        parts = cells.parts(parent, axis, upper.astype(bool), new_lo, new_hi)
        cells = cells.of_cells(alone).append(parts)
        lo, hi = np.concatenate([lo[alone], new_lo]), np.concatenate([hi[alone], new_hi])
    return cells, lo, hi


def least_cones(found, piece, x):
    """Return the least cones at points: over all sources of a piece, and over those that all of it sees."""
    pairs = np.arange(found.first_pair[piece], found.first_pair[piece + 1])
    source = found.source[pairs]
    cone = found.sources.distances[source, None] + np.linalg.norm(x - found.sources.points[source, None], axis=2)
    return cone.min(axis=0), np.where(found.by_all[pairs, None], cone, np.inf).min(axis=0)


def check_in_order(cells):
    assert (np.diff(cells.cell) >= 0).all() and (np.diff(cells.piece) >= 0).all()
    assert set(cells.piece.tolist()) == set(range(len(cells.cell)))
    np.testing.assert_array_equal(cells.first_piece, [(cells.cell < c).sum() for c in range(cells.num_cells + 1)])
    np.testing.assert_array_equal(cells.first_pair, [(cells.piece < p).sum() for p in range(len(cells.cell) + 1)])
    pair = list(zip(cells.piece.tolist(), cells.source.tolist(), strict=True))
    assert len(set(pair)) == len(pair)
    assert set(zip(range(len(cells.cell)), cells.best.tolist(), strict=True)) <= set(pair)


def check_bounds(oracle, cells, rng):
    """Check that distances at random points of each piece lie between its bounds, and those at centers."""
    slack, few = cells.slack, rng.permutation(len(cells.cell))[:30]
    x = points_of(rng, cells.pieces[:, few], 10)
    exact = oracle(x.reshape(-1, 2)).reshape(-1, 10)
    bounds = [least_cones(cells, piece, at) for piece, at in zip(few, x, strict=True)]
    lower, upper = np.array(bounds).reshape(-1, 2, 10).swapaxes(0, 1)
    # Beside a tip, the oracle sees past the tip within the tolerance; a contact is reached from the nearest side.
    vertices = cells.sight.shadows.table.boundary.vertices
    clear = (np.linalg.norm(x[:, :, None] - vertices, axis=3) > 1e-5).all(axis=2)
    assert np.isfinite(exact).all()
    assert (exact >= lower - slack)[clear].all()
    assert (exact <= upper + slack).all()
    np.testing.assert_allclose(cells.distance, oracle(cells.center), atol=slack)
    at_centers = [least_cones(cells, piece, cells.center[[piece]]) for piece in range(len(cells.cell))]
    lower, upper = np.array(at_centers).reshape(-1, 2).T
    assert (lower <= cells.distance + 1e-12).all() and (upper >= cells.distance - 1e-12).all()


def check_area(oracle, workspace, cells, lo, hi):
    """Check that the pieces of each cell cover its part that reaches the goal, without overlap."""
    parts = shapely.get_parts(workspace.free_space)
    inside = np.array([part.representative_point().coords[0] for part in parts])
    reached_region = shapely.union_all(parts[np.isfinite(oracle(inside))])
    exact = shapely.area(shapely.intersection(reached_region, shapely.box(*lo.T, *hi.T)))
    shapes = np.array(polygons(cells.pieces))
    np.testing.assert_allclose(np.bincount(cells.cell, shapely.area(shapes), cells.num_cells), exact, atol=1e-8)
    one, other = np.triu_indices(len(shapes), 1)
    one, other = (each[cells.cell[one] == cells.cell[other]] for each in (one, other))
    overlap = shapely.intersection(shapes[one], shapes[other], grid_size=1e-9)  # without it GEOS errs at times
    assert shapely.area(overlap).sum() <= 1e-6
    assert (lo[cells.cell].T[:, :, None] - 1e-9 <= cells.pieces).all()
    assert (cells.pieces <= hi[cells.cell].T[:, :, None] + 1e-9).all()


@pytest.mark.parametrize("num_others", range(4))
@pytest.mark.parametrize("seed", [*SEEDS[:6:2], *SEEDS[7::2]])
def test_sources_of_pieces_bound_the_distance(seed, num_others):
    """The goal is a corner or in the open, or goals are anywhere, at a corner, and one of them twice."""
    oracle, rng = random_oracle(seed)
    workspace, domain = oracle.workspace, DOMAINS[(seed + num_others) % 4]
    if num_others == 0 and seed % 4 in (1, 2):
        oracle = oracle.with_goal(rng.permutation(workspace.boundary.vertices)[0])
    elif num_others:
        goals = [rng.permutation(workspace.boundary.vertices)[0], oracle.goal, workspace.sample_free(1, seed + 1)[0]]
        oracle = NearestGoal([oracle, *(VisibilityGraph(workspace, goal) for goal in goals[:num_others])])
    root = oracle.cell_sources(domain), domain.lo[None], domain.hi[None]
    for cells, lo, hi in (root, halved(*root, rng, rng.integers(1, 6))):
        assert cells.num_cells == len(lo)
        check_in_order(cells)
        check_area(oracle, workspace, cells, lo, hi)
        check_bounds(oracle, cells, rng)
    rows = rng.permutation(len(cells.cell))[:9]
    alone = cells.pieces_as_cells(rows)
    check_in_order(alone)
    np.testing.assert_array_equal(alone.pieces, cells.pieces[:, rows])
    check_bounds(oracle, alone, rng)


def test_sources_of_cells_around_a_wall():
    """The goal (1, 5) is in front of a wall, behind which paths turn at (6, 2) and (6, 8)."""
    oracle = VisibilityGraph(MIDDLE, (1, 5))

    def named(cells):
        return np.unique(cells.sources.points[cells.source], axis=0).tolist()

    lo, hi, zero = np.array([[0.0, 0], [2, 0]]), np.array([[2.0, 10], [4, 10]]), np.zeros(2, int)
    halves = oracle.cell_sources(Box((0, 0), (4, 10))).parts(zero, zero, np.array([False, True]), lo, hi)
    assert named(halves) == [[1, 5]] and halves.by_all.all()  # all of both see the goal
    behind = oracle.cell_sources(Box((8, 4.5), (9, 4.75)))
    assert named(behind) == [[6, 2]] and behind.by_all.all()
    assert named(oracle.cell_sources(Box((8, 4.5), (9, 5.5)))) == [[6, 2], [6, 8]]


def test_pieces_cover_outlines_with_slanted_edges():
    """``shapely.clip_by_rect`` returns larger polygons."""
    workspace = Workspace.from_mask(np.array([[1, 1, 1, 1], [0, 1, 0, 0], [1, 1, 1, 1]], bool))
    found = VisibilityGraph(workspace, (0.5, 0.5)).cell_sources(workspace.bounds)
    assert areas(found.pieces).sum() == pytest.approx(workspace.free_space.area)


def test_cells_that_do_not_reach_the_goal_are_empty():
    oracle = VisibilityGraph(Workspace(TEN, [box(4, 0, 6, 10)]), (1, 5))
    for corners in (((4.5, 1), (5.5, 9)), ((20, 20), (30, 30)), ((7, 1), (9, 9))):
        cells = oracle.cell_sources(Box(*corners))
        assert (cells.num_cells, len(cells.cell), len(cells.source)) == (1, 0, 0)
    parts, *_ = halved(cells, np.array([[7.0, 1]]), np.array([[9.0, 9]]), np.random.default_rng(0))
    assert (parts.num_cells, len(parts.cell)) == (2, 0)
    both = cells.append(oracle.cell_sources(DOMAINS[0]), parts)
    assert both.num_cells == 4 and set(both.cell.tolist()) == {1}


@pytest.mark.parametrize("seed", SEEDS)
def test_hold_and_see_equal_shapely(seed):
    oracle, rng = random_oracle(seed)
    cells, _, _ = halved(oracle.cell_sources(DOMAINS[0]), *np.array(TEN)[:, None].astype(float), rng, 3)
    piece = rng.integers(len(cells.cell), size=20)
    x = np.concatenate([points_of(rng, cells.pieces[:, piece], 5), rng.uniform(0, 10, (20, 5, 2))], axis=1)
    shapes = np.array(polygons(cells.pieces))[piece]
    held, margin, points = cells.hold(piece, x), 4 * oracle.workspace.tolerance, shapely.points(x)
    assert held[shapely.covers(shapely.buffer(shapes, -margin)[:, None], points)].all() and held[:, :5].all()
    assert not held[~shapely.covers(shapely.buffer(shapes, margin)[:, None], points)].any()
    source = rng.integers(len(oracle.sources.points), size=100)
    contacts = oracle.workspace.boundary.vertices[oracle.workspace.boundary.contacts]
    usual = ~(oracle.sources.points[source][:, None] == contacts).all(axis=2).any(axis=1)
    y = oracle.workspace.sample_free(100, seed)
    seen = oracle.workspace.is_visible(oracle.sources.points[source], y)
    np.testing.assert_array_equal(cells.see(source, y)[usual], seen[usual])


def test_sources_and_parents_form_shortest_paths():
    oracle, _ = random_oracle(1)
    sources = oracle.sources
    np.testing.assert_allclose(sources.distances, oracle(sources.points), atol=1e-9)
    onward = sources.parents
    reached = np.isfinite(sources.distances)
    leg = np.linalg.norm(sources.points - sources.points[onward], axis=1)
    np.testing.assert_allclose((sources.distances[onward] + leg)[reached], sources.distances[reached])
    np.testing.assert_array_equal(onward[~reached], np.flatnonzero(~reached))
    assert onward[0] == 0 and (onward[reached][1:] != np.flatnonzero(reached)[1:]).all()


# Several goals at once: samples of boxes, and the distance and first turn to every goal there.

GRID = Cells(np.full((64, 2), 3), np.stack(np.divmod(np.arange(64), 8), axis=1))


@pytest.mark.parametrize("seed", SEEDS)
def test_first_turns_at_shared_samples_equal_oracles(seed):
    workspace = random_workspace(seed)
    goals = workspace.sample_free(3, seed)
    first = VisibilityGraph(workspace, goals[0])
    lo, hi = GRID.boxes(workspace.bounds)
    samples = first.shared_samples(lo, hi)
    free = shapely.area(shapely.intersection(shapely.box(*lo.T, *hi.T), workspace.free_space))
    np.testing.assert_allclose(samples.weight, free / np.prod(hi - lo, axis=1), atol=1e-7)
    some = samples.weight > 0
    x = samples.x[some]
    assert np.isnan(samples.x[~some]).all() and workspace.is_free(x).all()
    assert ((lo[some] <= x) & (x <= hi[some])).all()
    for oracle in (first, *map(first.with_goal, goals[1:])):
        distance, vertex = oracle.first_turns(samples)
        np.testing.assert_allclose(distance[some], oracle(x), rtol=1e-12, atol=1e-12)
        np.testing.assert_array_equal(vertex >= 0, np.isfinite(distance))
        assert np.isinf(distance[~some]).all()
        at, turn = samples.x[vertex >= 0], vertex[vertex >= 0]
        way = oracle.sources.distances[turn] + np.linalg.norm(at - oracle.sources.points[turn], axis=1)
        np.testing.assert_allclose(distance[vertex >= 0], way, rtol=1e-12)
        assert workspace.is_visible(at, oracle.sources.points[turn]).all()


@pytest.mark.parametrize("seed", SEEDS)
def test_cells_of_several_goals_bound_each_distance(seed):
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    goals = workspace.sample_free(3, seed)
    oracles = list(map(VisibilityGraph(workspace, goals[0]).with_goal, goals))
    coarse = Cells(np.full((16, 2), 2), np.stack(np.divmod(np.arange(16), 4), axis=1))
    lo, hi = coarse.boxes(Box((-1, -1), (11, 11)))
    shared = oracles[0].shared_cells(lo, hi)
    box, member = rng.integers(16, size=20), np.sort(rng.integers(3, size=20))
    found = oracles[0].cells_of_members(shared, oracles, box, member)
    assert found.num_cells == 20
    count = len(oracles[0].sources.points)
    assert (found.source // count == member[found.cell[found.piece]]).all()
    for number, oracle in enumerate(oracles):
        cells = np.flatnonzero(member == number)
        own = found.of_cells(cells), lo[box[cells]], hi[box[cells]]
        for each, each_lo, each_hi in (own, halved(*own, rng)):
            check_area(oracle, workspace, each, each_lo, each_hi)
            check_bounds(oracle, each, rng)
