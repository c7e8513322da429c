"""Helpers for tests of convex pieces: random pieces, workspaces, and conversion to Shapely polygons."""

from fractions import Fraction

import numpy as np
import pytest
import shapely

from plr_jax.geometry.convex_pieces import ROOM
from plr_jax.geometry.workspace import Workspace

TEN = ((0, 0), (10, 10))


def box(x0, y0, x1, y1):
    """Return the corners of a box, counterclockwise."""
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], dtype=float)


def as_pieces(rings):
    """Return convex polygons, given by their corners in either direction, as pieces."""
    pieces = np.empty((2, len(rings), ROOM))
    for i, ring in enumerate(rings):
        ring = np.asarray(ring, float)
        edges = np.roll(ring, -1, axis=0) - ring
        following = np.roll(edges, -1, axis=0)
        ring = ring if (edges[:, 0] * following[:, 1] - edges[:, 1] * following[:, 0]).sum() >= 0 else ring[::-1]
        pieces[:, i] = ring[np.minimum(np.arange(ROOM), len(ring) - 1)].T
    return pieces


def polygons(pieces):
    return [shapely.Polygon(piece.T) for piece in pieces.transpose(1, 0, 2)]


def random_pieces(rng, n, size=3.0):
    """Return random triangles, some very thin, and their intersections with random boxes."""
    rings = []
    while len(rings) < n:
        triangle = rng.uniform(0, 10, 2) + rng.uniform(-size, size, (3, 2)) * 10.0 ** rng.uniform(-2, 0, 2)
        x0, y0, x1, y1 = shapely.Polygon(triangle).bounds
        sides = np.sort(rng.uniform([x0, y0], [x1, y1], (2, 2)), axis=0)
        cut = shapely.Polygon(triangle).intersection(shapely.box(*sides.ravel()))
        rings.append(triangle)
        if cut.geom_type == "Polygon" and cut.area > 1e-9:
            rings.append(shapely.get_coordinates(cut)[:-1])
    return as_pieces(rings[:n])


def points_of(rng, pieces, k):
    """Return ``k`` random points of each piece, a third of them near corners, ``(pieces, k, 2)``."""
    weight = rng.dirichlet(np.full(pieces.shape[2], 0.5), (pieces.shape[1], k))
    near = rng.integers(pieces.shape[2], size=(pieces.shape[1], k, 1))
    share = np.where(rng.random(near.shape) < 1 / 3, 1 - 10.0 ** rng.uniform(-7, -2, near.shape), 0.0)
    weight *= 1 - share
    np.put_along_axis(weight, near, share + np.take_along_axis(weight, near, 2), 2)
    return np.einsum("pkc,dpc->pkd", weight, pieces)


def general_workspace(rng, squeeze=False):
    """Return a workspace of boxes and triangles that overlap or leave the bounds, and a thin gap."""
    corners, size = rng.uniform(-0.5, 9, (4, 2)), rng.uniform(0.3, 3, (4, 2))
    boxes = [box(*c, *(c + s)) for c, s in zip(corners, size, strict=True)]
    triangles = [rng.uniform(0, 10, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(2)]
    start = rng.uniform(1, 8, 2)
    gap = 10.0 ** rng.uniform(-4, -1)
    sliver = [box(*start, start[0] + 1.3, start[1] + 0.8), box(start[0], start[1] + 0.8 + gap, *(start + 2))]
    return Workspace(TEN, boxes + triangles + sliver, squeeze=squeeze)


def lattice_workspace(rng, squeeze=False):
    """Return a lattice with cells blocked at random: it has collinear walls, point contacts and closed parts."""
    side = int(rng.integers(4, 9))
    step = 10 / side
    blocked = np.argwhere(rng.random((side, side)) < 0.3)
    return Workspace(TEN, [box(*(step * c), *(step * (c + 1))) for c in blocked], squeeze=squeeze)


def fan_workspace(rng, squeeze=False):
    """Return a workspace of triangles with sharp tips around a point, which some of them touch."""
    middle, triangles = rng.uniform(3, 7, 2), []
    for angle in np.sort(rng.uniform(0, 2 * np.pi, 6)):
        u = np.array([np.cos(angle), np.sin(angle)])
        v = np.array([-u[1], u[0]])
        tip = middle + u * (rng.random() < 0.6) * rng.uniform(0, 1)
        far = rng.uniform(1, 4)
        triangles.append([tip, tip + far * u - 0.2 * rng.random() * v, tip + far * u + 0.2 * rng.random() * v])
    return Workspace(TEN, triangles, squeeze=squeeze)


WORKSPACES = (general_workspace, lattice_workspace, fan_workspace)
SEEDS = [*range(6), *(pytest.param(seed, marks=pytest.mark.full) for seed in range(6, 48))]


def random_workspace(seed):
    """Return a workspace of one of three kinds; in every other triple of seeds, squeezing is allowed."""
    return WORKSPACES[seed % 3](np.random.default_rng(seed), squeeze=seed // 3 % 2 == 1)


def random_obstacle(rng, kind):
    """Return a polygon near [0, 8] x [0, 8] that may overlap or touch others, be a sliver, or leave the bounds."""
    corner, size = rng.uniform(-1, 8, 2), rng.uniform(0.05, 3, 2)
    if kind == "grid":
        corner, size = rng.integers(-1, 9, 2), rng.integers(1, 4, 2)
    if kind == "thin":
        size[rng.integers(2)] = 10.0 ** -rng.integers(1, 12)
    if kind == "polygon":
        turn = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
        return shapely.Polygon(corner + size * np.stack([np.cos(turn), np.sin(turn)], axis=1))
    return shapely.box(*corner, *(corner + size))


def hard_points(workspace, seed):
    """Return points on vertices and edges of the triangulation, beside them by about the tolerance, and anywhere."""
    rng, triangles = np.random.default_rng(seed), workspace.triangulation.triangles
    on_edges = ((triangles + np.roll(triangles, 1, axis=1)) / 2).reshape(-1, 2)
    beside = workspace.tolerance * rng.choice([0.01, 1, 10, 100], (len(on_edges), 1))
    x = [on_edges, on_edges + beside * rng.normal(size=on_edges.shape), workspace.boundary.vertices]
    x = np.concatenate([*x, workspace.boundary.vertices + beside[0] * rng.normal(size=2)])
    x = np.concatenate([rng.permutation(x)[:150], workspace.sample_free(50, seed)])
    return x[workspace.is_free(x)]


def exact_turns(point, corners):
    """Return in exact arithmetic how far left of each side of a polygon a point is, as cross products."""
    px, py = map(Fraction, point)
    exact = [tuple(map(Fraction, corner)) for corner in corners]
    sides = zip(exact, exact[1:] + exact[:1], strict=True)
    return [(bx - ax) * (py - ay) - (by - ay) * (px - ax) for (ax, ay), (bx, by) in sides]
