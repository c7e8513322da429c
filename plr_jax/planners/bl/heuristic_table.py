"""What a search knows of the cost-to-go: a heuristic's terms as tables over the lattices, or the plain function."""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from plr_jax._deadline import require_time
from plr_jax._types import HeuristicFn, SeparableHeuristic
from plr_jax.planners._heuristics import estimates, require_estimates
from plr_jax.planners.bl.successors import Successors
from plr_jax.planners.lattice.joint import JointLattice, State

_CHUNK = 1 << 15  # nodes at a time, between two looks at the clock
_PURPOSE = "the heuristic was known"
_INFINITE = 1e30  # estimates that are too large for sums of float32 count as infinite

Table = Float[np.ndarray, "_"]  # an estimate of each configuration of a robot's lattice


class HeuristicTable(NamedTuple):
    """A weighted heuristic over the robots' lattices.

    A separable heuristic is evaluated once a configuration of a robot, before the search. Of any other, each joint
    child is evaluated; straight lines then choose which children are worth it where there are too many.

    The ``tables`` hold each robot's unweighted terms (of a ``plain`` heuristic, which has none, those of straight
    lines), ``scores`` the cost of each configuration's primitives and the weighted term of where they lead;
    ``farthest`` is the least that stands for an infinite joint estimate.
    """

    weight: float
    tables: tuple[Table, ...]
    scores: tuple[Float[np.ndarray, "nodes primitives"], ...]
    plain: HeuristicFn | None
    farthest: float

    def __call__(self, joint: JointLattice, state: State) -> Float[np.ndarray, "n"]:
        """Weighted estimates of joint configurations, always finite."""
        if self.plain is None:
            return self.weight * np.sum([table[s] for table, s in zip(self.tables, state.T, strict=True)], axis=0)
        values = estimates(self.plain, joint.configurations(state))
        known = values < _INFINITE
        return self.weight * np.where(known, values, max(self.farthest, 2 * values[known].max(initial=0.0)))

    def rescored(
        self, joint: JointLattice, state: State, children: Successors
    ) -> tuple[Float[np.ndarray, "n m"], UInt8[np.ndarray, "n m robots"]]:
        """Successors by the heuristic itself where straight lines chose them."""
        if self.plain is None:
            return children.score, children.primitive
        row, column = np.nonzero(np.isfinite(children.score))
        primitive = children.primitive[row, column]
        score = np.full(children.score.shape, np.inf, np.float32)
        score[row, column] = joint.move_costs(state[row], primitive) + self(joint, joint.move(state[row], primitive))
        order = np.argsort(score, axis=1, kind="stable")
        rows = np.arange(len(score))[:, None]
        return score[rows, order], children.primitive[rows, order]


def tabulate(joint: JointLattice, heuristic: SeparableHeuristic, deadline: float = math.inf) -> list[Table]:
    """A heuristic's terms over the robots' lattices, ``ValueError`` if it returns NaN or another shape.

    A negative estimate counts as 0.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    size, chunk = max(len(lattice.q) for lattice in joint.lattices), max(1, _CHUNK // (1 + len(joint.lattices) // 16))
    # One column a robot, so that a team's PLRs answer in one call; shorter columns repeat their first rows.
    state = np.stack([np.resize(np.arange(len(lattice.q)), size) for lattice in joint.lattices], axis=1)
    values = np.empty(state.shape)
    for begin in range(0, size, chunk):
        require_time(deadline, _PURPOSE)
        q = joint.configurations(state[begin : begin + chunk])
        values[begin : begin + chunk] = require_estimates(heuristic.per_robot(q), q.shape[:2])
    return [column[: len(lattice.q)] for column, lattice in zip(values.T, joint.lattices, strict=True)]


def heuristic_table(
    joint: JointLattice,
    values: Sequence[Float[np.ndarray, "_"]],
    weight: float,
    plain: HeuristicFn | None = None,
    deadline: float = math.inf,
) -> HeuristicTable:
    """A heuristic's terms, with a weight; of a ``plain`` one, those of straight lines.

    An infinite estimate never prunes: it counts as farther than all finite ones.

    Raises:
        TimeoutError: If the deadline, on the clock of ``time.perf_counter``, passes first.
    """
    tables, scores = tuple(_finite(column) for column in values), []
    for lattice, table in zip(joint.lattices, tables, strict=True):
        require_time(deadline, _PURPOSE)
        scores.append((lattice.cost + weight * table[lattice.child]).astype(np.float32))
    return HeuristicTable(weight, tables, tuple(scores), plain, float(2 * sum(table.max() for table in tables)))


def _finite(values: Table) -> Table:
    """A table whose infinite estimates exceed all others."""
    known = values < _INFINITE
    largest = values[known].max(initial=0.0)
    return np.where(known, values, 2 * largest)
