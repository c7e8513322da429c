"""The best partitions of cones, within the limits of a file each: for one goal, or for many of one workspace."""

from collections.abc import Callable, Sequence
from typing import TypeAlias

import numpy as np
from jaxtyping import Int

from plr_jax._types import CellSources, Sources
from plr_jax.geometry.box import Box
from plr_jax.plr.growth.levels import BoxLevel
from plr_jax.plr.growth.limits import Limits
from plr_jax.plr.growth.optimal import EXACT, Forest, PricedTree, PriceSearch, Thrift
from plr_jax.plr.leaves.base import MemberLeaves
from plr_jax.plr.leaves.cone.boxes import root_box
from plr_jax.plr.leaves.cone.codec import ConeFiles
from plr_jax.plr.leaves.cone.sight import options_of_trees, sources_in_sight, tree_of_leaves, views_of_leaves
from plr_jax.plr.partition.cells import Cells
from plr_jax.plr.sampling.cell_fit import Pattern

_ROOM = 64
"""One byte for so many is left for sources to be changed to others that are in sight."""


Run: TypeAlias = Callable[[Forest, Callable[[Forest], Forest | None]], Forest]
"""Calls a step on trees again and again until it gives None, and gives the last ones."""


def run_through(forest: Forest, step: Callable[[Forest], Forest | None]) -> Forest:
    """A plain loop: without progress, and an interrupt is one."""
    while (larger := step(forest)) is not None:
        forest = larger
    return forest


def best_cones_of_goal(visible: CellSources, domain: Box, limits: Limits, pattern: Pattern, run: Run) -> MemberLeaves:
    """Those of one goal, from the sources of the grown domain as a cell."""
    levels = [BoxLevel.of(root_box(visible, domain, limits.tolerance), Cells.root(2).hashes())]
    root = np.zeros(1, np.int64)
    return best_cones(levels, root, [visible.sources], domain, limits, pattern, run)[0]


def best_cones(
    levels: list[BoxLevel],
    roots: Int[np.ndarray, "members"],
    sources: Sequence[Sources],
    domain: Box,
    limits: Limits,
    pattern: Pattern,
    run: Run,
    thrift: Thrift = EXACT,
) -> list[MemberLeaves]:
    """The leaves of each member, some of which have sources that are in sight instead of the best ones.

    Args:
        levels: Boxes to start with.
        roots: The box of the first level that each member starts at.
        sources: Of each member, numbered as its viewpoints are: of one goal the goal, then the corners; of a family
            the corners, then the member's goal.
        domain: What the leaves cover.
        limits: The limits of each.
        pattern: Samples of a cell, by which sources in sight are chosen.
        run: :func:`grow`, or :func:`run_through`.
        thrift: What the search leaves out.
    """
    files = [ConeFiles(each, domain) for each in sources]

    def views(member: int, view: Int[np.ndarray, "leaves"]) -> Int[np.ndarray, "leaves"]:
        # In a family all goals follow the corners by number; a member's table has its own alone, the last.
        return np.minimum(view, len(sources[member].points) - 1)

    def size(member: int, tree: PricedTree) -> int:
        if thrift.is_walked:
            view = views_of_leaves(levels, tree)[tree.order]
        else:
            view = tree_of_leaves(levels, tree, is_walked=False).source
        return files[member].num_bytes(views(member, view), limits) * (_ROOM + 1) // _ROOM

    num_sources = len(np.unique(levels[0].boxes.visible.source)) or len(sources[0].points)
    search = PriceSearch(levels, roots, limits, size, num_sources, thrift)
    trees = [tree_of_leaves(levels, tree, thrift.is_walked) for tree in run(search.first(), search.next).trees]
    options, members = options_of_trees(levels, trees, pattern), []
    for member, tree in enumerate(trees):

        def fits(view: Int[np.ndarray, "leaves"], member: int = member) -> bool:
            return files[member].num_bytes(views(member, view), limits) <= limits.max_bytes

        view = views(member, sources_in_sight(tree, options, fits))
        members.append((tree.levels, tree.cells, files[member].stored(view)))
    return members
