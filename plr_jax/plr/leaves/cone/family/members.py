"""Members of a family: of each, the best tree that its limits allow."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from plr_jax._types import FamilyCellSources, FamilyFn, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.certificate.certificate import Proof
from plr_jax.plr.growth.levels import LEAST_SHARE, LEAST_SHARE_PROVEN, BoxLevel, Prunings, expand, prune
from plr_jax.plr.growth.limits import BudgetTooSmall, Limits
from plr_jax.plr.leaves.base import MemberLeaves
from plr_jax.plr.leaves.cone.boxes import ConeBoxes, fitted_boxes, only_sources
from plr_jax.plr.leaves.cone.codec import StoredCones, cones_bits, cones_in_order, num_bytes_of
from plr_jax.plr.leaves.cone.family.start import NONE, Start, Top
from plr_jax.plr.leaves.cone.family.trees import Cut, member_trees
from plr_jax.plr.leaves.cone.sight import MemberTree, Options, options_of_trees, sources_in_sight
from plr_jax.plr.partition.cells import Cells, grown_domain
from plr_jax.plr.sampling.cell_fit import Pattern

_PRICES_A_HALVING = 4  # of prices, each this root of one half times the one before
_LAST_PRICE = 200  # 2**-50 of the domain's width: no query resolves what is left
_FIRST_PRICE, _FIRST_DROP = 16, 24
_WINDOW = 6  # prices for which trees are pruned at once
_RATE = 0.4  # about to this power of the price leaves get more as it falls
_BITS_A_LEAF, _BITS_OF_SOURCES = 4.4, 400  # about, before the first tree tells
_ROOM = 64  # one byte for so many is left for sources to be changed to others that are in sight
_LEAST_BELOW = 8  # splits below the start, or boxes there may be leaves as they are
_ALL = 1 << 40  # more boxes than there are
_FULL, _ATTEMPTS = 0.99, 4
# Boxes are left out that seldom are leaves, for which the search is twice as quick; where sources take most of the
# bytes, as of a hundred corners in 1 KB, mean errors are up to 1.6 times as large for it.
_GAIN = 4.0
"""Prices that a box must cost to be halved: below, it seldom gains one."""
_MARGIN, _MARGIN_PROVEN = 1.0, 1.2
"""Times as much as along the other axis halves may cost to be looked at further, and where largest errors count."""


@dataclass
class Member:
    """One goal, the largest tree that was found to fit, and what is aimed at next.

    Attributes:
        number: Its place among all members.
        sources: The goal, and the corners with their distances.
        target: How many leaves the next tree is to have, about.
        tree: The largest tree so far that keeps within the limits; None before the first.
        fullness: Of this tree, the share of the leaves or of the bytes that the limits allow, whichever is larger.
        attempts: How many trees were walked.
        is_done: Whether the search of a larger tree is over.
        tried: The cuts whose trees were walked, each by its price and number of boxes at the next lower one.
    """

    number: int
    sources: Sources
    target: float
    tree: MemberTree | None = None
    fullness: float = 0.0
    attempts: int = 0
    is_done: bool = False
    tried: set[tuple[int, int]] = field(default_factory=set)


@dataclass(frozen=True, eq=False)
class Family:
    """Members with the boxes that were looked at for them."""

    members: list[Member]
    levels: list[BoxLevel]


@dataclass(frozen=True, eq=False)
class _Growth:
    """The search of a price for every member, which adds boxes to the family and trees to its members."""

    family: Family
    node_of: Int[np.ndarray, "goals lowest"]
    start: Start
    domain: Box
    limits: Limits
    least_share: float

    def run(self) -> None:
        """Look at more boxes until every member has a tree."""
        now, levels = _FIRST_PRICE, self.family.levels
        while active := [each.number for each in self.family.members if not each.is_done]:
            active = np.array(active)
            reached = np.zeros(len(levels[0].key), bool)
            nodes = self.node_of[active]
            reached[nodes[nodes >= 0]] = True
            price = float(self._prices(np.array([now]))[0])
            margin = _MARGIN if self.limits.proof is Proof.NONE else _MARGIN_PROVEN
            is_open = expand(levels, reached, price, self.least_share, self.limits, _GAIN, margin)
            if not is_open:  # the best trees at any lower price are known
                now = _LAST_PRICE
            leaves = self._settle(active, now, now >= _LAST_PRICE)
            now += self._next_drop(leaves)

    def _prices(self, index: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        return float(self.domain.width.max()) * 2.0 ** (-index / _PRICES_A_HALVING)

    def _next_drop(self, leaves: Float[np.ndarray, "active"]) -> int:
        """By how many prices to go on, so that about half of the members that are left are beyond their targets."""
        left = np.array([each.target for each in self.family.members if not each.is_done])
        if not len(left):
            return 0
        ratio = float(np.median(left)) / max(float(np.median(leaves)), 1.0)
        drop = int(np.ceil(_PRICES_A_HALVING * np.log2(max(ratio, 1.0)) / _RATE))
        return int(np.clip(drop, 2, _FIRST_DROP))

    def _settle(self, active: Int[np.ndarray, "active"], now: int, is_last: bool) -> Float[np.ndarray, "active"]:
        """Give those members their trees whose targets were passed; the leaves that all have at the last price."""
        high, leaves = now, np.zeros(0)
        while len(active) and high > 0:
            low = max(high - _WINDOW, 0)
            index = np.arange(low, high + 1)
            price = self._prices(index)
            prunings, top = self._pruned(active, price)
            count = top.count[:, :, 0]
            leaves = leaves if len(leaves) else count[-1].astype(float)
            members = [self.family.members[i] for i in active]
            self._try(members, count, index, prunings, top, is_last and high == now)
            below = np.array([not each.is_done and each.target < count[0, i] for i, each in enumerate(members)], bool)
            active, high = active[below], low
        return leaves

    def _pruned(self, active: Int[np.ndarray, "active"], price: Float[np.ndarray, "prices"]) -> tuple[Prunings, Top]:
        prunings = prune(self.family.levels, price, self.least_share, _GAIN)
        node, level = self.node_of[active], self.family.levels[0]
        some = node >= 0
        total = np.where(some, prunings.total[0][:, node], price[:, None, None])
        count = np.where(some, prunings.count[0][:, node], 1)
        source = np.where(level.boxes.error[node] == 0, level.boxes.views(node.ravel()).reshape(node.shape), NONE)
        return prunings, self.start.best(total, count, np.where(some, source, -1), price)

    def _try(
        self,
        members: list[Member],
        count: Int[np.ndarray, "prices active"],
        index: Int[np.ndarray, "prices"],
        prunings: Prunings,
        top: Top,
        is_last: bool,
    ) -> None:
        """Walk trees of those whose targets lie between two prices, until these fit and are about full."""
        for _ in range(_ATTEMPTS + 1):
            chosen: list[tuple[int, int, int]] = []
            for i, each in enumerate(members):
                if each.is_done:
                    continue
                if is_last and each.target >= count[-1, i]:
                    chosen.append((i, len(index) - 2, _ALL))
                elif count[0, i] <= each.target < count[-1, i] or (index[0] == 0 and each.target < count[0, i]):
                    price = max(int(np.searchsorted(count[:, i], each.target, side="right")) - 1, 0)
                    chosen.append((i, price, self._num_lower(each, i, price, prunings, top)))
            if not chosen:
                return
            row, at, lower = map(list, zip(*chosen, strict=True))
            cut = Cut(np.array(row), np.array(at), np.array(lower))
            nodes = self.node_of[[members[i].number for i in row]]
            cut_nodes = np.zeros((top.source.shape[0], nodes.shape[1]), np.int64)
            cut_nodes[cut.goal] = nodes
            trees = member_trees(self.start, top, self.family.levels, prunings, cut_nodes, cut)
            for i, tree, last, place in zip(row, trees, lower, at, strict=True):
                self._judge(members[i], tree, last == _ALL, (int(index[place]), last))

    def _num_lower(self, member: Member, row: int, price: int, prunings: Prunings, top: Top) -> int:
        """In how many boxes of the start the next price may count, for about as many leaves as are the target."""
        start, count = self.start, prunings.count[0]
        if not start.splits:
            return 0
        nodes = self._lowest_in_order(top.choice[price, row])
        node = self.node_of[member.number, nodes]
        node = node[node >= 0]
        more = np.cumsum(count[price + 1, node] - count[price, node]) if price + 1 < len(count) else np.zeros(0)
        spare = member.target - top.count[price, row, 0]
        return int(np.searchsorted(more, spare, side="right"))

    def _lowest_in_order(self, choice: Int[np.ndarray, "boxes"]) -> Int[np.ndarray, "some"]:
        """The boxes of the start that the tree above leads to, from left to right."""
        start, here = self.start, np.zeros(1, np.int64)
        for _ in range(start.splits):
            inner = here[choice[here] >= 0]
            here = start.child[choice[inner], :, inner].ravel()
        return here - start.first[start.splits]

    def _judge(self, member: Member, tree: MemberTree, is_last: bool, which: tuple[int, int]) -> None:
        """Keep a tree if it fits, and aim at a larger or a smaller one unless it is about full."""
        # What files may take before sources are changed.
        num_leaves, most = len(tree.cells), (self.limits.max_bytes * _ROOM / (_ROOM + 1))
        num_bytes = self._num_bytes(tree, member.sources) if np.isfinite(most) else 0.0
        fullness = max(num_leaves / self.limits.max_leaves, num_bytes / most)
        fits = fullness <= 1
        if fits and (member.tree is None or fullness > member.fullness):
            member.tree, member.fullness = tree, fullness
        member.attempts += 1
        again = which in member.tried
        member.tried.add(which)
        if (fits and (is_last or fullness >= _FULL or again or member.attempts >= _ATTEMPTS)) or (
            member.attempts >= _ATTEMPTS and member.tree is not None
        ):
            member.is_done = True
        elif not fits and (num_leaves == 1 or member.target <= 1):
            enough = math.ceil(num_bytes * (_ROOM + 1) / _ROOM)
            raise BudgetTooSmall(self.limits.max_bytes, enough, f"a tree of {num_leaves} leaves")
        else:
            fixed = self.limits.file_size(2, 1, 0)
            aim = num_leaves * (most - fixed) / max(num_bytes - fixed, 1.0) if num_bytes else np.inf
            shrink = 0.998 ** max(member.attempts - 1, 0) if fits else 0.995**member.attempts
            member.target = max(min(aim, float(self.limits.max_leaves)) * shrink, 1.0)

    def _num_bytes(self, tree: MemberTree, sources: Sources) -> int:
        """Size of the file of a tree."""
        stored = stored_cones_of(tree, tree.source, sources, self.domain)
        return self.limits.file_size(2, len(tree.cells), cones_bits(self.domain, stored))


def stored_cones_of(tree: MemberTree, view: Int[np.ndarray, "leaves"], sources: Sources, domain: Box) -> StoredCones:
    """What a file keeps of the leaves of a tree whose sources are these viewpoints, corners or goals."""
    num_corners = len(sources.points) - 1
    source = np.where(view < 0, -1, np.where(view < num_corners, view + 1, 0))
    return cones_in_order(source, sources, domain)


def expected_leaves(limits: Limits) -> float:
    """About as many leaves as the limits allow."""
    room = limits.max_bytes - limits.file_size(2, 1, _BITS_OF_SOURCES)
    of_proof = limits.proof.num_bits(2, 0) - limits.proof.num_bits(1, 0)
    return float(max(1.0, min(limits.max_leaves, room * 8 / (_BITS_A_LEAF + of_proof))))


def _exact_boxes(domain: Box, negligible: float, cells: Cells, found: FamilyCellSources) -> ConeBoxes:
    """The boxes of the start, of which only those may be leaves that one source serves without an error."""
    source = only_sources(found)
    error = np.where(source >= 0, 0.0, np.inf)
    return ConeBoxes(domain, negligible, cells, found, source, error, error)


# The leaves of all members of a family, from their distance functions.


_RESOLVED = float(np.finfo(np.float32).eps / 4)  # of a distance: what no query resolves


@dataclass(frozen=True, eq=False)
class FamilyTask:
    """What all members of a family share; called with oracles of some of them, it finds their leaves.

    Attributes:
        shared: What the oracles share of the boxes of the start.
        start: The boxes at which all members start.
        domain: What the PLRs cover.
        limits: What the file of each is to keep within.
        pattern: Samples of a cell, by which sources in sight are chosen.
    """

    shared: Any
    start: Start
    domain: Box
    limits: Limits
    pattern: Pattern

    def __call__(self, oracles: Sequence[FamilyFn]) -> list[MemberLeaves]:
        """The leaves of some members."""
        found, key, node_of = oracles[0].family_sources(self.shared, oracles)
        if (lost := np.flatnonzero((node_of < 0).all(axis=1))).size:
            raise ValueError(f"Nothing was found from where the goal of oracle {lost[0]} can be reached.")
        negligible = max(self.limits.tolerance, _RESOLVED * float(self.domain.width.max()))
        sources = [oracle.sources for oracle in oracles]
        # The best trees within the limits of all goals.
        start = self.start
        limits = self.limits
        box_of = np.zeros(found.num_cells, np.int64)
        box_of[node_of[node_of >= 0]] = np.nonzero(node_of >= 0)[1]
        is_shallow = start.splits == 0 or limits.max_depth < start.splits + _LEAST_BELOW
        first = fitted_boxes if is_shallow else _exact_boxes
        boxes = first(self.domain, negligible, start.lowest[box_of], found)
        num_leaves = expected_leaves(limits)
        members = [Member(i, each, num_leaves) for i, each in enumerate(sources)]
        least = LEAST_SHARE if limits.proof is Proof.NONE else LEAST_SHARE_PROVEN
        family = Family(members, [BoxLevel.of(boxes, key)])
        _Growth(family, node_of, start, self.domain, limits, least / num_leaves).run()
        trees = [member.tree for member in family.members if member.tree is not None]
        options = options_of_trees(family.levels, trees, self.pattern)
        return [self._leaves(member, options) for member in family.members]

    def _leaves(self, member: Member, options: Options) -> MemberLeaves:
        """Those of one member, some of which have sources that are in sight instead of the best ones."""
        tree = member.tree
        assert tree is not None

        def stored(view: Int[np.ndarray, "leaves"]) -> StoredCones:
            return stored_cones_of(tree, view, member.sources, self.domain)

        def fits(view: Int[np.ndarray, "leaves"]) -> bool:
            return num_bytes_of(tree.cells, stored(view), self.domain, self.limits) <= self.limits.max_bytes

        return tree.levels, tree.cells, stored(sources_in_sight(tree, options, fits))


def family_task(first: FamilyFn, domain: Box, limits: Limits, pattern: Pattern) -> FamilyTask:
    """What all of the family of a distance function share."""
    start = Start.of(expected_leaves(limits), limits.max_axis_depth, limits.max_depth)
    shared = first.shared_cells(grown_domain(domain), *start.lowest.grown_boxes(domain))
    return FamilyTask(shared, start, domain, limits, pattern)
