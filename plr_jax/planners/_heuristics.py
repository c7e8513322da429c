"""Heuristics: estimates of the cost-to-go of joint configurations, as sums over robots."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import reduce
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import shortened
from plr_jax._problem import Problem, motion_costs
from plr_jax._types import ArrayLike, DistanceFn, Distances, JointConfigurations, Points

PerRobot: TypeAlias = Callable[[ArrayLike], Float[np.ndarray, "n robots"]]
"""Terms of a heuristic: one a joint configuration and robot, never NaN."""


@dataclass(frozen=True, eq=False)
class SeparableHeuristic:
    """A heuristic that is a sum over robots (a :data:`plr_jax._types.HeuristicFn`).

    Args:
        per_robot: Its terms, of joint configurations ``(n, robots, dof)``: one a configuration and robot.
    """

    per_robot: PerRobot

    def __call__(self, q: ArrayLike) -> Float[np.ndarray, "n"]:
        """Estimated cost-to-go: the sum of the terms.

        Args:
            q: Joint configurations, ``(n, robots, dof)``, in workspace units and radians.

        Returns:
            Estimates, ``(n,)``, in workspace units, never NaN; ``inf`` where a robot has no estimate.

        Raises:
            ValueError: If ``q`` is not of that shape, or not for the robots that the heuristic is for.
        """
        terms = self.per_robot(q)
        # Robot by robot: NumPy's sum over a short last axis takes several times as long.
        return reduce(np.add, terms.T, np.zeros(len(terms)))


def zero() -> SeparableHeuristic:
    """The heuristic that knows nothing: 0 everywhere, for any team.

    Returns:
        The heuristic.
    """
    return SeparableHeuristic(lambda q: np.zeros(_joint_configurations(q).shape[:2]))


def straight_line(problem: Problem) -> SeparableHeuristic:
    """Cost of the robots' straight motions to their goals, turns included, as if there were no obstacles.

    Args:
        problem: The robots, their goals and rotation weights.

    Returns:
        A heuristic for this team, a lower bound of the true cost-to-go; ``inf`` for a configuration that is not
        finite.
    """
    num_robots, dof = problem.goals.shape

    def per_robot(q: ArrayLike) -> Float[np.ndarray, "n robots"]:
        with np.errstate(invalid="ignore"):
            cost = motion_costs(problem, _joint_configurations(q, num_robots, dof), problem.goals)
        cost[np.isnan(cost)] = np.inf
        return cost

    return SeparableHeuristic(per_robot)


def sum_of_distances(distance_fns: Sequence[Callable[[Points], ArrayLike]]) -> SeparableHeuristic:
    """Sum of the robots' distances, each found as if the robot were alone (Section V-B of the paper).

    A distance function of fewer dimensions than a configuration sees its leading coordinates. How many, an
    attribute ``dim`` says; oracles and PLRs have it. A function without one sees all coordinates of the
    configurations of round robots, ``(x, y)``. Of ``(x, y, theta)`` it is given all three and the first two, and
    must answer one of them alone, or both alike.

    Functions of one type that offers ``stack`` are called all at once: ``type(fn).stack(distance_fns)`` must give a
    function of joint configurations ``(n, robots, dof)`` that returns their distances ``(n, robots)``. ``PLR`` does.

    Args:
        distance_fns: One distance function a robot, in the order of the robots; they may answer in NumPy or JAX.

    Returns:
        A heuristic for teams of as many robots. A configuration that is not finite has ``inf`` where the distance
        function says NaN.

    Raises:
        ValueError: If there is no function or something that is not one. When called, if the team is of another
            size, or a function wants more coordinates than there are, returns another shape than ``(n,)`` or NaN,
            or has no ``dim`` where it would matter.
    """
    distance_fns = _distance_fns(distance_fns)
    kind = type(distance_fns[0])
    if hasattr(kind, "stack") and all(type(fn) is kind for fn in distance_fns):
        evaluate = kind.stack(distance_fns)
    else:
        evaluate = _one_by_one(distance_fns)

    def per_robot(q: ArrayLike) -> Float[np.ndarray, "n robots"]:
        q = _joint_configurations(q, len(distance_fns))
        return _without_nan(q, evaluate(q))

    return SeparableHeuristic(per_robot)


def _one_by_one(distance_fns: Sequence[DistanceFn]) -> Callable[[JointConfigurations], Float[np.ndarray, "n robots"]]:
    def evaluate(q: JointConfigurations) -> Float[np.ndarray, "n robots"]:
        distances = np.empty(q.shape[:2])
        for i, fn in enumerate(distance_fns):
            distances[:, i] = _distances_of_robot(i, fn, q[:, i])
        return distances

    return evaluate


def _distances_of_robot(i: int, fn: DistanceFn, q: Float[np.ndarray, "n dof"]) -> Distances:
    """What a robot's distance function says, shown the leading coordinates that it wants."""
    dof, dim = q.shape[1], getattr(fn, "dim", None)
    if dim is None and dof == 3:
        return _both_ways(i, fn, q)
    if dim is not None and dim > dof:
        raise ValueError(f"The distance function of robot {i} takes {dim} coordinates, configurations have {dof}.")
    return _checked(i, fn(q[:, :dim]), len(q))


def _both_ways(i: int, fn: DistanceFn, q: Float[np.ndarray, "n 3"]) -> Distances:
    """What a function says that does not tell whether it is one of ``(x, y, theta)`` or of ``(x, y)``."""
    answers, refusals = [], []
    for dim in (3, 2):
        try:
            answers.append(_checked(i, fn(q[:, :dim]), len(q)))
        except (ValueError, TypeError, IndexError) as refusal:
            refusals.append(refusal)
    if not answers:
        raise ValueError(f"The distance function of robot {i} fails for (n, 3) and (n, 2) points.") from refusals[0]
    if not np.array_equal(answers[0], answers[-1], equal_nan=True):
        raise ValueError(
            f"The distance function of robot {i} answers (x, y, theta) and (x, y) differently. "
            "Give it an attribute `dim` of 3 or 2, as in `fn.dim = 2`."
        )
    return answers[0]


def _checked(i: int, distances: ArrayLike, n: int) -> Distances:
    """A function's result on the host."""
    try:
        result = np.asarray(distances, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(
            f"The distance function of robot {i} must return numbers, got {shortened(distances)}."
        ) from None
    if result.shape != (n,):
        raise ValueError(f"The distance function of robot {i} must return shape ({n},), got {result.shape}.")
    return result


def _without_nan(q: JointConfigurations, distances: Float[np.ndarray, "n robots"]) -> Float[np.ndarray, "n robots"]:
    """The distances, ``inf`` for NaN where the configuration is to blame; a NaN that the function made is refused."""
    if not np.isnan(distances.min(initial=np.inf)):  # which NaN would be
        return distances
    broken = np.isnan(distances)
    unexplained = np.argwhere(broken & np.isfinite(q).all(axis=2))
    if len(unexplained):
        row, i = unexplained[0]
        raise ValueError(
            f"The distance function of robot {i} returned NaN at {q[row, i].tolist()}; "
            "it must return inf where there is no way."
        )
    return np.where(broken, np.inf, distances)


def _distance_fns(distance_fns: Any) -> tuple[DistanceFn, ...]:
    if callable(distance_fns) or not hasattr(distance_fns, "__iter__"):
        raise ValueError(f"distance_fns must be a sequence of functions, one a robot, got {shortened(distance_fns)}.")
    distance_fns = tuple(distance_fns)
    if not distance_fns:
        raise ValueError("distance_fns must hold one function a robot, got none.")
    for i, fn in enumerate(distance_fns):
        if not callable(fn):
            raise ValueError(f"The distance function of robot {i} must be a function of (n, dim) points, got {fn!r}.")
        dim = getattr(fn, "dim", None)
        if dim is not None and not (isinstance(dim, int | np.integer) and dim > 0):
            raise ValueError(f"The `dim` of the distance function of robot {i} must be 2 or 3, got {dim!r}.")
    return distance_fns


def _joint_configurations(q: ArrayLike, num_robots: int | None = None, dof: int | None = None) -> JointConfigurations:
    """A batch of joint configurations on the host; any number of robots, and a dof of 2 or 3, where none is given."""
    expected = f"shape (n, {num_robots or 'robots'}, {dof or 'dof'})"
    try:
        q = np.asarray(q, dtype=np.float64)
    except (TypeError, ValueError):
        raise ValueError(f"Joint configurations must be numbers of {expected}, got {shortened(q)}.") from None
    if q.ndim != 3 or q.shape[1] != (num_robots or q.shape[1]) or q.shape[2] not in ((dof,) if dof else (2, 3)):
        hint = " Use q[None] for a single one." if q.ndim == 2 else ""
        raise ValueError(f"Joint configurations must have {expected}, got {q.shape}.{hint}")
    return q
