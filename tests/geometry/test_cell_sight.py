"""Visibility of convex pieces and boxes from viewpoints, compared with Shapely and with values by hand."""

import numpy as np
import pytest
import shapely
from piece_helpers import SEEDS, TEN, as_pieces, box, points_of, random_workspace

from plr_jax import VisibilityGraph
from plr_jax.geometry.box import Box
from plr_jax.geometry.cell_sight import CellSources, Shadows, corner_sight, turns_by_triangle
from plr_jax.geometry.convex_pieces import areas, clip_to_boxes
from plr_jax.geometry.corners import CornerVisibility
from plr_jax.geometry.visibility import Viewpoints, VisibilityTable, visibility_of
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs.construct import corners_of_cells

NONE = np.empty(0, int)


def shadows_around(workspace, *open_points):
    """Return the shadows of points in the open, followed by those of all corners."""
    views = Viewpoints(np.array(open_points, float).reshape(-1, 2), NONE, NONE)
    table, _ = visibility_of(workspace.triangulation, views)
    return Shadows.of(VisibilityTable.joined([table, CornerVisibility.of(workspace).table]))


def free_pieces(triangles, rng, n):
    """Return parts of triangles inside random boxes, a few of which are aligned with a lattice."""
    triangles, parts = as_pieces(triangles), []
    for _ in range(n):
        lo, hi = np.sort(rng.uniform(0, 10, (2, 2)), axis=0)
        if rng.random() < 0.3:
            lo, hi = np.floor(lo), np.ceil(hi)
        parts.append(clip_to_boxes(triangles, lo[None], hi[None])[0])
    pieces = np.concatenate(parts, axis=1)
    return pieces[:, rng.permutation(pieces.shape[1])[:n]]


@pytest.mark.parametrize(("turn", "gap"), [(0.1, 0.0), (0.7, 0.0), (1.4, 1e-3), (1.0, 1e-6), (1.0, 5e-163)])
def test_wholly_seen_pieces_are_seen_beside_their_corners(turn, gap):
    """Sights along walls that are collinear but for rounding, to a sharp gap between the first one and the bounds."""
    along = 0.2 * np.array([np.cos(turn), -np.sin(turn)])
    below, start = np.array([along[1], -along[0]]), np.array([gap, 0.63])
    cell = np.array([0 * along, along, along + below, below])
    workspace = Workspace(((0, 0), (1, 1)), [start + cell, start + 2 * along + cell])
    shadows, pieces = shadows_around(workspace), as_pieces(workspace.triangulation.triangles)
    view, piece = (each.ravel() for each in np.indices((len(shadows.table.points), pieces.shape[1])))
    center = pieces.mean(axis=2).T
    seen, is_whole = shadows.see(view, pieces[:, piece], center[piece])
    view, piece = view[seen & is_whole], piece[seen & is_whole]
    for corner in pieces[:, piece].transpose(2, 1, 0)[:3]:
        x = corner + 1e-6 * (center[piece] - corner)
        assert shadows.table.sees(view, x).all()


@pytest.mark.parametrize("seed", [*SEEDS, 902, 2216])
def test_seen_pieces_equal_visibility_of_point_pairs(seed):
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    shadows = shadows_around(workspace, *workspace.sample_free(2, seed))
    pieces = free_pieces(workspace.triangulation.triangles, rng, 25)
    # Viewpoints in contacts of obstacles look into one side of them only, which Shapely does not.
    contacts = workspace.boundary.vertices[workspace.boundary.contacts]
    one_sided = np.flatnonzero(~(shadows.table.points[:, None] == contacts).all(axis=2).any(axis=1))
    view, piece = rng.choice(one_sided, 300), rng.integers(pieces.shape[1], size=300)
    center = pieces.mean(axis=2).T
    seen, alike = shadows.see(view, pieces[:, piece], center[piece])
    x = points_of(rng, pieces, 12)[piece]
    inside = np.einsum("pkc,dpc->pkd", rng.dirichlet(np.ones(pieces.shape[2]), (300, 12)), pieces[:, piece])
    x += 1e-3 * (inside - x)  # off walls and shadows, on which a hair decides
    pairs = np.repeat(shadows.table.points[view], 12, axis=0), x.reshape(-1, 2)
    differs = workspace.is_visible(*pairs).reshape(-1, 12) != seen[:, None]
    # Beside a contact, segments pass within the tolerance.
    differs &= (np.linalg.norm(x[:, :, None] - contacts, axis=3) > 1e-3).all(axis=2)
    differs &= workspace.clearance(x.reshape(-1, 2)).reshape(-1, 12) > 10 * workspace.tolerance
    # A sight that passes a corner within the tolerance may be decided either way.
    corners, from_view = workspace.boundary.vertices, shadows.table.points[view]
    for row, at in np.argwhere(differs & alike[:, None]):
        passed = corners[np.linalg.norm(corners - from_view[row], axis=1) > workspace.tolerance]
        sight = shapely.LineString([from_view[row], x[row, at]])
        assert shapely.distance(shapely.points(passed), sight).min() <= workspace.tolerance
    assert alike.mean() > 0.5


@pytest.mark.parametrize("seed", SEEDS)
def test_cells_without_walls_are_one_piece(seed):
    workspace, rng = random_workspace(seed), np.random.default_rng(seed)
    visibility, triangulation = CornerVisibility.of(workspace), workspace.triangulation
    lo, hi = np.sort(rng.uniform(-1, 11, (2, 30, 2)), axis=0)
    lists = turns_by_triangle(visibility, triangulation)
    found = CellSources.of_boxes(corner_sight(visibility, triangulation), lists, lo, hi)
    walls = shapely.multilinestrings(list(shapely.linestrings(workspace.boundary.segments)))
    reach = shapely.length(shapely.intersection(walls, shapely.box(*(lo + 1e-9).T, *(hi - 1e-9).T)))
    is_free = np.isin(np.arange(30), found.cell[found.triangle < 0])
    assert not is_free[reach > 1e-6].any()
    clear = shapely.distance(walls, shapely.box(*lo.T, *hi.T)) > 1e-9
    count = np.diff(found.first_piece)
    assert (count[clear] <= 1).all() and (count[is_free] == 1).all()
    area = np.bincount(found.cell, areas(found.pieces), 30)
    exact = shapely.area(shapely.intersection(workspace.free_space, shapely.box(*lo.T, *hi.T)))
    np.testing.assert_allclose(area, exact, atol=1e-9)
    cell, listed, by_all = corners_of_cells(found)
    for k in np.flatnonzero(by_all)[:20]:
        inside = points_of(rng, found.pieces[:, found.cell == cell[k]], 5).reshape(-1, 2)
        assert workspace.is_visible(inside, visibility.corners.points[np.full(len(inside), listed[k])]).all()
    # Each cell lists all corners that some point of it sees along a line with both walls of the corner on one side.
    x = (lo[:, None] + rng.random((30, 8, 2)) * (hi - lo)[:, None]).reshape(-1, 2)
    corners, contacts = visibility.corners.points, workspace.boundary.vertices[workspace.boundary.contacts]
    seen = workspace.is_visible(np.repeat(x, len(corners), axis=0), np.tile(corners, (len(x), 1))).reshape(len(x), -1)
    seen &= visibility.corners.is_tangent_to(np.arange(len(corners)), x[:, None])
    seen &= (workspace.clearance(x) > 1e-6)[:, None] & ~(corners[:, None] == contacts).all(axis=2).any(axis=1)
    point, corner = np.nonzero(seen)
    assert len(corner) and set(zip(point // 8, corner, strict=True)) <= set(zip(cell, listed, strict=True))


def test_wall_along_the_side_of_a_box_is_outside():
    workspace = Workspace(TEN, [box(4, 4, 6, 6)])
    boxes = [((2, 4), (4, 6)), ((6, 6), (7, 7)), ((3, 3), (5, 5)), ((4.5, 4.5), (5, 5)), ((0, 0), (10, 10))]
    oracle = VisibilityGraph(workspace, (1, 1))
    is_free = [(oracle.cell_sources(Box(*each)).triangle < 0).any() for each in boxes]
    assert is_free == [True, True, False, False, False]


def test_paths_bend_only_around_corners_that_hide_the_goal():
    """From behind a wall paths to (1, 5) turn at its upper corners, from in front of it at none."""
    oracle = VisibilityGraph(Workspace(TEN, [box(4, 2, 6, 8)]), (1, 5))
    sight, named = oracle.sight, {tuple(point): i for i, point in enumerate(oracle.sources.points.tolist())}
    assert sight.turn[0] == -1 and (sight.turn[1:] >= 0).all()
    in_front_and_behind = as_pieces([box(2, 4, 3, 5), box(8, 6, 9, 7)])
    for source, bends in {(1, 5): [True, True], (4, 8): [False, False], (6, 8): [False, True]}.items():
        found = sight.may_bend(in_front_and_behind, np.full(2, named[source]))
        np.testing.assert_array_equal(found, bends)
