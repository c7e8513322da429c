"""Helpers for tests of pairs: workspaces, exact distances, and properties of the pairs of any workspace."""

import numpy as np
import shapely
from piece_helpers import box
from scipy.sparse import csr_array
from shapely import affinity

from plr_jax import Box, VisibilityGraph, Workspace, scenes
from plr_jax.pairs.stored import Outline, PairsFileData
from plr_jax.plr.tree import Cells, tree_of

MAZE = scenes.maze().workspace


def two_batches(workspace, n, seed=0):
    """Return two batches of free points."""
    return workspace.sample_free(2 * n, seed).reshape(2, n, 2)


def exact(workspace, x, y):
    return VisibilityGraph(workspace, x[0]).between(x, y)


def joined(rooms, n=40, squeeze=False):
    """Return 10 x 10 rooms as one workspace, so that queries are compiled once, and pairs of points per room."""
    side = int(np.ceil(len(rooms) ** 0.5))
    shifts, size = 11 * np.stack(np.divmod(np.arange(len(rooms)), side), axis=1), 11 * side - 1
    obstacles = [wall for k in range(11, 11 * side, 11) for wall in (box(k - 1, 0, k, size), box(0, k - 1, size, k))]
    for room, shift in zip(rooms, shifts, strict=True):
        inside = shapely.intersection(room.obstacles, shapely.box(0, 0, 10, 10))
        obstacles += [affinity.translate(part, *shift) for part in shapely.get_parts(inside) if part.area > 0]
    x, y = np.concatenate([two_batches(room, n) + shift for room, shift in zip(rooms, shifts, strict=True)], axis=1)
    return Workspace(((0, 0), (size, size)), obstacles, squeeze=squeeze), x, y


def stored_ring(points, domain, joined=(), cells=None, lists=None, rounding=0.0):
    """Return the file data of one ring of corners; without ``lists``, one leaf lists all corners."""
    corner = np.arange(len(points))
    first, is_thin = np.array([0, len(points)]), np.zeros(len(points), bool)
    outline = Outline(np.zeros(2), 1.0, np.asarray(points), first, False, is_thin)
    tree = tree_of(Cells.root(2) if cells is None else cells)
    lists = csr_array(np.ones((1, len(points)), bool) if lists is None else lists)
    joined = np.array(joined, int).reshape(-1, 2)
    return PairsFileData(Box((0, 0), domain), outline, corner, joined, tree, lists, rounding)


def serpentine(corners, joined=()):
    """Return a corridor of few bytes per corner, whose tables may take a gigabyte; see :func:`stored_ring`."""
    k = np.arange(corners // 2)
    points = np.concatenate([np.stack([2 * k, 3 * (k % 2)], 1), np.stack([2 * k, 10 + 3 * (k % 2)], 1)[::-1]])
    return stored_ring(points, (2 * len(k), 14), joined, rounding=2.0**-10)
