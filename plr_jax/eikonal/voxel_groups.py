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

# Groups along each axis of the cube around a group whose share of free groups says how wide the place is, and the
# number of ranks of widths.
_WIDE, _RANKS = 5, 2


@dataclass(frozen=True, eq=False)
class VoxelGroups:
    """Cubes of ``size`` voxels along each axis; each is a node that stands for one connected part of its free voxels.

    The part is what faces join, within the group, to the group's free voxel nearest to the middle (``x``)::

        # # # | . . .      If no face joins the parts of neighbor groups, one of their nodes is closed: the node in
        . x . | . x .      the wider place, so that tunnels stay open, or else of the smaller part. A group that holds
        # # # | # # #      a goal stays open, and its ``x`` is the goal's voxel.
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
        """Group the voxels of a domain; ``shape`` has the number of groups along each axis, ``box`` is theirs."""
        dim, side = free.ndim, domain.width / free.shape
        size = round(float((box.width / side / shape)[0]))
        before = np.rint((domain.lo - box.lo) / side).astype(int)
        after = np.array(shape) * size - free.shape - before
        free = np.pad(free, list(zip(before, after, strict=True)))
        part = free.copy()
        blocks, of_part = _blocks(free, size), _blocks(part, size)
        inner = tuple(range(dim, 2 * dim))
        is_full, has_part = free, free
        for axis in range(dim):
            parts = (*is_full.shape[:axis], shape[axis], size, *is_full.shape[axis + 1 :])
            is_full = np.logical_and.reduce(is_full.reshape(parts), axis + 1)
            has_part = np.logical_or.reduce(has_part.reshape(parts), axis + 1)
        # 1. The voxel `x` of each group, and the part of the group that is joined to it. In groups that are not full,
        #    `far` ranks voxels: those of goals, then free ones by their distance from the middle, then blocked ones.
        mixed = np.nonzero(has_part & ~is_full)
        offset = np.array(list(product(range(size), repeat=dim)))
        far = np.where(blocks[mixed].reshape(-1, size**dim), np.sum((offset - size // 2) ** 2, axis=1), size**2 * dim)
        voxel = np.floor((goals - box.lo) / side).astype(int).clip(0, np.array(free.shape) - 1)
        row = np.full(shape, -1)
        row[mixed] = np.arange(len(far))
        home = tuple((voxel // size).T)
        holds = np.flatnonzero((row[home] >= 0) & free[tuple(voxel.T)])
        far[row[home][holds], np.ravel_multi_index(tuple((voxel % size)[holds].T), (size,) * dim)] = -1
        nearest = far.argmin(axis=1)
        live = np.zeros(far.shape, bool)
        live[np.arange(len(far)), nearest] = True
        stencil = ndimage.generate_binary_structure(dim, 1)[None]
        live = ndimage.binary_propagation(live.reshape(-1, *(size,) * dim), stencil, blocks[mixed])
        of_part[mixed] = live
        middles = np.moveaxis(np.indices(shape), 0, -1) * size + size / 2
        middles[mixed] += offset[nearest] - size // 2
        # 2. Close one of each two neighbor nodes whose parts no face joins: by `rank`, then the smaller part.
        rank = np.rint(_RANKS * ndimage.uniform_filter(is_full.astype(np.float32), _WIDE, mode="constant"))
        rank[mixed] += 1 - live.mean(axis=tuple(range(1, dim + 1)))
        rank[home] = -1.0
        is_open = has_part.copy()
        for axis in range(dim):
            low, high = ((slice(None),) * axis + (end,) for end in (slice(-1), slice(1, None)))
            last, first = (np.moveaxis(of_part, dim + axis, 0)[end] for end in (-1, 0))
            touch = last[low] & first[high]
            is_walled = is_open[low] & is_open[high] & ~touch.any(axis=inner[:-1])
            is_wider = rank[low] > rank[high]
            is_open[low] &= ~(is_walled & is_wider)
            is_open[high] &= ~(is_walled & ~is_wider)
        return cls(box, size, free, part, has_part, is_open, box.lo + middles * side)

    def completed(self, cost: Costs, slowness: Costs) -> tuple[Costs, Costs]:
        """Return the costs of all open nodes, and costs of the groups' other voxels, from the ``cost`` of a march.

        A march misses nodes to which only other voxels lead. It begins again in each region of these nodes, at the
        node nearest to the goal. For a group, the cost of its other voxel that is nearest to the goal is returned:
        ``inf`` if it has none, or no path leads there.
        """
        of_parts, others = self._costs_across_faces(cost, slowness)
        label: Any = ndimage.label(self.is_open & np.isfinite(of_parts))
        region, num = label
        if not num:
            return cost, others
        for index, box in enumerate(ndimage.find_objects(region), 1):
            is_here, start = region[box] == index, of_parts[box]
            first = float(start[is_here].min())
            start = np.where(is_here & (start == first), first, np.inf)
            costs = marched(is_here, slowness[box], start, first, self.box.width / cost.shape, (False,) * cost.ndim)
            cost[box] = np.where(is_here, np.minimum(costs, of_parts[box]), cost[box])
        return cost, self._costs_across_faces(cost, slowness)[1]

    def _costs_across_faces(self, cost: Costs, slowness: Costs) -> tuple[Costs, Costs]:
        # Paths lead from the parts whose cost is known, across faces, through all other free voxels. Return their
        # least cost in each group: to the group's part, if its cost is not known, and to any of these voxels.
        dim, size, shape = self.free.ndim, self.size, np.array(self.free.shape)
        is_known = self.part.copy()
        _blocks(is_known, size)[...] &= np.isfinite(cost)[(..., *(None,) * dim)]
        voxel = np.argwhere(self.free & ~is_known)
        flat = np.asarray(np.ravel_multi_index(tuple(voxel.T), self.free.shape))
        num, side = len(voxel), self.box.width / shape
        group = tuple((voxel // size).T)
        start, begin, end, length = np.full(num, np.inf), [], [], []
        for axis, step in product(range(dim), (-1, 1)):
            beside = voxel + step * (np.arange(dim) == axis)
            inside = np.flatnonzero((beside[:, axis] >= 0) & (beside[:, axis] < shape[axis]))
            seen = inside[is_known[tuple(beside[inside].T)]]
            away = (voxel[seen] - beside[seen] // size * size - size // 2) * side
            node = tuple((beside[seen] // size).T)
            start[seen] = np.minimum(start[seen], cost[node] + slowness[node] * np.linalg.norm(away, axis=1))
            target = np.asarray(np.ravel_multi_index(tuple(beside[inside].T), self.free.shape))
            place = np.searchsorted(flat, target)
            joined = np.flatnonzero(flat[np.minimum(place, num - 1)] == target)
            begin.append(inside[joined])
            end.append(place[joined])
            length.append(side[axis] * slowness[group][inside[joined]])
        first = np.flatnonzero(np.isfinite(start))
        begin, end = np.concatenate([*begin, np.full(len(first), num)]), np.concatenate([*end, first])
        weight = np.maximum(np.concatenate([*length, start[first]]), np.finfo(float).tiny)
        distance: Any = dijkstra(csr_array((weight, (begin, end)), (num + 1, num + 1)), indices=num)
        of_parts, others = np.full(cost.shape, np.inf), np.full(cost.shape, np.inf)
        in_part = np.flatnonzero(self.part[tuple(voxel.T)])
        np.minimum.at(of_parts, tuple(voxel[in_part].T // size), distance[in_part])
        np.minimum.at(others, group, distance[:num])
        return of_parts, others


def _blocks(voxels: Bool[np.ndarray, "..."], size: int) -> Bool[np.ndarray, "..."]:
    # A view with the axes of groups first, then the axes of voxels within a group.
    parts = [n for num in voxels.shape for n in (num // size, size)]
    axes = range(2 * voxels.ndim)
    return voxels.reshape(parts).transpose(*axes[::2], *axes[1::2])
