"""The mesh of a configuration space: dyadic cells that are proven free, proven blocked, or mixed (unproven)."""

import copy
from dataclasses import dataclass
from functools import cached_property
from itertools import product
from typing import TypeAlias

import numpy as np
from jaxtyping import Bool, Float, Int, Int8, Num

from plr_jax.geometry.box import Box
from plr_jax.geometry.graph import connected_groups
from plr_jax.geometry.voxels import are_parted
from plr_jax.plr.leaf_faces import SharedFaces, shared_faces, touching_leaves
from plr_jax.plr.tree import Cells, Tree, corner_bits, tree_of
from plr_jax.spaces._space import CellState, ConfigurationSpace, as_states

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
        """The nodes, as fractions of the domain, and the indices of the nodes at the corners of each cell.

        Nodes are the distinct corners of all cells.
        """
        # Each axis has as many slots as the finest cells fill. A cell is 2**size slots wide, so its corners lie at
        # whole places from 0 to `slots`, in units of a slot; the last place of a periodic axis is its first one. The
        # places of all axes, packed into one integer, are the key of a node.
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
        # For each tree node, its lower child, and the bit of a point's slot that chooses the child. A leaf is its own
        # child, chosen by a bit that is 0.
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
        """Convert local coordinates of cells, from 0 to 1 across each cell, to fractions of the domain."""
        return np.ldexp(self.cells.position[cell] + t, -self.cells.depth[cell])

    def local(self, cell: Int[np.ndarray, "*#n"], x: Float[np.ndarray, "*#n dim"]) -> Float[np.ndarray, "*_ dim"]:
        """Convert fractions of the domain to coordinates from 0 to 1 across each cell.

        Points outside a cell have coordinates below 0 or above 1. Periodic axes do not wrap around (see
        :meth:`within`).
        """
        return np.ldexp(x, self.cells.depth[cell]) - self.cells.position[cell]

    def within(self, cell: CellIndex, x: Fractions) -> Fractions:
        """Convert fractions of the domain to local coordinates of cells.

        Along periodic axes, a point is first moved by whole periods, to be nearest to the cell.
        """
        t, turn = self.local(cell, x), np.ldexp(1.0, self.cells.depth[cell])
        return np.where(self.domain.periodic, t - turn * np.rint((t - 0.5) / turn), t)

    def locate(self, x: Fractions) -> CellIndex:
        """Return the index of the cell that contains each point.

        A point on a face between two cells gets the upper cell, a point outside of the domain the nearest cell.
        """
        # Descend from the root, all points at once, one step for each level of the tree. Along the axis of a node,
        # one bit of the point's slot tells the half; the upper child follows the lower one.
        last = (1 << self._finest) - 1
        slot = np.clip((x * (last + 1.0)).astype(np.int64), 0, last).ravel()
        row = self.dim * np.arange(len(x))  # where the slots of each point begin
        node = np.zeros(len(x), np.int64)
        child, bit = self._descent
        for _ in self.tree.splits:
            node = child[node] + (slot[row + self.tree.axis[node]] >> bit[node] & 1)
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
        """Return the boxes (faces, edges or corners) that pairs of touching cells share.

        Returns:
            The lower and the upper corner of each box as a part of ``cell``, in fractions of the domain. Also the
            shift, in periods along each axis, that moves the box into ``other``. The shift is not 0 if the cells
            touch across the seam of a periodic axis:

                0                       1
                | other |  ...   | cell |         shift -1: the box at 1, in `cell`, is at 0 in `other`
        """
        (lo, hi), (other_lo, other_hi) = (self.cells[each].fractions for each in (cell, other))
        shift = np.where(other_lo > hi, 1.0, 0.0) - np.where(other_hi < lo, 1.0, 0.0)
        return np.maximum(lo, other_lo - shift), np.minimum(hi, other_hi - shift), shift

    def connected_to(self, cells: CellIndex | int) -> Mask:
        # Whether open faces join each cell to one of the given cells, or it is one of them.
        faces = self.open_faces
        part = connected_groups(len(self.state), np.stack([faces.lower, faces.upper]))
        return np.isin(part, part[cells])

    def with_state(self, state: States) -> "Mesh":
        mesh = copy.copy(self)  # shares the cached properties of the cells
        mesh.state = state
        return mesh

    def refined(self, chosen: Int[np.ndarray, " some"], space: ConfigurationSpace, room: int = 1 << 60) -> "Mesh":
        """Return a mesh in which the cells with the indices ``chosen`` are halved along one or more axes.

        Cells are halved in the given order, as long as this adds at most ``room`` cells in all.
        """
        # Batches are so small that they add at most `room` cells even if each cell is halved along all axes. Cells
        # that are halved along fewer axes leave room for another batch.
        children, columns, num = [], [], 0
        most_added = 2**self.dim - 1
        while num < len(chosen) and room >= most_added:
            batch = chosen[num : num + room // most_added]
            cells, *states = self._halved(batch, space)
            children.append(cells)
            columns.append(states)
            num += len(batch)
            room -= len(cells) - len(batch)
        is_kept = np.ones(len(self.state), bool)
        is_kept[chosen[:num]] = False
        columns.insert(0, (self.state[is_kept], self.is_flush[is_kept]))
        state, is_flush = (np.concatenate(column) for column in zip(*columns, strict=True))
        return _mesh(self.domain, self.cells[is_kept].append(*children), state, is_flush)

    def _halved(self, chosen: Int[np.ndarray, " some"], space: ConfigurationSpace) -> tuple[Cells, States, Mask]:
        """Halve the cells with the indices ``chosen`` along one or more axes.

        Return the new cells, their states, and whether they are flush (see the class).
        """
        #   +---+---+    The parts of a cell that is halved along all axes have the numbers of `corner_bits`: one bit
        #   | 1 | 3 |    for each axis, the highest for the first axis (here to the right). If only the first axis is
        #   +---+---+    halved, parts 0 and 1 join, and parts 2 and 3: their numbers are equal in the bits of halved
        #   | 0 | 2 |    axes.
        #   +---+---+
        cells, bits = self.cells[chosen], corner_bits(self.dim)
        # 1. Classify the parts of cells that are not free. Parts of free cells are free.
        state = np.repeat(self.state[chosen, None], len(bits), axis=1)
        is_flush = np.zeros(state.shape, bool)
        not_free = self.state[chosen] != CellState.FREE
        parts = cells[not_free]
        for axis in range(self.dim):
            parts = parts.split(np.full(len(parts), axis))
        for table, of_parts in zip((state, is_flush), _classify(parts, self.domain, space), strict=True):
            table[not_free] = of_parts.reshape(-1, len(bits))
        # 2. Choose the axes. If halving a cell along one axis gives a proven half, halve it along this axis only, so
        #    that walls along halves take few cells: along the axis with most proven halves, of equal ones the
        #    longest. Else halve all long axes.
        width = self.widths[chosen] * space.motion_cost.scale
        width = width / width.max(axis=1, keepdims=True)  # at most 1, so half of it counts less than a proven half
        halves = np.stack([state[:, bits[:, axis] == end] for axis in range(self.dim) for end in (0, 1)], axis=1)
        is_proven = (halves == halves[:, :, :1]).all(axis=2) & (halves[:, :, 0] != CellState.MIXED)
        num_proven = is_proven.reshape(len(chosen), self.dim, 2).sum(axis=2)
        best = np.argmax(num_proven + width / 2, axis=1)
        has_one_axis = not_free & num_proven.any(axis=1)
        is_halved = np.where(has_one_axis[:, None], np.arange(self.dim) == best[:, None], width > _LONG)
        # 3. Join the parts along the other axes. The key of a new cell is cell * 2**dim + number of its lowest part.
        #    A new cell is proven if its parts have one state, and flush if it is blocked and one of its parts is
        #    flush.
        bits_of_halved_axes = is_halved @ (1 << np.arange(self.dim)[::-1])
        number = np.arange(len(bits)) & bits_of_halved_axes[:, None]
        key, of_part = np.unique(np.arange(len(chosen))[:, None] * len(bits) + number, return_inverse=True)
        least, most = np.full(len(key), max(CellState), np.int8), np.full(len(key), min(CellState), np.int8)
        np.minimum.at(least, of_part.ravel(), state.ravel())
        np.maximum.at(most, of_part.ravel(), state.ravel())
        cell, part = np.divmod(key, len(bits))
        joined = Cells(cells.depth[cell] + is_halved[cell], (cells.position[cell] << is_halved[cell]) + bits[part])
        state = np.where(least == most, least, np.int8(CellState.MIXED))
        return joined, state, (np.bincount(of_part.ravel(), is_flush.ravel()) > 0) & (state == CellState.BLOCKED)


def coarse_mesh(space: ConfigurationSpace, num_cells: int, max_cells: int) -> Mesh:
    """Return a mesh of at most ``max_cells`` equal, nearly cubic cells, and of at least ``num_cells`` if possible."""
    # 1. Halve each axis until widths are about equal, in units of cost; but along periodic axes at least twice.
    domain = space.domain
    width = domain.width * space.motion_cost.scale
    least = np.where(domain.periodic, _LEAST_PERIODIC, 0)
    if 2.0 ** least.sum() > max_cells:
        expected = f"at least {2 ** least.sum()} in a domain with {sum(domain.periodic)} periodic axes"
        raise ValueError(f"max_leaves must be {expected}, got {max_cells}.")
    depth = np.maximum(least, np.rint(np.log2(width / width.min())).astype(np.int64))
    # 2. Fit the number of cells to the limits: join the most halved axes, or halve all axes.
    while 2.0 ** depth.sum() > max_cells:
        depth[np.argmax(np.where(depth > least, depth, -1))] -= 1
    while 2.0 ** depth.sum() < num_cells and 2.0 ** (depth.sum() + domain.dim) <= max_cells:
        depth += 1
    width = np.ldexp(width, -depth)
    if width.max() > _MOST_SLENDER * width.min():
        expected = f"so many that no cell is more than {_MOST_SLENDER:,.0f} times as long as wide"
        got = f"{max_cells} in {domain} are {width.max() / width.min():,.0f} times"
        axis = f"axis {np.argmin(width)}, along which the cost-to-go changes by nothing beside the others"
        raise ValueError(f"max_leaves must be {expected}, but {got}: allow more, or leave out {axis}.")
    # 3. All cells, and their states.
    position = np.indices((1 << depth).tolist()).reshape(domain.dim, -1).T
    cells = Cells(np.tile(depth, (len(position), 1)), position)
    return _mesh(domain, cells, *_classify(cells, domain, space))


def _mesh(domain: Box, cells: Cells, state: States, is_flush: Mask) -> Mesh:
    tree = tree_of(cells)
    return Mesh(domain, tree, state[tree.order], is_flush[tree.order])


def _classify(cells: Cells, domain: Box, space: ConfigurationSpace) -> tuple[States, Mask]:
    # The states of cells, and whether they are flush: blocked cells whose grown boxes are not blocked.
    state = as_states(space.classify(*cells.boxes(domain)), len(cells))
    is_flush, blocked = np.zeros(len(cells), bool), np.flatnonzero(state == CellState.BLOCKED)
    is_flush[blocked] = space.classify(*_grown_boxes(cells[blocked], domain)) != CellState.BLOCKED
    return state, is_flush


def _grown_boxes(cells: Cells, domain: Box) -> Corners:
    lo, hi = (np.where(domain.periodic, q, np.clip(q, domain.lo, domain.hi)) for q in cells.grown_boxes(domain))
    return lo, hi


def with_open_contacts(mesh: Mesh, space: ConfigurationSpace) -> Mesh:
    """Return a mesh in which blocked cells count as mixed (not proven blocked) if open cells touch beside them.

    Open cells are cells that are not blocked. If open cells touch only in an edge or a corner, a path that begins
    there may go into any of these cells. If the space lets robots squeeze between obstacles, a path may also pass
    through the edge or corner. But meshes join cells only through common faces. So the blocked flush cells around
    such an edge or corner count as mixed: common faces then join the open cells through them.
    """
    #   +---+---+    A blocked flush cell A, seen along an edge (*) that it shares with an open cell B. The four cells
    #   | A | B |    around the edge are found at a small distance from it, the `inset`. If A and C are blocked but B
    #   +---*---+    and D are open, no faces join B and D around the edge. Then A counts as mixed, and so does C if
    #   | D | C |    it is flush. In three dimensions, the same holds for the eight cells around a corner.
    #   +---+---+
    dim, periodic = mesh.dim, mesh.domain.periodic
    signs, grid = (np.array(list(product(ends, repeat=dim))) for ends in ((-1, 1), (0.0, 0.5, 1.0)))
    inset = np.ldexp(0.25, -mesh.cells.depth.max(axis=0))  # a quarter of the smallest cell's width along each axis
    while dim > 1:
        # 1. Find edges and corners that flush and open cells share, as middles and half widths in fractions. They are
        #    the parts of the shared box that lie on two or more sides of the flush cell.
        flush, open_cell = mesh.flush_pairs
        flush_lo, flush_hi = mesh.cells[flush].fractions
        lo, hi, _ = mesh.shared_boxes(flush, open_cell)
        x = lo[:, None] + (hi - lo)[:, None] * grid  # 1/2 in a row of `grid`: the edge extends along this axis
        half = np.where(grid == 0.5, (hi - lo)[:, None] / 2, 0.0)
        is_edge = ((x == flush_lo[:, None]) | (x == flush_hi[:, None])).sum(axis=2) > 1
        edges = np.unique(np.append(np.where(periodic, x % 1.0, x), half, axis=2)[is_edge], axis=0)
        middle, half = edges[:, :dim], edges[:, dim:]
        # 2. Find which cells around each are open.
        places = middle[:, None] + signs * inset
        around = mesh.locate(np.where(periodic, places % 1.0, places).reshape(-1, dim)).reshape(places.shape[:2])
        is_open = (((places > 0) & (places < 1)) | periodic).all(axis=2) & (mesh.state[around] != CellState.BLOCKED)
        # 3. Beside the edge, an open cell may be blocked: classify a small box between the edge and the place in it.
        edge, side = np.nonzero(is_open & are_parted(is_open)[:, None])
        beside = middle[edge] + np.where(half[edge] > 0, 0.0, signs[side] * inset)
        lo, hi = np.minimum(middle[edge], beside) - half[edge], np.maximum(middle[edge], beside) + half[edge]
        is_open[edge, side] = space.classify(mesh.domain.at(lo), mesh.domain.at(hi)) != CellState.BLOCKED
        # 4. Blocked flush cells around edges whose open cells are still parted count as mixed. Being open now, they
        #    may touch other cells in an edge: repeat.
        becomes_mixed = np.zeros(len(mesh.state), bool)
        becomes_mixed[around[are_parted(is_open)]] = True
        becomes_mixed &= mesh.is_flush & (mesh.state == CellState.BLOCKED)
        if not becomes_mixed.any():
            break
        mesh = mesh.with_state(np.where(becomes_mixed, np.int8(CellState.MIXED), mesh.state))
    return mesh
