"""Groups of voxels as nodes of a coarse grid that keeps narrow tunnels open and thin walls closed."""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
from jaxtyping import Bool, Float
from scipy import ndimage
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

from plr_jax.eikonal.goals import Goals
from plr_jax.eikonal.march import Costs, marched
from plr_jax.geometry.box import Box

# The share of full groups in a cube around a group says how wide the place is.
_WIDE = 5  # groups along each axis of this cube
_RANKS = 2  # shares are rounded to so many steps


@dataclass(frozen=True, eq=False)
class VoxelGroups:
    """Groups of voxels: cubes of ``size`` voxels along each axis, each of which is one node of a coarse grid.

    A node stands for one *part* of its group's free voxels: all voxels that are connected, through faces within the
    group, to the free voxel ``x`` nearest to the middle of the group::

        # # # | . . .      If no face joins the parts of two neighbor groups, one of their nodes is closed (paths may
        . x . | . x .      not pass it): the node in the more spacious region, so that tunnels stay open, or else the
        # # # | # # #      node of the smaller part. The node of a group with a goal stays open, and the group's ``x``
                           is then the goal's voxel.
    """

    box: Box  # of all groups; it may extend beyond the voxels
    size: int
    free: Bool[np.ndarray, "..."]  # whether each voxel of the groups is free
    part: Bool[np.ndarray, "..."]  # whether each voxel belongs to the part of its group
    has_part: Bool[np.ndarray, "*shape"]  # whether each group has a free voxel
    is_open: Bool[np.ndarray, "*shape"]
    middles: Float[np.ndarray, "*shape dim"]  # of the voxels ``x``, or of groups without a free voxel

    @classmethod
    def of(
        cls, free: Bool[np.ndarray, "..."], domain: Box, box: Box, shape: tuple[int, ...], goals: Goals
    ) -> "VoxelGroups":
        """Group the ``free`` and blocked voxels of a domain.

        ``shape`` is the number of groups along each axis, and ``box`` contains all groups. The node of a group that
        holds one of the ``goals`` stays open.
        """
        # 1. Pad the voxels so that groups fill the box. Find the groups in which all voxels are free, and the groups
        #    in which any voxel is free.
        dim, side = free.ndim, domain.width / free.shape
        size = round(float((box.width / side / shape)[0]))
        before = np.rint((domain.lo - box.lo) / side).astype(int)
        after = np.array(shape) * size - free.shape - before
        free = np.pad(free, list(zip(before, after, strict=True)))
        part = free.copy()
        free_blocks, part_blocks = _blocks(free, size), _blocks(part, size)  # views: to write a block writes voxels
        is_full, has_part = free, free
        for axis in range(dim):
            split = (*is_full.shape[:axis], shape[axis], size, *is_full.shape[axis + 1 :])
            is_full = np.logical_and.reduce(is_full.reshape(split), axis + 1)
            has_part = np.logical_or.reduce(has_part.reshape(split), axis + 1)
        # 2. The voxel `x` of each group, and the part of the group that is joined to it. In groups that are not full
        #    (`mixed`, one in each row), the first voxel by `order` is x: a goal's voxel has -1, free voxels have
        #    their squared distance from the middle, and blocked voxels a larger number.
        mixed = np.nonzero(has_part & ~is_full)
        offset = np.array(list(product(range(size), repeat=dim)))
        from_middle = np.sum((offset - size // 2) ** 2, axis=1)
        order = np.where(free_blocks[mixed].reshape(-1, size**dim), from_middle, size**2 * dim)
        voxel = np.floor((goals - box.lo) / side).astype(int).clip(0, np.array(free.shape) - 1)
        row = np.full(shape, -1)
        row[mixed] = np.arange(len(order))
        home = tuple((voxel // size).T)
        holds = np.flatnonzero((row[home] >= 0) & free[tuple(voxel.T)])
        order[row[home][holds], np.ravel_multi_index(tuple((voxel % size)[holds].T), (size,) * dim)] = -1
        nearest = order.argmin(axis=1)
        joined = np.zeros(order.shape, bool)
        joined[np.arange(len(order)), nearest] = True
        across_faces = ndimage.generate_binary_structure(dim, 1)[None]  # within a row, not from row to row
        joined = ndimage.binary_propagation(joined.reshape(-1, *(size,) * dim), across_faces, free_blocks[mixed])
        part_blocks[mixed] = joined
        middles = np.moveaxis(np.indices(shape), 0, -1) * size + size / 2
        middles[mixed] += offset[nearest] - size // 2
        # 3. Close one of each two neighbor nodes whose parts no face joins: the node of higher rank. The whole part
        #    of a rank is the width of the place, its fraction the share of voxels outside the part; goals stay open.
        rank = np.rint(_RANKS * ndimage.uniform_filter(is_full.astype(np.float32), _WIDE, mode="constant"))
        rank[mixed] += 1 - joined.mean(axis=tuple(range(1, dim + 1)))
        rank[home] = -1.0
        is_open = has_part.copy()
        for axis in range(dim):
            low, high = ((slice(None),) * axis + (end,) for end in (slice(-1), slice(1, None)))
            # The last layer of voxels in each group meets the first layer in the next group.
            last, first = (np.moveaxis(part_blocks, dim + axis, 0)[end] for end in (-1, 0))
            touch = last[low] & first[high]
            is_walled = is_open[low] & is_open[high] & ~touch.any(axis=tuple(range(dim, 2 * dim - 1)))
            is_wider = rank[low] > rank[high]
            is_open[low] &= ~(is_walled & is_wider)
            is_open[high] &= ~(is_walled & ~is_wider)
        return cls(box, size, free, part, has_part, is_open, box.lo + middles * side)

    def completed(self, cost: Costs, slowness: Costs) -> tuple[Costs, Costs]:
        """Complete the costs-to-go of a march over nodes by the costs-to-go of voxels that no node stands for.

        ``cost`` is the cost-to-go of each node, ``inf`` where the march did not arrive, and ``slowness`` the cost per
        unit of length. The *other* voxels are the free voxels that belong to no part with a finite cost.

        Return two arrays with one entry per group. The first is ``cost``, completed in place: some open nodes can be
        reached only through other voxels. So the march begins again in each region of such nodes, at the node nearest
        to the goal. The second is the least cost of the group's other voxels, ``inf`` if none can be reached.
        """
        of_parts, others = self._costs_across_faces(cost, slowness)
        labeled: Any = ndimage.label(self.is_open & np.isfinite(of_parts))  # finite: the march missed the node
        region, num = labeled
        if not num:
            return cost, others
        for index, box in enumerate(ndimage.find_objects(region), 1):
            is_inside = region[box] == index
            least = float(of_parts[box][is_inside].min())
            start = np.where(is_inside & (of_parts[box] == least), least, np.inf)
            costs = marched(is_inside, slowness[box], start, least, self.box.width / cost.shape, (False,) * cost.ndim)
            cost[box] = np.where(is_inside, np.minimum(costs, of_parts[box]), cost[box])
        return cost, self._costs_across_faces(cost, slowness)[1]

    def _costs_across_faces(self, cost: Costs, slowness: Costs) -> tuple[Costs, Costs]:
        """Return two costs-to-go for each group: the least cost of a voxel in its part, and of any of its voxels.

        Only voxels of unknown cost count; if there are none with a path, the cost is ``inf``. A voxel's cost is known
        if the voxel belongs to a group's *part* (the voxels for which the group's node stands) and the node has a
        finite ``cost``. Paths lead from voxels of known cost across faces through free voxels of unknown cost.
        """
        # 1. The voxels of unknown cost.
        dim, size, shape = self.free.ndim, self.size, np.array(self.free.shape)
        is_known = self.part.copy()
        _blocks(is_known, size)[...] &= np.isfinite(cost)[(..., *(None,) * dim)]
        voxel = np.argwhere(self.free & ~is_known)
        flat = np.asarray(np.ravel_multi_index(tuple(voxel.T), self.free.shape))
        num, side = len(voxel), self.box.width / shape
        group = tuple((voxel // size).T)
        # 2. Across each face of these voxels, either begin at the node of a group of known cost, by the straight
        #    motion from the middle of the group, or lead an edge to another voxel of unknown cost.
        start, edges = np.full(num, np.inf), []
        for axis, step in product(range(dim), (-1, 1)):
            beside = voxel + step * (np.arange(dim) == axis)
            inside = np.flatnonzero((beside[:, axis] >= 0) & (beside[:, axis] < shape[axis]))
            starts = inside[is_known[tuple(beside[inside].T)]]
            away = (voxel[starts] - beside[starts] // size * size - size // 2) * side
            node = tuple((beside[starts] // size).T)
            start[starts] = np.minimum(start[starts], cost[node] + slowness[node] * np.linalg.norm(away, axis=1))
            target = np.asarray(np.ravel_multi_index(tuple(beside[inside].T), self.free.shape))
            place = np.searchsorted(flat, target)
            joined = np.flatnonzero(flat[np.minimum(place, num - 1)] == target)
            edges.append((inside[joined], place[joined], side[axis] * slowness[group][inside[joined]]))
        # 3. Dijkstra's algorithm from one more node, `num`, which has an edge to each start.
        starts = np.flatnonzero(np.isfinite(start))
        edges.append((np.full(len(starts), num), starts, start[starts]))
        begin, end, length = (np.concatenate(column) for column in zip(*edges, strict=True))
        graph = csr_array((np.maximum(length, np.finfo(float).tiny), (begin, end)), (num + 1, num + 1))
        distance: Any = dijkstra(graph, indices=num)
        of_parts, others = np.full(cost.shape, np.inf), np.full(cost.shape, np.inf)
        in_part = np.flatnonzero(self.part[tuple(voxel.T)])
        np.minimum.at(of_parts, tuple(voxel[in_part].T // size), distance[in_part])
        np.minimum.at(others, group, distance[:num])
        return of_parts, others


def _blocks(voxels: Bool[np.ndarray, "..."], size: int) -> Bool[np.ndarray, "..."]:
    # A view with the axes of groups first, then the axes of voxels within a group. From (8, 6) voxels and size 2:
    # (4, 2, 3, 2), then (4, 3, 2, 2).
    parts = [n for num in voxels.shape for n in (num // size, size)]
    axes = range(2 * voxels.ndim)
    return voxels.reshape(parts).transpose(*axes[::2], *axes[1::2])
