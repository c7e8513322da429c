import numpy as np
import pytest
import shapely
from hypothesis import example, given, settings
from hypothesis import strategies as st
from piece_helpers import TEN, WORKSPACES, as_pieces, box, points_of, polygons

from plr_jax.geometry.convex_pieces import areas, clip_to_box, convex_pieces
from plr_jax.geometry.corners import corner_visibility
from plr_jax.geometry.shadows import shadows_of
from plr_jax.geometry.visibility import Viewpoints, joined_tables, visibility_of
from plr_jax.geometry.workspace import Workspace

NONE = np.empty(0, int)


def shadows_around(workspace, *open_points):
    """Those of points in the open, followed by those of all corners."""
    views = Viewpoints(np.array(open_points, float).reshape(-1, 2), NONE, NONE)
    table, _ = visibility_of(workspace.triangulation, views)
    return shadows_of(joined_tables([table, corner_visibility(workspace).table]))


def free_pieces(workspace, rng, n):
    """What random boxes, a few aligned with a lattice, leave of the triangles of free space."""
    triangles, parts = convex_pieces(workspace.free_space), []
    for _ in range(n):
        lo, hi = np.sort(rng.uniform(0, 10, (2, 2)), axis=0)
        if rng.random() < 0.3:
            lo, hi = np.floor(lo), np.ceil(hi)
        parts.append(clip_to_box(triangles, lo, hi)[0])
    pieces = np.concatenate(parts, axis=1)
    return pieces[:, rng.permutation(pieces.shape[1])[:n]]


def one_sided(workspace, shadows):
    """Viewpoints but for contacts of obstacles: these look into one side of them, where Shapely knows of none."""
    contacts = workspace.boundary.vertices[workspace.boundary.contacts]
    return np.flatnonzero(~(shadows.table.points[:, None] == contacts).all(axis=2).any(axis=1))


def shade(workspace, view):
    """The twin: what the edges of free space hide from a viewpoint, each the strip behind it."""
    ends = workspace.boundary.segments
    away = ends - view
    with np.errstate(invalid="ignore"):  # at an end of an edge, which hides nothing from there
        u, v = np.moveaxis(away / np.linalg.norm(away, axis=2, keepdims=True), 1, 0)
    hides = np.abs(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0]) > 1e-9
    middle = (u + v) / np.linalg.norm(u + v, axis=1, keepdims=True)
    far = view + 100 * np.stack([v, middle, u], axis=1)
    return shapely.union_all(shapely.polygons(np.concatenate([ends, far], axis=1)[hides]))


@pytest.mark.parametrize("kind", WORKSPACES)
@example(902, False)  # a sight 8e-9 from a corner
@given(st.integers(0, 100_000), st.booleans())
@settings(max_examples=12)
def test_pieces_are_seen_as_one_pair_of_points_at_a_time_is(kind, seed, squeeze):
    rng = np.random.default_rng(seed)
    workspace = kind(rng, squeeze)
    shadows = shadows_around(workspace, *workspace.sample_free(2, seed))
    pieces = free_pieces(workspace, rng, 25)
    view, piece = rng.choice(one_sided(workspace, shadows), 300), rng.integers(pieces.shape[1], size=300)
    center = pieces.mean(axis=2).T
    seen, alike = shadows.see(view, pieces[:, piece], center[piece])
    x = points_of(rng, pieces, 12)[piece]
    inside = np.einsum("pkc,dpc->pkd", rng.dirichlet(np.ones(pieces.shape[2]), (300, 12)), pieces[:, piece])
    x += 1e-3 * (inside - x)  # off walls and shadows, on which a hair decides
    pairs = np.repeat(shadows.table.points[view], 12, axis=0), x.reshape(-1, 2)
    differs = workspace.is_visible(*pairs).reshape(-1, 12) != seen[:, None]
    # Beside a point in which obstacles touch, segments pass within the tolerance.
    contacts = workspace.boundary.vertices[workspace.boundary.contacts]
    differs &= (np.linalg.norm(x[:, :, None] - contacts, axis=3) > 1e-3).all(axis=2)
    differs &= workspace.clearance(x.reshape(-1, 2)).reshape(-1, 12) > 10 * workspace.tolerance
    # A sight that passes a corner within the tolerance may be decided either way.
    corners, from_view = workspace.boundary.vertices, shadows.table.points[view]
    for row, at in np.argwhere(differs & alike[:, None]):
        passed = corners[np.linalg.norm(corners - from_view[row], axis=1) > workspace.tolerance]
        sight = shapely.LineString([from_view[row], x[row, at]])
        assert shapely.distance(shapely.points(passed), sight).min() <= workspace.tolerance
    assert alike.mean() > 0.5


@pytest.mark.parametrize("kind", WORKSPACES)
@given(st.integers(0, 100_000))
@settings(max_examples=8)
def test_pieces_are_parted_exactly_if_shapely_parts_them(kind, seed):
    rng = np.random.default_rng(seed)
    workspace = kind(rng)
    shadows = shadows_around(workspace, *workspace.sample_free(1, seed))
    pieces = free_pieces(workspace, rng, 30)
    shapes, area = np.array(polygons(pieces)), areas(pieces)
    each, alike_of_whole = np.arange(len(area)), []
    for view in one_sided(workspace, shadows)[[0, *rng.integers(len(one_sided(workspace, shadows)), size=4)]]:
        shadow = shade(workspace, shadows.table.points[view])
        hidden = shapely.area(shapely.intersection(shapes, shadow)) / area
        again = shapely.area(shapely.intersection(shadow, shapes)) / area
        seen, alike = shadows.see(np.full(len(area), view), pieces, pieces.mean(axis=2).T)
        clear = (area > 1e-6) & (np.abs(hidden - again) < 1e-9)  # Shapely errs where the order matters
        parted = (hidden > 1e-6) & (hidden < 1 - 1e-6) & clear
        whole = ((hidden < 1e-13) | (hidden > 1 - 1e-13)) & clear
        assert not alike[parted].any(), each[parted & alike]
        np.testing.assert_array_equal(seen[whole], hidden[whole] < 0.5)
        alike_of_whole.append(alike[whole])
    assert np.mean(np.concatenate(alike_of_whole)) > 0.9 if sum(map(len, alike_of_whole)) > 50 else True


def test_a_wall_and_the_pieces_beside_its_shadow():
    """From (2, 5) the wall hides what is between the lines to its near corners, (4, 4) and (4, 6), behind it."""
    workspace = Workspace(TEN, [box(4, 4, 5, 6)])
    shadows = shadows_around(workspace, (2, 5))
    pieces = as_pieces(
        [
            box(0, 0, 4, 4),  # in front
            box(6, 4.5, 7, 5.5),  # behind
            box(6, 6.5, 7, 7.5),  # across the upper line, which is at 7 above x = 6
            box(4, 6, 5, 7),  # above the wall: the line from (4, 6) to (5, 6.5) cuts it
            box(4, 7, 5, 8),  # farther above
            [(4, 6), (6, 7), (4, 7)],  # touches the line along a side, from above
            [(4, 6), (5, 6), (5, 6.5)],  # and from below
            box(0, 3, 3, 7),  # around the viewpoint
            box(2, 5, 3, 6),  # the viewpoint is a corner
        ]
    )
    seen, alike = shadows.see(np.zeros(9, int), pieces, pieces.mean(axis=2).T)
    np.testing.assert_array_equal(alike, [1, 1, 0, 0, 1, 1, 1, 1, 1])
    np.testing.assert_array_equal(seen[alike], [1, 0, 1, 1, 0, 1, 1])
