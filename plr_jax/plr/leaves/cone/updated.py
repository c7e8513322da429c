"""Cones after a map has changed: leaves stay where they hold, and are made anew elsewhere."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int

from plr_jax._types import ChangingFn
from plr_jax.plr.certificate.bounds import LeafBounds
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.leaves.base import ProvenLeaves, UpdatedLeaves
from plr_jax.plr.leaves.cone.boxes import ConeBoxes, fitted_boxes, resolved_error
from plr_jax.plr.leaves.cone.codec import ConeFiles
from plr_jax.plr.leaves.cone.kept import ConeLeaves
from plr_jax.plr.partition.cells import Cells, Tree, levels_of

_MOST_ROUNDS, _WORTH = 24, 0.1  # of halving, and of the largest error, which boxes have that are halved in one
_BYTES_A_LEAF = 0.8
_LEFT = 0.02  # of the leaves, for which there may be room left
_ASKED, _SPARE = 128, 1e-6  # leaves whose centers are looked at; of the largest distance, by which those may be off
_NONE = -2  # source of a node that is not made anew


def updated_cones(
    proven: ProvenLeaves, oracle: ChangingFn, before: ChangingFn, limits: Limits
) -> UpdatedLeaves | None:
    """Leaves that stay, and as many anew in the place of the others as limits allow; None if they allow none."""
    changed = oracle.changed_since(before)
    leaves = ConeLeaves(*proven, changed.slack)
    bounds = leaves.bounds
    _require_proof_of(before, leaves)
    change, source = leaves.kept(changed, before.sources, oracle.sources)
    stays, files = np.flatnonzero(~np.isnan(change)), ConeFiles(oracle.sources, leaves.domain)
    fewest = _Anew.of(leaves, np.flatnonzero(np.isnan(change)), oracle)
    old = leaves.tree.leaves[stays]

    def sources_in_order(boxes: ConeBoxes) -> tuple[Cells, Int[np.ndarray, "leaves"], Int[np.ndarray, "leaves"]]:
        cells = old.append(boxes.cells)
        order = levels_of(cells)[1]
        return cells[order], order, np.append(source[stays], boxes.source)[order]

    def too_many(boxes: ConeBoxes) -> int:
        """By how many leaves a file with these boxes is too large."""
        num_bytes = files.num_bytes(sources_in_order(boxes)[2], limits)
        return int(np.ceil((num_bytes - limits.max_bytes) / _BYTES_A_LEAF))

    while (excess := too_many(fewest.boxes)) > 0:
        if (coarser := fewest.coarser(excess)) is None:
            return None
        fewest = coarser
    boxes = fewest.boxes
    while -excess > _LEFT * len(change):  # as long as there is room for a few more
        most = len(boxes.cells) - excess
        while (more := too_many(larger := _halved(boxes, most, limits.max_axis_depth))) > 0:
            most = len(larger.cells) - more
        if len(larger.cells) == len(boxes.cells):
            break
        boxes, excess = larger, more
    cells, order, source = sources_in_order(boxes)
    place, new = np.argsort(order), files.stored(source)
    of_stays, of_boxes = np.split(place, [len(stays)])
    # A cone has moved with its offset, and a little where its source is rounded another way.
    rises = change[stays] - (new.sources.offsets[new.source[of_stays]] - leaves.offset[stays])
    beside = np.linalg.norm(new.sources.points[new.source[of_stays]] - leaves.apex[stays], axis=1)
    lower, upper = np.zeros(len(cells)), np.zeros(len(cells))
    lower[of_stays], upper[of_stays] = bounds.lower[stays] + rises - beside, bounds.upper[stays] + rises + beside
    return UpdatedLeaves(cells, new, LeafBounds(lower, upper), of_boxes, boxes.visible)


def _require_proof_of(oracle: ChangingFn, leaves: ConeLeaves) -> None:
    """Refuse another oracle than the one that bounds are of, where centers of leaves tell."""
    lo, hi = leaves.tree.leaves.boxes(leaves.domain)
    leaf = np.random.default_rng(0).permutation(len(lo))[:_ASKED]
    x = (lo[leaf] + hi[leaf]) / 2
    above = np.asarray(oracle(x)) - leaves.offset[leaf] - np.linalg.norm(x - leaves.apex[leaf], axis=1)
    spare = leaves.slack + _SPARE * float(np.abs(leaves.offset).max())
    wrong = (above < leaves.bounds.lower[leaf] - spare) | (above > leaves.bounds.upper[leaf] + spare)
    if (wrong := wrong & np.isfinite(above)).any():
        raise ValueError(
            "before must be the oracle that the PLR is of, whose proof it holds; distances of this one are others, "
            f"as at {x[wrong][0].tolist()}."
        )


@dataclass(frozen=True, eq=False)
class _Anew:
    """Nodes of a tree, in the order of its traversal, with the best cone for each.

    Attributes:
        tree: The tree.
        node: The nodes.
        boxes: Their boxes.
    """

    tree: Tree
    node: Int[np.ndarray, "boxes"]
    boxes: ConeBoxes

    @classmethod
    def of(cls, leaves: ConeLeaves, leaf: Int[np.ndarray, "some"], oracle: ChangingFn) -> "_Anew":
        """Some leaves, or nodes of which all leaves have come to use one source."""
        tree, domain, cells = leaves.tree, leaves.domain, leaves.tree.leaves[leaf]
        visible = oracle.sources_of_boxes(*cells.grown_boxes(domain))
        boxes = fitted_boxes(domain, resolved_error(oracle.sources.distances), cells, visible)
        source, root = np.full(len(tree.child), _NONE), np.arange(len(tree.child))
        source[tree.node_of_leaf[leaf]] = boxes.source
        for split in tree.splits[::-1]:
            a, b = (source[tree.child[split] + half] for half in (0, 1))
            # Where nothing is free any source will do.
            alike = (a > _NONE) & (b > _NONE) & ((a == b) | (a < 0) | (b < 0))
            source[split[alike]] = np.maximum(a, b)[alike]
        for split in tree.splits:
            whole = split[source[split] > _NONE]
            for half in (0, 1):
                root[tree.child[whole] + half] = root[whole]
        node, first, cell = np.unique(root[tree.node_of_leaf[leaf]], return_index=True, return_inverse=True)
        order = np.argsort(first)
        node, cell = node[order], np.argsort(order)[cell]
        error = np.zeros(len(node))
        np.maximum.at(error, cell, boxes.error)
        visible = visible.put_together(cell, len(node))
        integral = np.bincount(cell, boxes.integral, len(node))
        cells = tree.cells[node]
        return cls(tree, node, ConeBoxes(domain, boxes.negligible, cells, visible, source[node], error, integral))

    def coarser(self, count: int) -> "_Anew | None":
        """With parents in the place of up to so many pairs, those that err least more; None if there are no pairs."""
        tree, boxes = self.tree, self.boxes
        parent = np.full(len(tree.child), -1)
        split = np.flatnonzero(tree.child >= 0)
        parent[tree.child[split]] = parent[tree.child[split] + 1] = split
        parent = parent[self.node]
        pair = np.flatnonzero((parent[1:] == parent[:-1]) & (parent[1:] >= 0))
        if not len(pair):
            return None
        halves = boxes.visible.of_cells(np.stack([pair, pair + 1], axis=1).ravel())
        visible = halves.put_together(np.repeat(np.arange(len(pair)), 2), len(pair))
        parents = fitted_boxes(boxes.domain, boxes.negligible, tree.cells[parent[pair]], visible)
        best = np.argsort(parents.integral - boxes.integral[pair] - boxes.integral[pair + 1], kind="stable")[:count]
        rest = np.setdiff1d(np.arange(len(self.node)), np.append(pair[best], pair[best] + 1))
        order = np.argsort(np.append(rest, pair[best]))  # as they are traversed
        node = np.append(self.node[rest], parent[pair[best]])[order]
        return _Anew(tree, node, boxes[rest].append(parents[best])[order])


def _halved(boxes: ConeBoxes, most: int, deepest: int) -> ConeBoxes:
    """Boxes of which those that err most are halved, along the axis that leaves less error, up to so many.

    None is halved more often along one axis than the deepest one.
    """
    for _ in range(_MOST_ROUNDS):
        integral = np.where((boxes.cells.depth < deepest).any(axis=1), boxes.integral, 0.0)
        rows = np.argsort(-integral, kind="stable")[: max(most - len(boxes.cells), 0)]
        rows = np.sort(rows[integral[rows] > _WORTH * integral.max(initial=0.0)])
        if not len(rows):
            break
        count = len(rows)
        axis, is_upper = np.tile([0, 0, 1, 1], count), np.tile([False, True], 2 * count)
        halves, _, _ = boxes.new_halves(np.repeat(rows, 4), axis, is_upper, np.empty(0, np.uint64))
        left = halves.integral.reshape(count, 2, 2).sum(axis=2)
        left[boxes.cells.depth[rows] >= deepest] = np.inf
        best = 4 * np.arange(count) + 2 * left.argmin(axis=1)
        rest = np.setdiff1d(np.arange(len(boxes.cells)), rows)
        boxes = boxes[rest].append(halves[np.stack([best, best + 1], axis=1).ravel()])
    return boxes
