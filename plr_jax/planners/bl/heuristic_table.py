"""What a search knows of the cost-to-go: a heuristic's terms as tables over the lattices, or the plain function."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, UInt8

from plr_jax._types import HeuristicFn, JointConfigurations
from plr_jax.planners._heuristics import straight_line
from plr_jax.planners.bl.lattice import Lattice
from plr_jax.planners.bl.successors import Children, State, Team

_INFINITE = 1e30  # estimates that are too large for sums of float32 count as infinite

Table = Float[np.ndarray, "nodes"]  # an estimate of each configuration of a robot's lattice


class Estimate(NamedTuple):
    """A weighted heuristic over a team's lattices.

    A separable heuristic is evaluated once a configuration of a robot, before the search. Of any other, each joint
    child is evaluated; straight lines then choose which children are worth it where there are too many.

    Args:
        weight: Factor of the heuristic.
        tables: Each robot's unweighted term; of a heuristic that has none, its straight line's.
        terms: For each robot, cost and weighted term of each configuration's primitives.
        joint: The heuristic if it has no terms.
        farthest: The least that stands for an infinite joint estimate.
    """

    weight: float
    tables: tuple[Table, ...]
    terms: tuple[Float[np.ndarray, "nodes primitives"], ...]
    joint: HeuristicFn | None
    farthest: float

    def __call__(self, team: Team, state: State) -> Float[np.ndarray, "n"]:
        """Weighted estimates of joint configurations, always finite."""
        if self.joint is None:
            return self.weight * np.sum([table[s] for table, s in zip(self.tables, state.T, strict=True)], axis=0)
        # As many as a power of two, so that a compiled function is compiled for few shapes.
        padded = np.resize(state, (1 << (len(state) - 1).bit_length(), state.shape[1]))
        values = _checked(self.joint, team.configurations(padded))[: len(state)]
        known = values < _INFINITE
        return self.weight * np.where(known, values, max(self.farthest, 2 * values[known].max(initial=0.0)))

    def rescored(
        self, team: Team, state: State, children: Children
    ) -> tuple[Float[np.ndarray, "n m"], UInt8[np.ndarray, "n m robots"]]:
        """Children by the heuristic itself where straight lines chose them."""
        if self.joint is None:
            return children.score, children.primitive
        row, column = np.nonzero(np.isfinite(children.score))
        primitive = children.primitive[row, column]
        score = np.full(children.score.shape, np.inf, np.float32)
        score[row, column] = team.move_costs(state[row], primitive) + self(team, team.move(state[row], primitive))
        order = np.argsort(score, axis=1, kind="stable")
        rows = np.arange(len(score))[:, None]
        return score[rows, order], children.primitive[rows, order]


def estimate_of(team: Team, heuristic: HeuristicFn, weight: float) -> Estimate:
    """Evaluate a heuristic over the lattices of a team.

    Args:
        team: The robots.
        heuristic: Function of joint configurations; its ``per_robot`` is used where it has one. An infinite
            estimate never prunes: it counts as farther than all finite ones. A negative one counts as 0.
        weight: Factor of the heuristic.

    Returns:
        The estimate.

    Raises:
        ValueError: If the heuristic returns NaN or another shape.
    """
    separable = hasattr(heuristic, "per_robot")
    per_robot = heuristic.per_robot if separable else straight_line(team.problem).per_robot
    size = max(len(lattice.q) for lattice in team.lattices)
    # One column a robot, so that a team's PLRs answer in one call; shorter columns repeat their first rows.
    state = np.stack([np.resize(np.arange(len(lattice.q)), size) for lattice in team.lattices], axis=1)
    q = team.configurations(state)
    values = _require_estimates(per_robot(q), q.shape[:2])
    tables = tuple(_finite(column[: len(lattice.q)]) for column, lattice in zip(values.T, team.lattices, strict=True))
    terms = tuple(_terms(lattice, table, weight) for lattice, table in zip(team.lattices, tables, strict=True))
    farthest = float(2 * sum(table.max() for table in tables))
    return Estimate(weight, tables, terms, None if separable else heuristic, farthest)


def _terms(lattice: Lattice, table: Table, weight: float) -> Float[np.ndarray, "nodes primitives"]:
    return (lattice.cost + weight * table[lattice.child]).astype(np.float32)


def _finite(values: Table) -> Table:
    """A table whose infinite estimates exceed all others."""
    known = values < _INFINITE
    largest = values[known].max(initial=0.0)
    return np.where(known, values, 2 * largest)


def _checked(heuristic: HeuristicFn, q: JointConfigurations) -> Float[np.ndarray, "n"]:
    return _require_estimates(heuristic(q), q.shape[:1])


def _require_estimates(values: object, shape: tuple[int, ...]) -> np.ndarray:
    try:
        estimates = np.asarray(values, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"A heuristic must return numbers, got {values!r}.") from None
    if estimates.shape != shape:
        raise ValueError(f"A heuristic must return an array of shape {shape}, got {estimates.shape}.")
    if np.isnan(estimates).any():
        raise ValueError("A heuristic must never return NaN; where it knows nothing, inf or 0 will do.")
    return np.maximum(estimates, 0.0)  # planes that fit a distance near the goal may dip below 0
