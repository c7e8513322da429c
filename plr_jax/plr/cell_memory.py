"""Compute and cache the sources of cells: the points to which shortest paths from a cell may go first."""

from collections.abc import Iterator
from typing import TypeAlias

import numpy as np
from jaxtyping import Float, Int

from plr_jax._arrays import parts, take_ragged
from plr_jax._types import CellSources, CellwiseFn
from plr_jax.geometry.box import Box
from plr_jax.plr.tree import Cells, Tree, grown_domain

_Key: TypeAlias = tuple[int, ...]
_POINTS_AT_ONCE = 1 << 16  # pairs of a convex piece of free space and a point that are tested at once
_PAIRS_AT_ONCE = 1 << 19  # pairs of a point and a source


class CellMemory:
    """A cache of the sources (the goal, or corners where paths may turn) of a growing partition's cells."""

    def __init__(self, oracle: CellwiseFn, domain: Box) -> None:
        self._domain = domain
        self._parts = [oracle.cell_sources(grown_domain(domain))]
        self._place: dict[_Key, tuple[int, int]] = {_keys(Cells.root(2))[0]: (0, 0)}

    def sources(self, cells: Cells) -> CellSources:
        """Return the sources of cells, each of which is known already or is a half of a known cell."""
        keys = _keys(cells)
        new = [i for i, key in enumerate(keys) if key not in self._place]
        if new:
            self._remember(cells[np.array(new)], [keys[i] for i in new])
        return self._recall(keys)

    def distances(self, cells: Cells, x: Float[np.ndarray, "cells k 2"]) -> Float[np.ndarray, "cells k"]:
        return distances_in_cells(self.sources(cells), x)

    def _remember(self, cells: Cells, keys: list[_Key]) -> None:
        parents, axis = np.empty(len(cells), object), np.zeros(len(cells), np.int64)
        for i, (d0, d1, p0, p1) in enumerate(keys):
            parents[i] = (d0 - 1, d1, p0 >> 1, p1)
            if d0 == 0 or parents[i] not in self._place:
                parents[i], axis[i] = (d0, d1 - 1, p0, p1 >> 1), 1
        is_upper = cells.position[np.arange(len(cells)), axis] % 2 == 1
        distinct = sorted(set(parents), key=self._place.__getitem__)
        number = {key: i for i, key in enumerate(distinct)}
        parent = np.array([number[key] for key in parents])
        order = np.argsort(parent, kind="stable")
        lo, hi = cells[order].grown_boxes(self._domain)
        part = self._recall(distinct).parts(parent[order], axis[order], is_upper[order], lo, hi)
        for place, i in enumerate(order.tolist()):
            self._place[keys[i]] = len(self._parts), place
        self._parts.append(part)

    def _recall(self, keys: list[_Key]) -> CellSources:
        part, place = np.array([self._place[key] for key in keys]).T
        order = np.argsort(part, kind="stable")
        runs = np.split(order, np.flatnonzero(np.diff(part[order])) + 1)
        parts = [self._parts[part[run[0]]].of_cells(place[run]) for run in runs]
        return parts[0].append(*parts[1:]).of_cells(np.argsort(order))


def sources_by_level(
    tree: Tree, root: CellSources, domain: Box
) -> Iterator[tuple[Int[np.ndarray, "nodes"], CellSources]]:
    """Yield the nodes of each level of a tree, and the sources of their cells, from the root's sources (``root``)."""
    nodes, visible = np.zeros(1, np.int64), root
    while len(nodes):
        yield nodes, visible
        inner = np.flatnonzero(tree.child[nodes] >= 0)
        parent, axis = np.repeat(inner, 2), np.repeat(tree.axis[nodes[inner]], 2)
        nodes = tree.halves(nodes[inner])
        lo, hi = tree.cells[nodes].grown_boxes(domain)
        visible = visible.parts(parent, axis, np.arange(len(nodes)) % 2 == 1, lo, hi)


def distances_in_cells(visible: CellSources, x: Float[np.ndarray, "cells k 2"]) -> Float[np.ndarray, "cells k"]:
    """Return exact distances at points of cells; ``inf`` if a point is not free or cannot reach the goal."""
    found = np.full(x.shape[:2], np.inf)
    at_once = max(1, _POINTS_AT_ONCE // x.shape[1])
    held = [np.zeros((2, 0), int)]
    for begin in range(0, len(visible.cell), at_once):
        piece = np.arange(begin, min(begin + at_once, len(visible.cell)))
        row, column = np.nonzero(visible.hold(piece, x[visible.cell[piece]]))
        held.append(np.stack([piece[row], column]))
    piece, column = np.concatenate(held, axis=1)
    # For each piece that contains a point: the shortest path by way of a source that the point sees.
    for some in parts(np.diff(visible.first_pair)[piece], _PAIRS_AT_ONCE):
        pair, row = take_ragged(visible.first_pair, piece[some])
        source, sources = visible.source[pair], visible.sources
        place = visible.cell[piece[some][row]], column[some][row]
        dx, dy = (x[place] - sources.points[source]).T
        length = sources.distances[source] + np.sqrt(dx * dx + dy * dy)
        by_all = visible.by_all[pair]
        np.minimum.at(found, tuple(each[by_all] for each in place), length[by_all])
        unsure = np.flatnonzero(~by_all & (length < found[place]))
        seen = unsure[visible.see(source[unsure], x[place][unsure])]
        np.minimum.at(found, tuple(each[seen] for each in place), length[seen])
    return found


def _keys(cells: Cells) -> list[_Key]:
    return list(map(tuple, np.concatenate([cells.depth, cells.position], axis=1).tolist()))
