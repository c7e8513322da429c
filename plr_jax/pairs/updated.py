"""Pairs of a map that has changed: which entries of lists hold, which are found anew, and what fits into the bytes.

A corner between the same walls is listed for a leaf, or is not, as before, if nothing between the two has changed.
Other pairs of a leaf and a corner are tested anew: down the tree, as what a cell does not see no part of it does.
Then leaves that see some such corner in part are halved until they are as fine as others. Last, halvings are undone
that spare points no corner, and where bytes lack, those that spare them the fewest.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np
import shapely
from jaxtyping import Bool, Float, Int

from plr_jax._arrays import shortened
from plr_jax.geometry.cell_sight import Sight, corner_sight
from plr_jax.geometry.changed_distances import Corners, are_met
from plr_jax.geometry.changes import may_see, sees_all
from plr_jax.geometry.corners import CornerVisibility, ReflexCorners, find_corners
from plr_jax.geometry.workspace import Workspace
from plr_jax.pairs.construct import (
    IN_VAIN,
    corners_in_outline,
    corners_seen,
    grown,
    keys_of,
    limits_of,
    lists_of,
    outline_of,
    require_bytes,
    without_lists,
)
from plr_jax.pairs.stored import Stored, listed_by_nodes, most_leaves
from plr_jax.plr.growth import Limits
from plr_jax.plr.tree import Level, Tree, levels_of, tree_of

_NEAR = 4  # tolerances of the workspace from what has changed, within which a way meets it
_SHARE = 0.5  # of halvings, that spare less than is worth a new one
_SPARE = 0.97  # of the bytes that there are, for which halvings are undone where they are too few
_MOST_CHANGED = 0.5  # of all leaves: where more may have to be halved, all is constructed anew

Hulls = Float[np.ndarray, "2 4 n"]
Listed = Bool[np.ndarray, "leaves corners"]


def updated_pairs(
    stored: Stored, workspace: Workspace, before: Workspace, max_bytes: int | None
) -> tuple[Stored, bytes]:
    """Return the contents and the bytes of the file that :meth:`PairPLR.updated` makes."""
    limits = limits_of(workspace, max_bytes)
    if not isinstance(before, Workspace):
        raise ValueError(f"before must be the Workspace that the pairs are of, got {shortened(before)}.")
    if workspace.bounds != stored.domain:
        raise ValueError(f"The bounds must stay those of the pairs, {stored.domain}, got {workspace.bounds}.")
    visibility, unlisted, rank = without_lists(workspace)
    unlisted = replace(unlisted, label=stored.label)
    number = _numbers_now(stored, before, visibility.corners)
    update, tree = _Update(workspace, visibility, limits), stored.tree
    is_listed, is_doubtful = update.relisted(stored, number, _changed_boxes(before, workspace))
    is_other = (before.tolerance, before.squeeze) != (workspace.tolerance, workspace.squeeze)
    if is_other or is_doubtful.mean() > _MOST_CHANGED:
        return grown(workspace, limits, visibility, unlisted, rank)
    if is_doubtful.any():
        tree, is_listed = update.refined(tree, is_listed, is_doubtful)
    return _fitted(unlisted, tree, is_listed[:, np.argsort(rank)], limits)


def _numbers_now(stored: Stored, before: Workspace, corners: ReflexCorners) -> Int[np.ndarray, "corners"]:
    """Which corner each of a file's is now, between the same walls; -1 for none."""
    width = float(stored.domain.width.max())
    outline, vertex = outline_of(before.boundary, stored.domain.lo, width, before.tolerance, before.squeeze)
    points, in_file = (np.sort(each.points @ np.array([1, 1j])) for each in (outline, stored.outline))
    if outline.step != stored.outline.step or not np.array_equal(points, in_file):
        raise ValueError("before must be the map that the pairs are of, but their file has another outline.")
    was, _ = find_corners(before)
    now = {row.tobytes(): i for i, row in enumerate(_rows(corners))}
    corner, rank = corners_in_outline(outline, vertex, was.points, before.boundary)
    at_place: dict[bytes, int] = {}
    for place, row in zip(outline.points[corner][rank], _rows(was), strict=True):
        # Of those that the lattice puts in one place no list tells which is meant.
        at_place[place.tobytes()] = -1 if place.tobytes() in at_place else now.get(row.tobytes(), -1)
    return np.array([at_place.get(each.tobytes(), -1) for each in stored.outline.points[stored.corner]], np.int64)


def _rows(corners: ReflexCorners) -> Float[np.ndarray, "corners 6"]:
    return np.column_stack([corners.points, *corners.walls])


def _changed_boxes(before: Workspace, workspace: Workspace) -> list[Corners]:
    """Boxes around the parts of the plane that are free in one of two workspaces alone."""
    parts: Any = shapely.get_parts(shapely.symmetric_difference(before.free_space, workspace.free_space))
    near, ends = _NEAR * max(before.tolerance, workspace.tolerance), shapely.bounds(parts)
    return list(_hulls(ends[:, :2] - near, ends[:, 2:] + near).T)


def _hulls(lo: Float[np.ndarray, "n 2"], hi: Float[np.ndarray, "n 2"]) -> Hulls:
    """The corners of boxes, counterclockwise from the lower one."""
    (x0, y0), (x1, y1) = lo.T, hi.T
    return np.stack([np.stack([x0, x1, x1, x0]), np.stack([y0, y0, y1, y1])])


@dataclass(frozen=True, eq=False)
class _Update:
    """What lists of a map's corners are made from.

    Attributes:
        workspace: The map as it is now.
        visibility: What its corners see.
        limits: Of the partition.
    """

    workspace: Workspace
    visibility: CornerVisibility
    limits: Limits

    @cached_property
    def sight(self) -> Sight:
        """What decides at which corners paths from a box may turn first."""
        return corner_sight(self.visibility, self.workspace.triangulation)

    def relisted(
        self, stored: Stored, number: Int[np.ndarray, "before"], boxes: list[Corners]
    ) -> tuple[Listed, Bool[np.ndarray, "leaves"]]:
        """Which corners the leaves of a file list now, and which see one that was looked for anew perhaps in part.

        Args:
            stored: The file.
            number: Which corner each of its is now.
            boxes: Around what has changed.
        """
        count = len(self.visibility.corners.points)
        is_listed, is_kept = np.zeros((len(stored.cells), count), bool), np.zeros(count, bool)
        is_kept[number[number >= 0]] = True
        stays = number[stored.listed] >= 0
        is_listed[stored.leaf[stays], number[stored.listed[stays]]] = True
        tree, hulls = stored.tree, _hulls(*stored.tree.cells.grown_boxes(self.workspace.bounds))
        leaf, corner = self._open(tree, hulls, is_kept, boxes)
        hulls, sees, was = hulls[:, :, tree.node_of_leaf[leaf]], np.ones(len(leaf), bool), is_kept[corner]
        sees[was] = self._may_turn(hulls[:, :, was], corner[was])
        is_listed[leaf, corner] = sees
        in_part = ~sees_all(self.visibility.table, corner[sees], hulls[:, :, sees].T)
        is_doubtful = np.zeros(len(is_listed), bool)
        is_doubtful[leaf[sees][in_part]] = True
        return is_listed, is_doubtful

    def _open(
        self, tree: Tree, hulls: Hulls, is_kept: Bool[np.ndarray, "corners"], boxes: list[Corners]
    ) -> tuple[Int[np.ndarray, "pairs"], Int[np.ndarray, "pairs"]]:
        """Pairs of a leaf and a corner that was there between which something has changed, or one that it may see."""
        points, found = self.visibility.corners.points, [np.zeros((2, 0), np.int64)]
        node, corner = np.zeros(len(points), np.int64), np.arange(len(points))
        while len(node):
            stays, was = np.zeros(len(node), bool), is_kept[corner]
            stays[~was] = self._may_turn(hulls[:, :, node[~was]], corner[~was])
            ways = np.concatenate([points[corner[was], None], hulls[:, :, node[was]].T], axis=1)
            stays[was] = are_met(ways, boxes)
            node, corner = node[stays], corner[stays]
            is_leaf = tree.child[node] < 0
            found.append(np.stack([tree.leaf_of_node[node[is_leaf]], corner[is_leaf]]))
            node, corner = tree.halves(node[~is_leaf]), np.repeat(corner[~is_leaf], 2)
        leaf, corner = np.concatenate(found, axis=1)
        return leaf, corner

    def _may_turn(self, hulls: Hulls, corner: Int[np.ndarray, "n"]) -> Bool[np.ndarray, "n"]:
        """Whether a path from some point of each box may turn first at a corner."""
        boxes, sight = hulls.transpose(0, 2, 1), self.sight
        may = sight.may_bend(boxes, 2 * corner) | sight.may_bend(boxes, 2 * corner + 1)
        may[may] = may_see(self.visibility.table, corner[may], hulls[:, :, may].T)
        return may

    def refined(
        self, tree: Tree, is_listed: Listed, is_doubtful: Bool[np.ndarray, "leaves"]
    ) -> tuple[Tree, Bool[np.ndarray, "more corners"]]:
        """The tree and its lists after some leaves are halved until they are as fine as others."""
        domain, leaves, stay = self.workspace.bounds, tree.leaves, np.flatnonzero(~is_doubtful)
        use = _use(tree, listed_by_nodes(tree, is_listed), self.limits.max_axis_depth)
        enough = domain.width.prod() * (np.quantile(use[use > 0], _SHARE) if use.any() else IN_VAIN)
        cells = leaves[is_doubtful]
        visible = corners_seen(self.visibility, self.workspace.triangulation, *cells.grown_boxes(domain))
        all_cells, rows = [leaves[stay]], [is_listed[stay]]
        while len(cells):
            lists = lists_of(visible, cells)
            has_room = sum(map(len, rows)) + len(cells) < self.limits.max_leaves
            is_large = (keys_of(visible, lists, self.limits) > enough) & has_room
            of_cells = np.zeros((len(cells), is_listed.shape[1]), bool)
            of_cells[lists.cell, lists.corner] = True
            all_cells.append(cells[~is_large])
            rows.append(of_cells[~is_large])
            large = np.flatnonzero(is_large)
            axis, is_upper = cells[large].longest_axis(domain), np.tile([False, True], len(large))
            cells = cells[large].split(axis)
            halves = np.repeat(large, 2), np.repeat(axis, 2), is_upper, *cells.grown_boxes(domain)
            visible = visible.parts(*halves)
        tree = tree_of(all_cells[0].append(*all_cells[1:]))
        return tree, np.concatenate(rows)[tree.order]


def _fitted(unlisted: Stored, tree: Tree, is_listed: Listed, limits: Limits) -> tuple[Stored, bytes]:
    """A file of a tree and its lists, after halvings are undone: those of no use, and as many as it takes to fit."""
    of_node = listed_by_nodes(tree, is_listed)
    use, splits = _use(tree, of_node, limits.max_axis_depth), np.concatenate(tree.splits)
    splits = splits[np.lexsort((-splits, use[splits]))]  # those below a node before it
    most = min(limits.max_leaves, most_leaves(len(unlisted.corner)))
    num_leaves = min(1 + np.count_nonzero(use[splits]), most)
    while True:
        levels, leaves = _without(tree, splits[: len(is_listed) - num_leaves])
        leaf, listed = np.nonzero(of_node[leaves])
        stored = replace(unlisted, levels=levels, leaf=leaf, listed=listed)
        data = stored.to_bytes()
        if len(data) <= limits.max_bytes:
            return stored, data
        if num_leaves == 1:
            require_bytes(len(data), limits)
        # As if leaves took all bytes, and alike: too few are undone rather than too many.
        num_leaves = max(1, int(_SPARE * num_leaves * limits.max_bytes / len(data)))


def _use(tree: Tree, of_node: Bool[np.ndarray, "nodes corners"], most_halvings: int) -> Float[np.ndarray, "nodes"]:
    """How many corners the halves of each node, or of one below it, spare points of the domain, on average.

    That is how many fewer than the node they list; but to points of leaves that list none, as do those in obstacles.
    To halve along an axis more than so many times is of no use.
    """
    count, leaves = of_node.sum(axis=1), tree.node_of_leaf
    use, area = np.zeros(len(tree.child)), np.zeros(len(tree.child))
    area[leaves] = np.ldexp(1.0, -tree.leaves.depth.sum(axis=1)) * (count[leaves] > 0)
    is_allowed = np.asarray((tree.cells.depth <= most_halvings).all(axis=1))
    for split in reversed(tree.splits):
        lower, upper = tree.child[split], tree.child[split] + 1
        area[split] = area[lower] + area[upper]
        spared = area[split] * count[split] - area[lower] * count[lower] - area[upper] * count[upper]
        use[split] = np.maximum(np.where(is_allowed[lower], spared, 0.0), np.maximum(use[lower], use[upper]))
    return use


def _without(tree: Tree, undone: Int[np.ndarray, "some"]) -> tuple[list[Level], Int[np.ndarray, "leaves"]]:
    """The levels of the tree after some splits are undone, and its leaves in the order of the traversal."""
    is_split, is_there = tree.child >= 0, np.ones(len(tree.child), bool)
    is_split[undone] = False
    for split in tree.splits:
        is_there[tree.halves(split)] = np.repeat(is_there[split] & is_split[split], 2)
    leaves = np.flatnonzero(is_there & ~is_split)
    levels, order = levels_of(tree.cells[leaves])
    return levels, leaves[order]
