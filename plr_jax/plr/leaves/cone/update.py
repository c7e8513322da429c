"""Update a PLR of cones after a change of the map: keep leaves in which all distances changed by the same amount.

The tree minimizes error plus a price per leaf, and so does each of its subtrees. So kept leaves stay optimal at the
same price; elsewhere the optimal leaves are searched as in a construction. If the new file exceeds its byte limit,
the price rises and leaves merge. If bytes are left, the price falls and leaves with large errors are searched again.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from plr_jax._types import CellSources, ChangingFn
from plr_jax.geometry.changed_distances import ChangedDistances
from plr_jax.geometry.reach import Reach
from plr_jax.plr.best_partition import BoxLevel, SelectedBoxes, best_axes, expand, peak_share
from plr_jax.plr.cell_memory import sources_by_level
from plr_jax.plr.certificate import LeafBounds
from plr_jax.plr.growth import Limits
from plr_jax.plr.leaves.base import LeafModel
from plr_jax.plr.leaves.cone.changed_leaves import ConeLeaves
from plr_jax.plr.leaves.cone.codec import ConeFiles, StoredCones
from plr_jax.plr.leaves.cone.search import (
    ConeBoxes,
    best_cones_of_goal,
    boxes_of_levels,
    fit_boxes,
    prefer_visible_sources,
    query_resolution,
)
from plr_jax.plr.sampling import Pattern, reach_of, sample_pattern
from plr_jax.plr.tree import Rows, Tree, grown_domain, leaf_order, tree_of_axes

_ASKED, _SPARE = 128, 1e-6  # leaves at which the old oracle is tested; tolerance in units of the largest distance
_MARGIN = 1.0  # pruning margin of expand
# Share of the limits that a tree uses: _FULL is enough, and prices aim at _AIM. Below _LEFT the worst leaves are
# reopened, below _FAR all leaves are rebuilt.
_FULL, _AIM, _LEFT, _FAR = 0.99, 0.995, 0.97, 0.8
_ATTEMPTS = 12  # number of prices to try
_MOST_SOUGHT = 512  # largest number of leaves to reopen
_RATE = 2.0  # guess: price ~ (used share of the limits)**-2
_WANTING = 0.15  # share of leaves with costs above the price from which a tree counts as cut short by its limits
_NO_PRICE = np.finfo(float).tiny
_FEW = 0.03  # quantile of the gains of splits at which the price is estimated


@dataclass(frozen=True, eq=False)
class NodeCosts(Rows):
    """The best cone ``offset + |x - apex|`` of each node of a tree, as if the node were a leaf, and its errors."""

    integral: Float[np.ndarray, "nodes"]  # of the error over the node; inf if unknown
    peak: Float[np.ndarray, "nodes"]  # largest error
    source: Int[np.ndarray, "nodes"]  # index of the apex, a corner or the goal; -1 if there is none
    price: float  # penalty per leaf at which the tree has about the least sum of costs and penalties

    def costs(self, share: float) -> Float[np.ndarray, "nodes"]:
        return self.integral + share * self.peak


def compute_node_costs(leaves: ConeLeaves, oracle: ChangingFn, limits: Limits) -> NodeCosts:
    """Compute the errors that each node of a tree would have as a leaf, for the distance function ``oracle``."""
    tree, domain = leaves.tree, leaves.domain
    negligible = max(limits.tolerance, query_resolution(oracle.sources.distances))
    levels = sources_by_level(tree, oracle.cell_sources(grown_domain(domain)), domain)
    reach = reach_of(oracle, domain)
    boxes = (fit_boxes(domain, negligible, tree.cells[nodes], visible, reach=reach) for nodes, visible in levels)
    first, *others = (NodeCosts(each.integral, each.peak, each.source, np.nan) for each in boxes)
    nodes = first.append(*others)
    costs = nodes.costs(_peak_share(tree, limits))
    total, count = costs.copy(), np.ones(len(costs))
    for split in tree.splits[::-1]:
        for each in (total, count):
            each[split] = each[tree.child[split]] + each[tree.child[split] + 1]
    inner = np.flatnonzero(count > 1)
    worth = (costs - total)[inner] / (count - 1)[inner]
    worth = worth[worth > 0]
    return replace(nodes, price=float(np.quantile(worth, _FEW)) if len(worth) else max(float(costs[0]), _NO_PRICE))


def _peak_share(tree: Tree, limits: Limits) -> float:
    most = min(limits.max_bytes, limits.max_leaves)
    return peak_share(float(max(len(tree.node_of_leaf), most if np.isfinite(most) else 0)), True)


class UpdatedCones(NamedTuple):
    """Cone leaves after a change of the map, in tree order."""

    tree: Tree
    stored: StoredCones
    bounds: LeafBounds  # valid for leaves that are not rebuilt
    rebuilt: Int[np.ndarray, "rebuilt"]
    visible: CellSources  # sources of the cells of rebuilt leaves
    node_costs: NodeCosts | None


def updated_cones(
    leaves: ConeLeaves,
    node_costs: NodeCosts | None,
    changed: ChangedDistances,
    oracle: ChangingFn,
    before: ChangingFn,
    limits: Limits,
) -> UpdatedCones:
    """Keep cone leaves in which all distances changed by one number, and search the best leaves elsewhere.

    ``before`` and ``oracle`` are the distance functions of the map before and after the change, and ``changed``
    describes how their distances differ.
    """
    pattern = sample_pattern(2, LeafModel.num_samples, 0, 0)  # for choosing visible sources
    _require_proof_of(before, leaves)
    node_costs = node_costs or compute_node_costs(leaves, before, limits)
    change, source = leaves.distance_changes(changed, before.sources, oracle.sources)
    search = ConeSearch.of(leaves, node_costs, changed, change, source, oracle, limits)
    if search.is_reopened.all() and (search.levels[0].boxes.source < 0).all():
        raise ValueError(f"The goal cannot be reached any more from anywhere in the domain, {leaves.domain}.")
    best = _best_tree_within_limits(search)
    if best is None:
        visible = oracle.cell_sources(grown_domain(leaves.domain))
        tree, stored, boxes = best_cones_of_goal(visible, leaves.domain, limits, pattern, reach=search.reach)
        unknown = LeafBounds(*np.zeros((2, len(boxes.cells))))
        return UpdatedCones(tree, stored, unknown, np.arange(len(boxes.cells)), boxes.visible, None)
    new = search.files.stored(search.prefer_visible_sources(best, pattern))
    old = np.append(leaves.tree.leaf_of_node, -1)[np.minimum(best.leaves, len(leaves.tree.child))]
    stays, rebuilt = np.flatnonzero(old >= 0), np.flatnonzero(old < 0)
    old = old[stays]
    # A kept cone rose with its offset, and moved slightly if its source is rounded differently.
    rises = change[old] - (new.sources.offsets[new.source[stays]] - leaves.offset[old])
    beside = np.linalg.norm(new.sources.points[new.source[stays]] - leaves.apex[old], axis=1)
    lower, upper = np.zeros((2, len(best.leaves)))
    lower[stays] = leaves.bounds.lower[old] + rises - beside
    upper[stays] = leaves.bounds.upper[old] + rises + beside
    visible = search.visible(best.leaves[rebuilt])
    tree = tree_of_axes(best.axes, 2)
    node_costs = replace(search.all_nodes[best.nodes], price=best.price)
    return UpdatedCones(tree, new, LeafBounds(lower, upper), rebuilt, visible, node_costs)


def _require_proof_of(oracle: ChangingFn, leaves: ConeLeaves) -> None:
    lo, hi = leaves.tree.leaves.boxes(leaves.domain)
    leaf = np.random.default_rng(0).permutation(len(lo))[:_ASKED]
    x = (lo[leaf] + hi[leaf]) / 2
    above = np.asarray(oracle(x)) - leaves.offset[leaf] - np.linalg.norm(x - leaves.apex[leaf], axis=1)
    spare = leaves.slack + _SPARE * float(np.abs(leaves.offset).max())
    wrong = (above < leaves.bounds.lower[leaf] - spare) | (above > leaves.bounds.upper[leaf] + spare)
    if (wrong := wrong & np.isfinite(above)).any():
        raise ValueError(
            "before must be the oracle that the PLR is of, got one whose distance at "
            f"{x[wrong][0].tolist()} contradicts the PLR's proof. Give the oracle before the change."
        )


@dataclass(frozen=True, eq=False)
class FoundTree:
    """The tree of least cost: a leaf costs ``price`` plus its error's integral and a share of its largest error."""

    price: float
    axes: list[Int[np.ndarray, "_"]]  # split axis of each node, level by level; -1 for a leaf
    nodes: Int[np.ndarray, "nodes"]  # indices in ConeSearch.all_nodes, level by level
    leaves: Int[np.ndarray, "leaves"]  # indices in ConeSearch.all_nodes, in tree order
    share: float  # share of the limits that the tree uses


@dataclass(frozen=True, eq=False)
class ConeSearch:
    leaves: ConeLeaves
    nodes: NodeCosts  # of the old tree; inf where distances did not change by one number
    oracle: ChangingFn
    limits: Limits
    files: ConeFiles
    is_reopened: Bool[np.ndarray, "leaves"]  # whether old leaves are searched again
    roots: list[Int[np.ndarray, "_"]]  # nodes of the old tree that are replaced by boxes, which the search halves
    levels: list[BoxLevel]  # the first level has the roots, in their order
    reach: Reach | None  # of the oracle

    @staticmethod
    def of(
        leaves: ConeLeaves,
        node_costs: NodeCosts,
        changed: ChangedDistances,
        change: Float[np.ndarray, "leaves"],
        source: Int[np.ndarray, "leaves"],
        oracle: ChangingFn,
        limits: Limits,
    ) -> "ConeSearch":
        tree = leaves.tree
        least, most = np.empty((2, len(tree.child)))
        least[tree.node_of_leaf], most[tree.node_of_leaf] = change, change
        is_whole = np.isnan(least)
        for split in tree.splits[::-1]:
            first, second = tree.child[split], tree.child[split] + 1
            least[split], most[split] = np.minimum(least[first], least[second]), np.maximum(most[first], most[second])
            is_whole[split] = is_whole[first] & is_whole[second]
        now = np.where(node_costs.source < 0, node_costs.source, changed.source[node_costs.source])
        is_known = (most - least <= changed.rounding) & ((now >= 0) | (node_costs.source < 0))
        now[tree.node_of_leaf] = source
        integral, peak = (np.where(is_known, each, np.inf) for each in (node_costs.integral, node_costs.peak))
        # Roots: the largest nodes without a kept leaf.
        is_root = is_whole.copy()
        for split in tree.splits:
            whole = split[is_whole[split]]
            is_root[tree.child[whole]] = is_root[tree.child[whole] + 1] = False
        roots, nodes = np.flatnonzero(is_root), NodeCosts(integral, peak, now, node_costs.price)
        files = ConeFiles(oracle.sources, leaves.domain)
        reach = reach_of(oracle, leaves.domain)
        search = ConeSearch(leaves, nodes, oracle, limits, files, np.isnan(change), [roots], [], reach)
        boxes = search.boxes(roots)
        search.levels.append(BoxLevel.of(boxes, boxes.cells.hashes()))
        return search

    @property
    def peak_share(self) -> float:
        return _peak_share(self.leaves.tree, self.limits)

    def boxes(self, node: Int[np.ndarray, "some"]) -> ConeBoxes:
        domain, cells = self.leaves.domain, self.leaves.tree.cells[node]
        visible = self.oracle.sources_of_boxes(*cells.grown_boxes(domain))
        negligible = max(self.limits.tolerance, query_resolution(self.oracle.sources.distances))
        return fit_boxes(domain, negligible, cells, visible, reach=self.reach)

    def visible(self, node: Int[np.ndarray, "some"]) -> CellSources:
        number = node - len(self.leaves.tree.child)
        old, new = (
            self.boxes(node[number < 0]),
            boxes_of_levels([level.boxes for level in self.levels], number[number >= 0]),
        )
        return old.visible.append(new.visible).of_cells(np.argsort(np.argsort(number >= 0, kind="stable")))

    def reopen_worst_leaves(self, count: int, price: float) -> None:
        # Add up to ``count`` kept leaves to the search: the leaves with the largest errors above ``price``.
        tree, integral = self.leaves.tree, self.nodes.integral
        cost = self.nodes.costs(self.peak_share)[tree.node_of_leaf]
        cost[self.is_reopened | np.isinf(cost)] = 0.0
        leaf = np.argsort(-cost, kind="stable")[:count]
        leaf = np.sort(leaf[cost[leaf] > price])
        if not len(leaf):
            return
        self.is_reopened[leaf] = True
        self.roots.append(node := tree.node_of_leaf[leaf])
        boxes = self.boxes(node)
        self.levels[0].append(boxes, boxes.cells.hashes())
        integral[node] = np.inf
        for split in tree.splits[::-1]:
            sought = np.isinf(integral[tree.child[split]]) | np.isinf(integral[tree.child[split] + 1])
            integral[split[sought]] = np.inf

    def best(self, price: float) -> FoundTree:
        tree, (num, first) = self.leaves.tree, (len(self.leaves.tree.child), len(self.leaves.tree.child))
        cost = self.nodes.costs(self.peak_share) + price
        total = np.where(np.isfinite(cost), cost, 0.0)
        axes, children = [np.where(tree.child >= 0, tree.axis, -1)], [np.stack([tree.child, tree.child + 1], axis=1)]
        for split in tree.splits[::-1]:
            both = total[tree.child[split]] + total[tree.child[split] + 1]
            total[split] = np.minimum(cost[split], both)
            axes[0][split[cost[split] <= both]] = -1
        own = [SelectedBoxes(np.arange(len(level.key)), level.child) for level in self.levels]
        for (box, child), axis in zip(own, best_axes(self.levels, own, price, self.peak_share), strict=True):
            first += len(box)
            axes.append(axis)
            children.append(np.where(axis[:, None] >= 0, first + child[axis, :, box], -1))
        axis, child = np.concatenate(axes), np.concatenate(children)
        place, roots = np.arange(len(axis)), np.concatenate(self.roots)
        place[roots] = num + np.arange(len(roots))
        walked, nodes = [], [place[:1]]
        while len(here := nodes[-1]):
            walked.append(axis[here])
            nodes.append(place[child[here[axis[here] >= 0]]].ravel())
        node = np.concatenate(nodes)
        leaf = node[axis[node] < 0][leaf_order(walked)]
        of_bytes = self.files.num_bytes(self.all_nodes.source[leaf], self.limits) / self.limits.max_bytes
        share = max(of_bytes, len(leaf) / self.limits.max_leaves)
        return FoundTree(price, walked, node, leaf, share)

    def prefer_visible_sources(self, found: FoundTree, pattern: Pattern) -> Int[np.ndarray, "leaves"]:
        # Each leaf's source (a corner or the goal); new leaves get one that they see, where possible.
        number, source = found.leaves - len(self.leaves.tree.child), self.all_nodes.source[found.leaves]
        place = np.flatnonzero(number >= 0)

        def changed(of_new: Int[np.ndarray, "boxes"]) -> Int[np.ndarray, "leaves"]:
            sources = source.copy()
            sources[place] = of_new
            return sources

        if not len(place):
            return source
        boxes = boxes_of_levels([level.boxes for level in self.levels], number[place])
        return changed(prefer_visible_sources(boxes, pattern, lambda new: self.files.fit(self.limits, changed(new))))

    @property
    def all_nodes(self) -> NodeCosts:
        # The nodes of the tree before the update, followed by the boxes of all levels.
        return self.nodes.append(*(level.boxes for level in self.levels))


def _best_tree_within_limits(search: ConeSearch) -> FoundTree | None:
    # The largest tree found within the limits; None if all leaves should rather be rebuilt.
    price, now = search.nodes.price, search.best(_NO_PRICE)
    num_leaves = len(search.is_reopened)
    share = now.share * num_leaves / len(now.leaves)  # estimated for the tree before
    # More leaves would gain little if most leaves are kept and few of them have an error above the price.
    cost = search.nodes.costs(search.peak_share)[search.leaves.tree.node_of_leaf]
    kept = cost[~search.is_reopened & np.isfinite(cost)]
    is_full = 2 * len(kept) > len(cost) and np.mean(kept > price) < _WANTING
    if share < _FAR and not is_full:
        return None
    if share < _LEFT and not is_full:  # use the room that earlier changes left
        price *= (share / _AIM) ** _RATE
        search.reopen_worst_leaves(min(int((1 - share) * num_leaves), _MOST_SOUGHT), price)
    expand(search.levels, price, search.peak_share, search.limits, _MARGIN)
    now, fits, beyond = search.best(price), None, None
    for attempt in range(1, _ATTEMPTS + 1):
        if now.share > 1:
            beyond = now
        else:
            fits = now
            if beyond is None or now.share > _FULL:
                break
        if fits is not None and beyond is not None:
            between = np.log(_AIM / fits.share) / np.log(beyond.share / fits.share)
            price = fits.price * (beyond.price / fits.price) ** float(np.clip(between, 0.05, 0.95))
        elif len(now.leaves) > 1:
            price *= (now.share / _AIM) ** (_RATE * attempt)
        now = search.best(price)
    return None if fits is None or (fits.share < _FAR and not is_full) else fits
