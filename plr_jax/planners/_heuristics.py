"""Heuristics of the team planner: estimated costs-to-go of joint configurations, as sums over robots."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from functools import partial, reduce
from operator import add
from typing import Any, TypeAlias

import numpy as np
from jaxtyping import Float

from plr_jax._arrays import as_numbers, as_values, batches, filled_with_inf, is_traced, padded, padded_size, shortened
from plr_jax._problem import Problem, motion_costs
from plr_jax._types import ArrayLike, BoundingFn, DimensionedFn, HeuristicFn, JointConfigurations, StackableDistanceFn

AnyDistanceFn: TypeAlias = Callable[[Any], ArrayLike]  # returns a NumPy or JAX array
# Few sizes, since a jitted function compiles once per size; close together if large, since padding costs time.
_BATCH_SIZES = (*(1 << k for k in range(8)), *range(256, 4097, 256))


@dataclass(frozen=True, eq=False)
class SumOverRobots:
    """A heuristic for a team: the cost-to-go of a joint configuration is estimated as a sum of one term per robot."""

    per_robot: Callable[[ArrayLike], Float[np.ndarray, "n robots"]]  # the terms, never NaN
    is_lower_bound: bool = False  # whether the sum never exceeds the true cost-to-go

    def __call__(self, q: ArrayLike) -> Any:
        """Return estimated costs-to-go ``(n,)`` of joint configurations, in workspace units; they are never NaN."""
        terms = self.per_robot(q)
        # Robot by robot: NumPy's sum over a short last axis takes several times as long.
        return reduce(add, terms.T, np.zeros(len(terms)))


def zero() -> SumOverRobots:
    """Return the heuristic that is 0 everywhere, for any team."""
    return SumOverRobots(lambda q: np.zeros(_joint_configurations(q).shape[:2]), is_lower_bound=True)


def straight_line(problem: Problem) -> SumOverRobots:
    """Return the heuristic that ignores obstacles: the cost of straight motions and turns to the problem's goals.

    It is a lower bound.
    """
    num_robots, dof = problem.goals.shape

    def per_robot(q: ArrayLike) -> Float[np.ndarray, "n robots"]:
        with np.errstate(invalid="ignore"):
            cost = motion_costs(problem, _joint_configurations(q, num_robots, dof), problem.goals)
        return np.where(np.isnan(cost), np.inf, cost)

    return SumOverRobots(per_robot, is_lower_bound=True)


def sum_of_distances(distance_fns: Sequence[AnyDistanceFn]) -> SumOverRobots:
    """Return the heuristic that adds up the robots' distances to their goals (Section V-B of the paper).

    Functions of one type that offers ``stack``, as PLRs do, are evaluated by one call. Others are called one by one,
    in batches of a few fixed sizes, so that functions under ``jit`` compile only a few times. Inside a jitted
    function, a heuristic of traceable functions, such as PLRs, takes and returns arrays of JAX.

    Args:
        distance_fns: One distance function per robot, which returns NumPy or JAX arrays. If it has an attribute
            ``dim``, as oracles and PLRs do, it receives the first ``dim`` coordinates of a configuration, else all.

    Returns:
        A heuristic for teams of this size. It counts as a lower bound if every function has a true attribute
        ``is_lower_bound``, as oracles and ``plr.lower`` do. Each function must then be computed among the obstacles
        of its own robot (for a disc, grown by its radius).

    Raises:
        ValueError: If ``distance_fns`` is empty or holds anything but functions. When the heuristic is called: if the
            team has another size, or a function has a ``dim`` above the team's, or returns a wrong shape, or NaN for
            a finite configuration.
    """
    if callable(distance_fns) or not isinstance(distance_fns, Iterable):
        raise ValueError(f"distance_fns must hold one function per robot, got {shortened(distance_fns)}.")
    distance_fns = tuple(distance_fns)
    if not distance_fns:
        raise ValueError("distance_fns must hold one function per robot, got none.")
    for i, fn in enumerate(distance_fns):
        if not callable(fn):
            raise ValueError(f"The distance function of robot {i} must be a function of (n, dim) points, got {fn!r}.")
        if isinstance(fn, DimensionedFn) and not (isinstance(fn.dim, int | np.integer) and fn.dim > 0):
            raise ValueError(f"The `dim` of the distance function of robot {i} must be 1, 2 or 3, got {fn.dim!r}.")
    first = distance_fns[0]
    if isinstance(first, StackableDistanceFn) and all(type(fn) is type(first) for fn in distance_fns):
        evaluate = first.stack(distance_fns)
    else:
        evaluate = partial(_evaluate_each, distance_fns)

    def per_robot(q: ArrayLike) -> Any:
        q = _joint_configurations(q, len(distance_fns), traced=True)
        if is_traced(q):
            of_robots: Any = [fn(q[:, i, : getattr(fn, "dim", None)]) for i, fn in enumerate(distance_fns)]
            distances = q.__array_namespace__().stack(of_robots, axis=1)
            return q.__array_namespace__().where(distances == distances, distances, np.inf)
        distances = filled_with_inf(evaluate(q))
        if not np.isnan(distances.min(initial=np.inf)):  # the minimum is NaN if any entry is
            return distances
        # NaN counts as unreachable where the configuration is not finite, and is an error of the function elsewhere.
        broken = np.isnan(distances)
        for row, i in np.argwhere(broken & np.isfinite(q).all(axis=2)):
            at = f"at {q[row, i].tolist()}; it must return inf where the goal is unreachable"
            raise ValueError(f"The distance function of robot {i} returned NaN {at}.")
        return np.where(broken, np.inf, distances)

    return SumOverRobots(per_robot, all(isinstance(fn, BoundingFn) and fn.is_lower_bound for fn in distance_fns))


def require_heuristic(heuristic: object) -> None:
    for factory, arguments in ((zero, ""), (straight_line, "problem"), (sum_of_distances, "distance_fns")):
        if heuristic is factory:
            name = factory.__name__
            raise ValueError(f"heuristic must be the result of {name}({arguments}), got {name} itself: call it.")
    if not isinstance(heuristic, HeuristicFn):
        expected = "a sum over robots with a method per_robot(q), such as sum_of_distances(distance_fns)"
        raise ValueError(f"heuristic must be {expected}, got {shortened(heuristic)}.")


def require_estimates(values: object, shape: tuple[int, ...]) -> Float[np.ndarray, "..."]:
    """Check a heuristic's values, and return them with 0 for negative values and ``inf`` for masked values.

    ``ValueError`` if ``values`` do not have the expected ``shape``, or have a NaN.
    """
    numbers = as_numbers("The result of a heuristic", filled_with_inf(values), "numbers")
    if numbers.shape != shape:
        raise ValueError(f"A heuristic must return an array of shape {shape}, got {numbers.shape}.")
    if np.isnan(numbers).any():
        raise ValueError("A heuristic must not return NaN; return inf or 0 where it has no estimate.")
    return np.maximum(numbers, 0.0)  # planes fitted near the goal may dip below 0


def _evaluate_each(distance_fns: Sequence[AnyDistanceFn], q: JointConfigurations) -> Float[np.ndarray, "n robots"]:
    """Return the distance of each robot to its goal in each joint configuration ``(n, robots, dof)``.

    ``distance_fns`` has one function per robot. The functions are called with batches of few sizes, because a jitted
    function compiles once for each size.
    """
    distances, dof = np.empty(q.shape[:2]), q.shape[2]
    for part, result in zip(batches(q, _BATCH_SIZES[-1]), batches(distances, _BATCH_SIZES[-1]), strict=True):
        batch = padded(part, padded_size(len(part), _BATCH_SIZES), part[-1])
        for i, fn in enumerate(distance_fns):
            name, dim = f"The distance function of robot {i}", fn.dim if isinstance(fn, DimensionedFn) else None
            if dim is not None and dim > dof:
                raise ValueError(f"{name} takes {dim} coordinates, but configurations have {dof}.")
            try:
                result[:, i] = as_values(name, fn(batch[:, i, :dim]), len(batch))[: len(part)]
            except Exception as error:
                if dim is None and dof == 3:
                    hint = "If it is a function of (x, y), set its attribute `dim`: `fn.dim = 2`."
                    error.add_note(f"{name} was given (x, y, theta). {hint}")
                raise
    return distances


def _joint_configurations(q: Any, num_robots: int | None = None, dof: int | None = None, traced: bool = False) -> Any:
    """Check joint configurations ``(n, robots, dof)``, and return them as 64-bit floats.

    ``num_robots=None`` allows any number of robots, ``dof=None`` 2 or 3 coordinates. If ``traced``, an array that JAX
    traces is returned as it is.
    """
    expected = f"shape (n, {num_robots or 'robots'}, {dof or 'dof'})"
    q = q if traced and is_traced(q) else as_numbers("Joint configurations", q, f"numbers of {expected}")
    if q.ndim != 3 or q.shape[1] != (num_robots or q.shape[1]) or q.shape[2] not in ((dof,) if dof else (2, 3)):
        hint = " Use q[None] for a single joint configuration." if q.ndim == 2 else ""
        raise ValueError(f"Joint configurations must have {expected}, got {q.shape}.{hint}")
    return q
