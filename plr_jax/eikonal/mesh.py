"""The mesh of a configuration space: dyadic cells that are proven free, proven blocked, or mixed (unproven)."""

import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Int8, Num
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from plr_jax.geometry.box import Box
from plr_jax.geometry.voxels import spread
from plr_jax.plr.leaf_faces import SharedFaces, shared_faces, touching_leaves
from plr_jax.plr.tree import Cells, Tree, corner_bits, tree_of
from plr_jax.spaces import CellState, ConfigurationSpace, as_states

_MOST_SLENDER = 2e5  # largest ratio of a cell's widths: beyond it, the equations lose all digits along the long axis
_NO_BIT = 62  # a bit that is 0 in every slot: descents stop at leaves
_LONG = 0.7  # a cell is halved along axes in which it is wider than this share of its largest width
_LEAST_PERIODIC = 2  # least number of halvings of a periodic axis: no two cells may touch on both sides
CellIndex: TypeAlias = Int[np.ndarray, " n"]
Fractions: TypeAlias = Float[np.ndarray, "n dim"]
Corners: TypeAlias = tuple[Float[np.ndarray, "cells dim"], Float[np.ndarray, "cells dim"]]
States: TypeAlias = Int8[np.ndarray, " cells"]
Mask: TypeAlias = Bool[np.ndarray, " cells"]


@dataclass(eq=False)
class Mesh:
    """Cells of a domain, made by repeated halving: each proven free, proven blocked, or mixed (unproven).

    Points are *fractions* of the domain, or *local* coordinates of a cell, both from 0 to 1 along each axis. A
    blocked cell is *flush* if it borders on space that is not blocked. Rounding may place free points in a flush
    cell: for such points, bounds of the open (not blocked) cells beside it count. Cells are numbered in the order in
    which ``tree`` is traversed.
    """

    domain: Box
    tree: Tree
    state: States
    is_flush: Mask

    @property
    def dim(self) -> int:
        return self.domain.dim

    @cached_property
    def cells(self) -> Cells:
        return self.tree.leaves

    @cached_property
    def all_faces(self) -> SharedFaces:
        return shared_faces(self.tree, self.domain.periodic)

    @cached_property
    def boxes(self) -> Corners:
        return self.cells.boxes(self.domain)

    @cached_property
    def grown_boxes(self) -> Corners:
        # Boxes around all points that rounding may place in the cells.
        return _grown_boxes(self.cells, self.domain)

    @cached_property
    def widths(self) -> Float[np.ndarray, "cells dim"]:
        return np.ldexp(self.domain.width, -self.cells.depth)

    @cached_property
    def _finest(self) -> Int[np.ndarray, "dim"]:
        return self.cells.depth.max(axis=0)

    @cached_property
    def _corners(self) -> tuple[Float[np.ndarray, "nodes dim"], Int[np.ndarray, "cells corners"]]:
        """Nodes, as fractions of the domain, and for each cell the indices of its corners among them."""
        slots = 1 << self._finest
        size = (self._finest - self.cells.depth)[:, None]
        place = (self.cells.position[:, None] + corner_bits(self.dim)) << size
        place = np.where(self.domain.periodic, place % slots, place)
        keys = np.ravel_multi_index(tuple(place.reshape(-1, self.dim).T), tuple(slots + 1))
        keys, node = np.unique(keys, return_inverse=True)
        points = np.stack(np.unravel_index(keys, tuple(slots + 1)), axis=1) / slots
        return points, node.reshape(len(self.cells), -1)

    @cached_property
    def _descent(self) -> Int[np.ndarray, "2 nodes"]:
        # For each tree node, its lower child (a leaf's own index), and the coordinate bit that chooses the child.
        tree, node = self.tree, np.arange(len(self.tree.child))
        bit = self._finest[tree.axis] - tree.cells.depth[node, tree.axis] - 1
        return np.where(tree.child < 0, [node, np.full_like(node, _NO_BIT)], [tree.child, bit])

    @property
    def nodes(self) -> Float[np.ndarray, "nodes dim"]:
        """The distinct corners of all cells, as fractions of the domain; below 1 along periodic axes."""
        return self._corners[0]

    @property
    def corners(self) -> Int[np.ndarray, "cells corners"]:
        return self._corners[1]

    @property
    def volumes(self) -> Float[np.ndarray, "cells"]:
        return self.widths.prod(axis=1)

    def fractions(self, cell: Int[np.ndarray, "*#n"], t: Num[np.ndarray, "*#n dim"]) -> Float[np.ndarray, "*_ dim"]:
        return np.ldexp(self.cells.position[cell] + t, -self.cells.depth[cell])

    def local(self, cell: Int[np.ndarray, "*#n"], x: Float[np.ndarray, "*#n dim"]) -> Float[np.ndarray, "*_ dim"]:
        return np.ldexp(x, self.cells.depth[cell]) - self.cells.position[cell]

    def within(self, cell: CellIndex, x: Fractions) -> Fractions:
        """Convert fractions of the domain to local coordinates; along periodic axes, of the nearest image."""
        t, turn = self.local(cell, x), np.ldexp(1.0, self.cells.depth[cell])
        return np.where(self.domain.periodic, t - turn * np.rint((t - 0.5) / turn), t)

    def locate(self, x: Fractions) -> CellIndex:
        """Return the index of each point's cell: on a face the upper cell, outside the domain the nearest cell."""
        most = (1 << self._finest) - 1
        slot = np.clip((x * (most + 1.0)).astype(np.int64), 0, most).ravel()
        first, node, (child, bit) = self.dim * np.arange(len(x)), np.zeros(len(x), np.int64), self._descent
        for _ in self.tree.splits:
            node = child[node] + (slot[first + self.tree.axis[node]] >> bit[node] & 1)
        return self.tree.leaf_of_node[node]

    @property
    def open_cells(self) -> Int[np.ndarray, "open"]:
        return np.flatnonzero(self.state != CellState.BLOCKED)

    @property
    def is_open_face(self) -> Bool[np.ndarray, " faces"]:
        is_open = self.state != CellState.BLOCKED
        return is_open[self.all_faces.lower] & is_open[self.all_faces.upper]

    @property
    def open_faces(self) -> SharedFaces:
        return self.all_faces[self.is_open_face]

    @property
    def flush_pairs(self) -> Int[np.ndarray, "2 pairs"]:
        # Row 0: a flush blocked cell; row 1: a cell that is not blocked and touches it.
        flush = np.flatnonzero(self.is_flush & (self.state == CellState.BLOCKED))
        return touching_leaves(self.tree, flush, self.open_cells, self.domain.periodic)

    def shared_boxes(self, cell: CellIndex, other: CellIndex) -> tuple[Fractions, Fractions, Fractions]:
        # Lower and upper corners, in fractions of the domain, and the box's shift, in periods, into `other`.
        (lo, hi), (low, high) = (
            [self.fractions(c, np.full(self.dim, end)) for end in (0.0, 1.0)] for c in (cell, other)
        )
        turn = np.where(low > hi, 1.0, 0.0) - np.where(high < lo, 1.0, 0.0)
        return np.maximum(lo, low - turn), np.minimum(hi, high - turn), turn

    def connected_to(self, cells: CellIndex | int) -> Mask:
        num, faces = len(self.state), self.open_faces
        graph = coo_array((np.ones(len(faces), bool), (faces.lower, faces.upper)), (num, num))
        part = connected_components(graph, directed=False)[1]
        return np.isin(part, part[cells])

    def with_state(self, state: States) -> "Mesh":
        mesh = copy.copy(self)  # shares the cached properties of the cells
        mesh.state = state
        return mesh

    def refined(self, chosen: Int[np.ndarray, " some"], space: ConfigurationSpace, room: int = 1 << 60) -> "Mesh":
        """Return the mesh with the ``chosen`` cells halved, in this order, while at most ``room`` cells are added."""
        parts, states, num, most = [], [], 0, 2**self.dim - 1  # most cells that refining a cell adds
        while num < len(chosen) and room >= most:
            batch = chosen[num : num + room // most]
            children, *of_children = self._parts(batch, space)
            parts.append(children)
            states.append(of_children)
            num += len(batch)
            room -= len(children) - len(batch)
        is_kept = np.ones(len(self.state), bool)
        is_kept[chosen[:num]] = False
        states.insert(0, (self.state[is_kept], self.is_flush[is_kept]))
        state, is_flush = (np.concatenate(column) for column in zip(*states, strict=True))
        return _mesh(self.domain, self.cells[is_kept].append(*parts), state, is_flush)

    def _parts(self, chosen: Int[np.ndarray, " some"], space: ConfigurationSpace) -> tuple[Cells, States, Mask]:
        """Halve cells, and return their parts, the states of the parts, and whether they are flush."""
        cells, bits, mixed = self.cells[chosen], corner_bits(self.dim), self.state[chosen] != CellState.FREE
        # 1. Classify the parts of cells that are not free, halved along all axes.
        state = np.repeat(self.state[chosen, None], len(bits), axis=1)
        is_flush = np.zeros(state.shape, bool)
        halved = cells[mixed]
        for axis in range(self.dim):
            halved = halved.split(np.full(len(halved), axis))
        for table, of_parts in zip((state, is_flush), _classify(halved, self.domain, space), strict=True):
            table[mixed] = of_parts.reshape(-1, len(bits))
        # 2. Choose one axis that gives a proven half, so that walls along halves take few cells, else all long axes.
        width = self.widths[chosen] * space.motion_cost.scale
        width = width / width.max(axis=1, keepdims=True)
        halves = np.stack([state[:, bits[:, axis] == end] for axis in range(self.dim) for end in (0, 1)], axis=1)
        is_proven = (halves == halves[:, :, :1]).all(axis=2) & (halves[:, :, 0] != CellState.MIXED)
        proven = is_proven.reshape(len(chosen), self.dim, 2).sum(axis=2)
        best = np.argmax(proven + width / 2, axis=1)
        alone = mixed & proven.any(axis=1)
        is_halved = np.where(alone[:, None], np.arange(self.dim) == best[:, None], width > _LONG)
        # 3. Join parts along the other axes.
        code = np.arange(len(bits)) & (is_halved @ (1 << np.arange(self.dim)[::-1]))[:, None]
        key, of_part = np.unique(np.arange(len(chosen))[:, None] * len(bits) + code, return_inverse=True)
        least, most = np.full(len(key), max(CellState), np.int8), np.full(len(key), min(CellState), np.int8)
        np.minimum.at(least, of_part.ravel(), state.ravel())
        np.maximum.at(most, of_part.ravel(), state.ravel())
        cell, part = np.divmod(key, len(bits))
        parts = Cells(cells.depth[cell] + is_halved[cell], (cells.position[cell] << is_halved[cell]) + bits[part])
        state = np.where(least == most, least, np.int8(CellState.MIXED))
        return parts, state, np.bincount(of_part.ravel(), is_flush.ravel()) * (state == CellState.BLOCKED) > 0


def coarse_mesh(space: ConfigurationSpace, num_cells: int, max_cells: int) -> Mesh:
    """Return a mesh of at most ``max_cells`` equal, nearly cubic cells, and of at least ``num_cells`` if possible."""
    domain, scale = space.domain, space.motion_cost.scale
    width = domain.width * scale
    least = np.where(domain.periodic, _LEAST_PERIODIC, 0)
    if 2.0 ** least.sum() > max_cells:
        raise ValueError(
            f"max_leaves must be at least {2 ** least.sum()} in a domain with {sum(domain.periodic)} periodic axes, "
            f"got {max_cells}."
        )
    depth = np.maximum(least, np.rint(np.log2(width / width.min())).astype(np.int64))
    while 2.0 ** depth.sum() > max_cells:
        depth[np.argmax(np.where(depth > least, depth, -1))] -= 1
    while 2.0 ** depth.sum() < num_cells and 2.0 ** (depth.sum() + domain.dim) <= max_cells:
        depth += 1
    width = np.ldexp(width, -depth)
    if width.max() > _MOST_SLENDER * width.min():
        raise ValueError(
            f"max_leaves must be so many that no cell is more than {_MOST_SLENDER:,.0f} times as long as wide, but "
            f"{max_cells} in {domain} are {width.max() / width.min():,.0f} times: allow more, or leave out "
            f"axis {np.argmin(width)}, along which the cost-to-go changes by nothing beside the others."
        )
    position = np.indices((1 << depth).tolist()).reshape(domain.dim, -1).T
    cells = Cells(np.tile(depth, (len(position), 1)), position)
    return _mesh(domain, cells, *_classify(cells, domain, space))


def _mesh(domain: Box, cells: Cells, state: States, is_flush: Mask) -> Mesh:
    tree = tree_of(cells)
    return Mesh(domain, tree, state[tree.order], is_flush[tree.order])


def _classify(cells: Cells, domain: Box, space: ConfigurationSpace) -> tuple[States, Mask]:
    state = as_states(space.classify(*cells.boxes(domain)), len(cells))
    is_flush, blocked = np.zeros(len(cells), bool), np.flatnonzero(state == CellState.BLOCKED)
    is_flush[blocked] = space.classify(*_grown_boxes(cells[blocked], domain)) != CellState.BLOCKED
    return state, is_flush


def _grown_boxes(cells: Cells, domain: Box) -> Corners:
    lo, hi = (np.where(domain.periodic, q, np.clip(q, domain.lo, domain.hi)) for q in cells.grown_boxes(domain))
    return lo, hi


def with_open_contacts(mesh: Mesh, space: ConfigurationSpace) -> Mesh:
    """Return a mesh in which blocked cells count as mixed if open cells beside them touch only in an edge or corner.

    Open cells are cells that are not blocked. A path that begins on such an edge or corner may go into any of the
    open cells around it, and a path may pass through it if the space lets robots squeeze between obstacles.
    """
    dim, periodic = mesh.dim, mesh.domain.periodic
    signs, grid = (np.array(list(product(ends, repeat=dim))) for ends in ((-1, 1), (0.0, 0.5, 1.0)))
    inset = np.ldexp(0.25, -mesh.cells.depth.max(axis=0))  # a quarter of the smallest cell's width along each axis
    while dim > 1:
        # 1. Find edges and corners that flush and open cells share, as middles and half widths in fractions.
        flush, beside = mesh.flush_pairs
        lo, hi = (mesh.fractions(flush, np.full(dim, end)) for end in (0.0, 1.0))
        low, high, _ = mesh.shared_boxes(flush, beside)
        x = low[:, None] + (high - low)[:, None] * grid
        half = np.where(grid == 0.5, (high - low)[:, None] / 2, 0.0)
        is_edge = ((x == lo[:, None]) | (x == hi[:, None])).sum(axis=2) > 1
        edges = np.unique(np.append(np.where(periodic, x % 1.0, x), half, axis=2)[is_edge], axis=0)
        middle, half = edges[:, :dim], edges[:, dim:]
        # 2. Find which cells around each are open.
        x = middle[:, None] + signs * inset
        around = mesh.locate(np.where(periodic, x % 1.0, x).reshape(-1, dim)).reshape(x.shape[:2])
        is_open = (mesh.state[around] != CellState.BLOCKED) & (((x > 0) & (x < 1)) | periodic).all(axis=2)
        # 3. Beside the edge, an open cell may be blocked.
        edge, side = np.nonzero(is_open & _are_parted(is_open)[:, None])
        beside = middle[edge] + np.where(half[edge] > 0, 0.0, signs[side] * inset)
        lo, hi = np.minimum(middle[edge], beside) - half[edge], np.maximum(middle[edge], beside) + half[edge]
        is_open[edge, side] = space.classify(mesh.domain.at(lo), mesh.domain.at(hi)) != CellState.BLOCKED
        touches = np.zeros(len(mesh.state), bool)
        touches[around[_are_parted(is_open)]] = True
        touches &= mesh.is_flush & (mesh.state == CellState.BLOCKED)
        if not touches.any():
            break
        mesh = mesh.with_state(np.where(touches, np.int8(CellState.MIXED), mesh.state))
    return mesh


def _are_parted(is_open: Bool[np.ndarray, "edges sides"]) -> Bool[np.ndarray, " edges"]:
    # Whether the open ones among the places around an edge or corner are not all connected through faces.
    is_first = is_open & (np.cumsum(is_open, axis=1) == 1)
    return np.asarray((is_open & ~spread(is_first, is_open)).any(axis=1))
