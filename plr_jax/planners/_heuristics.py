"""Heuristics: estimates of the cost-to-go of joint configurations, as sums over robots."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_numbers, as_values, padded, padded_size, shortened, with_inf_for_masked
from plr_jax._problem import Problem, motion_costs
from plr_jax._types import (
    ArrayLike,
    BoundingFn,
    DimensionedFn,
    HeuristicFn,
    JointConfigurations,
    StackableDistanceFn,
)

AnyDistanceFn: TypeAlias = Callable[[Any], ArrayLike]  # that answers in NumPy or JAX
# Terms of a heuristic: one a joint configuration and robot, never NaN.
PerRobot: TypeAlias = Callable[[ArrayLike], Float[np.ndarray, "n robots"]]

# Batches in which distance functions are called one by one: few sizes, as one that is compiled is compiled for each,
# and near to one another where points are many, as those of an oracle that are not asked for take time.
_BATCH_SIZES = (*(1 << k for k in range(8)), *range(256, 4097, 256))


@dataclass(frozen=True, eq=False)
class SumOverRobots:
    """A heuristic that is a sum over robots (a :class:`plr_jax._types.HeuristicFn`).

    Args:
        per_robot: Its terms, of joint configurations ``(n, robots, dof)``: one a configuration and robot.
        is_lower_bound: Whether it is nowhere above the true cost-to-go, so that a planner may prove something by it.
    """

    per_robot: PerRobot
    is_lower_bound: bool = False

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


def zero() -> SumOverRobots:
    """The heuristic that knows nothing: 0 everywhere, for any team.

    Returns:
        The heuristic.
    """
    return SumOverRobots(lambda q: np.zeros(_joint_configurations(q).shape[:2]), is_lower_bound=True)


def straight_line(problem: Problem) -> SumOverRobots:
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

    return SumOverRobots(per_robot, is_lower_bound=True)


def sum_of_distances(distance_fns: Sequence[AnyDistanceFn]) -> SumOverRobots:
    """Sum of the robots' distances, each found as if the robot were alone (Section V-B of the paper).

    A distance function of fewer dimensions than a configuration sees its leading coordinates. How many, an
    attribute ``dim`` says; oracles and PLRs have it. A function without one sees all coordinates.

    Functions of one type that offers ``stack``, as PLRs do, are called all at once. Any others are called in batches
    of few sizes, filled up with copies of a point, so that one that is compiled is compiled for few.

    Args:
        distance_fns: One distance function a robot, in the order of the robots; they may answer in NumPy or JAX.

    Returns:
        A heuristic for teams of as many robots, a lower bound if all functions say that they are, as ``plr.lower``
        and oracles do: then they have to be those of these robots' own obstacles. A configuration that is not finite
        has ``inf`` where the distance function says NaN.

    Raises:
        ValueError: If there is no function or something that is not one. When called, if the team is of another
            size, or a function wants more coordinates than there are or returns another shape than ``(n,)`` or NaN.
            What a function itself raises comes through.
    """
    if callable(distance_fns) or not isinstance(distance_fns, Iterable):
        raise ValueError(f"distance_fns must be a sequence of functions, one a robot, got {shortened(distance_fns)}.")
    distance_fns = tuple(distance_fns)
    if not distance_fns:
        raise ValueError("distance_fns must hold one function a robot, got none.")
    for i, fn in enumerate(distance_fns):
        if not callable(fn):
            raise ValueError(f"The distance function of robot {i} must be a function of (n, dim) points, got {fn!r}.")
        if isinstance(fn, DimensionedFn) and not (isinstance(fn.dim, int | np.integer) and fn.dim > 0):
            raise ValueError(f"The `dim` of the distance function of robot {i} must be 2 or 3, got {fn.dim!r}.")
    first = distance_fns[0]
    if isinstance(first, StackableDistanceFn) and all(type(fn) is type(first) for fn in distance_fns):
        evaluate = first.stack(distance_fns)
    else:
        evaluate = partial(_evaluate_each, distance_fns)

    def per_robot(q: ArrayLike) -> Float[np.ndarray, "n robots"]:
        q = _joint_configurations(q, len(distance_fns))
        distances = with_inf_for_masked(evaluate(q))
        if not np.isnan(distances.min(initial=np.inf)):  # which NaN would be
            return distances
        # A NaN where the configuration is to blame is no way; one that the function made is refused.
        broken = np.isnan(distances)
        for row, i in np.argwhere(broken & np.isfinite(q).all(axis=2)):
            at = f"at {q[row, i].tolist()}; it must return inf where there is no way"
            raise ValueError(f"The distance function of robot {i} returned NaN {at}.")
        return np.where(broken, np.inf, distances)

    bounds = all(isinstance(fn, BoundingFn) and fn.is_lower_bound for fn in distance_fns)
    return SumOverRobots(per_robot, is_lower_bound=bounds)


def require_heuristic(heuristic: object) -> None:
    """Raise ``ValueError`` if a heuristic has no terms, or is a function of this module that makes one."""
    for factory, arguments in ((zero, ""), (straight_line, "problem"), (sum_of_distances, "distance_fns")):
        if heuristic is factory:
            name = factory.__name__
            raise ValueError(f"heuristic must be what {name}({arguments}) returns, got {name} itself: call it.")
    if not isinstance(heuristic, HeuristicFn):
        expected = (
            "a sum over robots, with per_robot(q), such as sum_of_distances(distance_fns), one function a robot"
        )
        raise ValueError(f"heuristic must be {expected}, got {shortened(heuristic)}.")


def require_estimates(values: object, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """What a heuristic returned, 0 for negative numbers, or ``ValueError`` if it is NaN or not of a shape.

    A masked entry is no estimate: ``inf``.
    """
    numbers = as_numbers("What a heuristic returns", with_inf_for_masked(values), "numbers")
    if numbers.shape != shape:
        raise ValueError(f"A heuristic must return an array of shape {shape}, got {numbers.shape}.")
    if np.isnan(numbers).any():
        raise ValueError("A heuristic must never return NaN; where it knows nothing, inf or 0 will do.")
    return np.maximum(numbers, 0.0)  # planes that fit a distance near the goal may dip below 0


def _evaluate_each(distance_fns: Sequence[AnyDistanceFn], q: JointConfigurations) -> Float[np.ndarray, "n robots"]:
    """What each robot's distance function says, shown the leading coordinates that it wants."""
    distances, dof = np.empty(q.shape[:2]), q.shape[2]
    for begin in range(0, len(q), _BATCH_SIZES[-1]):
        part = q[begin : begin + _BATCH_SIZES[-1]]
        batch = padded(part, padded_size(len(part), _BATCH_SIZES), part[-1])
        for i, fn in enumerate(distance_fns):
            name, dim = f"The distance function of robot {i}", fn.dim if isinstance(fn, DimensionedFn) else None
            if dim is not None and dim > dof:
                raise ValueError(f"{name} takes {dim} coordinates, configurations have {dof}.")
            try:
                distances[begin : begin + len(part), i] = as_values(name, fn(batch[:, i, :dim]), len(batch))[
                    : len(part)
                ]
            except Exception as error:
                if dim is None and dof == 3:
                    hint = "If it is one of (x, y), give it an attribute `dim` of 2, as in `fn.dim = 2`."
                    error.add_note(f"{name} was given (x, y, theta). {hint}")
                raise
    return distances


def _joint_configurations(q: ArrayLike, num_robots: int | None = None, dof: int | None = None) -> JointConfigurations:
    """A batch of joint configurations on the host; any number of robots, and a dof of 2 or 3, where none is given."""
    expected = f"shape (n, {num_robots or 'robots'}, {dof or 'dof'})"
    q = as_numbers("Joint configurations", q, f"numbers of {expected}")
    if q.ndim != 3 or q.shape[1] != (num_robots or q.shape[1]) or q.shape[2] not in ((dof,) if dof else (2, 3)):
        hint = " Use q[None] for a single one." if q.ndim == 2 else ""
        raise ValueError(f"Joint configurations must have {expected}, got {q.shape}.{hint}")
    return q
