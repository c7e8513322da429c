"""Which edges of one kind of robot collide with those of another, found when first asked for, and kept."""

from collections.abc import Sequence
from functools import cached_property

import numpy as np
from jaxtyping import Int
from scipy.spatial import KDTree

from plr_jax._arrays import run_members
from plr_jax.collision.pairs import motions_apart
from plr_jax.planners._budget import HeldMemory
from plr_jax.planners.lattice.edges import Kind

_CHUNK, _PAIRS = 256, 1 << 13  # edges, and pairs of them, at a time: they stay in cache, and the clock is seen
_ENTRY_BYTES = 200  # what an edge takes, besides those that collide with it


class Conflicts:
    """Collisions of simultaneous motions along the edges of a team's lattices; ``held`` counts what it keeps."""

    def __init__(self, kinds: Sequence[Kind], tolerance: float, held: HeldMemory):
        self.kinds, self.tolerance, self.held = kinds, tolerance, held
        pairs = [(a, b) for a in range(len(kinds)) for b in range(len(kinds))]
        self._known: dict[tuple[int, int], dict[int, Int[np.ndarray, _]]] = {pair: {} for pair in pairs}
        self._chunk = dict.fromkeys(pairs, 1)

    def of(self, a: int, edges: Int[np.ndarray, "m"], b: int) -> list[Int[np.ndarray, "_"]]:
        """For each of some edges of kind ``a``, the edges of kind ``b`` that collide with it.

        Raises:
            TimeoutError: If time or memory is spent before all are found. What was found is kept.
        """
        known, wanted = self._known[a, b], edges.tolist()
        missing = np.array(sorted({edge for edge in wanted if edge not in known}), dtype=np.intp)
        while len(missing):
            if self.held.budget.spent():
                raise TimeoutError("Time or memory was spent before all collisions were found.")
            part, missing = np.split(missing, [self._chunk[a, b]])
            found = self._find(a, part, b)
            known.update(zip(part.tolist(), found, strict=True))
            self.held.add(sum(_ENTRY_BYTES + edges.nbytes for edges in found))
        return [known[edge] for edge in wanted]

    def _find(self, a: int, motion: Int[np.ndarray, "m"], b: int) -> list[Int[np.ndarray, "_"]]:
        ours, others = self.kinds[a], self.kinds[b]
        begin, end = (q[motion] for q in ours.edges.q)
        reach = sum(kind.robot.circumscribed_radius + kind.edges.stride for kind in (ours, others))
        tree, order, first = self._near[b]
        near = tree.query_ball_point(begin[:, :2], reach)
        row = np.repeat(np.arange(len(motion)), [len(nodes) for nodes in near])
        node = np.concatenate(near).astype(int)
        index, at = run_members(first, node)
        row, edge = row[at], order[index]
        self._chunk[a, b] = int(np.clip(_PAIRS * len(motion) // max(1, len(row)), 1, _CHUNK))
        others_begin, others_end = (q[edge] for q in others.edges.q)
        motions = ours.robot, begin[row], end[row], others.robot, others_begin, others_end
        apart = motions_apart(*motions, self.tolerance, self.held.budget.deadline)
        row, edge = row[~apart], edge[~apart].astype(np.int32)
        return [part.copy() for part in np.split(edge, np.searchsorted(row, np.arange(1, len(motion))))]

    @cached_property
    def _near(self) -> list[tuple[KDTree, Int[np.ndarray, "edges"], Int[np.ndarray, "nodes_and_1"]]]:
        """Of each kind the places of its nodes, and its edges by the node where they begin."""
        found = []
        for kind in self.kinds:
            begin = kind.edges.begin[: kind.edges.num_edges]
            order = np.argsort(begin, kind="stable")
            first = np.searchsorted(begin[order], np.arange(len(kind.table.q) + 1))
            found.append((KDTree(kind.table.q[:, :2]), order, first))
        return found
