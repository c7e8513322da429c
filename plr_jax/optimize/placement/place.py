"""Facilities in free space that serve given points at the least cost."""

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int
from tqdm import tqdm

from plr_jax._arrays import as_numbers, as_points, require_integer, shortened
from plr_jax._compiled import as_pytree
from plr_jax._types import ArrayLike
from plr_jax.geometry.workspace import Workspace, require_workspace
from plr_jax.optimize.placement.costs import LocationProblem, PlacementObjective, pair_slopes, soft_pulls
from plr_jax.optimize.placement.search import moved, searched, starts
from plr_jax.optimize.trajectory.optimize_paths import OptimizationInterrupted

# What :func:`place` is given, checked.


_TRIED = 3


def _location_problem(
    distance: Callable[[Any, Any], Any],
    workspace: Workspace,
    demand: ArrayLike,
    objective: str,
    weights: ArrayLike | None,
) -> LocationProblem:
    """The problem that the arguments state."""
    require_workspace(workspace)
    try:
        of_all = PlacementObjective(objective)
    except ValueError:
        raise ValueError(f"objective must be 'sum' or 'max', got {shortened(objective)}.") from None
    points = _free_points("demand", workspace, demand)
    return LocationProblem(workspace, _pair_distance(distance), of_all, points, _positive(weights, len(points)))


def _check_counts(k: int, num_sites: int, of_sites: str, num_restarts: int, num_iterations: int, seed: int) -> None:
    """Raise ``ValueError`` for a number out of its range."""
    for name, value, least in (
        ("k", k, 1),
        ("num_restarts", num_restarts, 1),
        ("num_iterations", num_iterations, 1),
        ("seed", seed, 0),
    ):
        require_integer(name, value, least)
    if k > num_sites:
        raise ValueError(f"k must be at most the number of {of_sites}, {num_sites:,}, got {k:,}.")


def _free_points(name: str, workspace: Workspace, given: ArrayLike) -> Float[np.ndarray, "n 2"]:
    points = as_points(name, workspace.bounds.settled(given), 2)
    if not len(points):
        raise ValueError(f"{name} must have at least one point, got none.")
    blocked = np.flatnonzero(~workspace.is_free(points))
    if blocked.size:
        raise ValueError(
            f"{name} must be points of free space: {blocked.size:,} of {len(points):,} are in an obstacle, outside "
            f"the bounds or not finite, such as {points[blocked[0]].tolist()}, number {blocked[0]}; leave them out."
        )
    return points


def _positive(weights: ArrayLike | None, count: int) -> Float[np.ndarray, "n"]:
    if weights is None:
        return np.ones(count)
    found = as_numbers("weights", weights, f"numbers of shape ({count},)")
    if found.shape != (count,):
        raise ValueError(f"weights must be one number a demand point, shape ({count},), got shape {found.shape}.")
    bad = np.flatnonzero(~((found > 0) & np.isfinite(found)))
    if bad.size:
        raise ValueError(
            f"weights must be positive and finite, got {found[bad[0]]} for demand point {bad[0]}; leave points out "
            "that do not count."
        )
    return found


def _pair_distance(distance: Callable[[Any, Any], Any]) -> Any:
    """The distance of two points as a pytree, after a trial."""
    expected = "distance must be a function that JAX can trace, such as a PairPLR, of points x and y (m, 2)"
    points = jax.ShapeDtypeStruct((_TRIED, 2), jnp.float32)
    try:
        found = jax.eval_shape(distance, points, points)
        shape, is_real = found.shape, jnp.issubdtype(found.dtype, jnp.floating)
    except (TypeError, AttributeError, ValueError, jax.errors.JAXTypeError) as error:
        raise ValueError(f"{expected}, got {shortened(distance)}.") from error
    if shape != (_TRIED,) or not is_real:
        raise ValueError(
            f"{expected} to their distances (m,), got {found.dtype} of shape {shape} for {_TRIED} pairs."
        )
    try:
        jax.eval_shape(jax.grad(lambda x, y: distance(x, y).sum()), points, points)
    except (
        TypeError,
        ValueError,
        jax.errors.JAXTypeError,
    ):  # a search without a gradient of its own: it does not pull
        of_pairs = distance
        distance = lambda x, y: of_pairs(*map(jax.lax.stop_gradient, (x, y)))  # noqa: E731
    return as_pytree(distance)


_STEP = 0.1  # at first, of the mean distance to the nearest facility
_TEMPERATURES = (0.3, 0.001)  # at first and at last, likewise
_RADII = (0.03, 1e-6)  # of the last search, likewise
_MOST_ROUNDS = 100
_ROUNDS_NEAR = 10  # for which the nearest facilities of a demand point stay among those that were near


@dataclass(frozen=True, eq=False)
class Placement:
    """Facilities, and the demand points that each of them serves.

    Attributes:
        facilities: Where they are, ``(k, 2)``, in free space.
        cost: The sum, or the largest, of all weighted distances of demand points to their facilities.
        assignment: The nearest facility of each demand point, ``(n,)``.
        distances: The distance of each demand point to it, ``(n,)``.
        start_costs: Cost of each start, facilities at demand points or candidates, from the cheapest on,
            ``(restarts,)``.
        costs: What descent made of each, ``(restarts,)``: never more than it started from. The cheapest one is then
            searched around, so that ``cost`` is at most the least of them.
    """

    facilities: Float[np.ndarray, "k 2"]
    cost: float
    assignment: Int[np.ndarray, "n"]
    distances: Float[np.ndarray, "n"]
    start_costs: Float[np.ndarray, "restarts"]
    costs: Float[np.ndarray, "restarts"]

    def __repr__(self) -> str:
        served = np.bincount(self.assignment, minlength=len(self.facilities))
        return f"Placement({len(self.facilities):,} facilities, cost {self.cost:.6g}, serving {served.tolist()})"


def place(
    distance: Callable[[Any, Any], Any],
    workspace: Workspace,
    demand: ArrayLike,
    k: int = 1,
    *,
    objective: str = "sum",
    weights: ArrayLike | None = None,
    num_restarts: int = 8,
    num_iterations: int = 60,
    seed: int = 0,
    candidates: ArrayLike | None = None,
) -> Placement:
    """Place facilities in free space, so that given points are near one: a team's meeting point, a fleet's depots.

    With the sum of distances as objective facilities are k-medians, with the largest distance k-centers; with k = 1
    it is the one place to meet. All costs are of the nearest facility of each point.

    Starts are at demand points: drawn as in k-means++, by the distance, and exchanged one by one while that is
    cheaper. From all of them at once descent follows gradients of the distance, with Adam, while demand that is
    softly assigned to all facilities, by a temperature, comes to be assigned to the nearest. Steps that a wall blocks
    slide along it. The best of all iterates is kept, and settles by a search around its facilities: at corners and at
    demand points, where the cheapest places often are, there is no gradient. Of more than 16 facilities a demand
    point sees in both the 16 that were nearest to it.

    Where facilities can only be at some given sites, ``candidates``, starts are at these instead, and the cheapest
    is the answer, without descent: no exchange of one of its sites for another makes a sum less.

    Nothing is proven of the result: for several facilities the problem is NP-hard, and among walls even one may have
    several places that are the best around. More restarts try more.

    Args:
        distance: Distance between points of free space, ``x`` and ``y`` of shape ``(m, 2)`` to ``(m,)``, at least 0
            and ``inf`` where no path joins them: a :class:`PairPLR`, or any function that JAX can trace. It is asked
            in 32-bit floats, unless JAX is set to 64. Where it has no gradient, pairs do not pull.
        workspace: Free space, to which facilities are confined.
        demand: Points to be served, ``(n, 2)``, in free space.
        k: Number of facilities, from 1 to n; to m with candidates.
        objective: What is minimized: ``"sum"`` or ``"max"`` of the weighted distances.
        weights: What a unit of distance costs each demand point, ``(n,)``, positive; None: 1 each.
        num_restarts: How many starts are drawn, at least 1. Those that are alike count once.
        num_iterations: Steps of descent, at least 1. Each asks for ``num_restarts * n * min(k, 16)`` distances and
            gradients, which is what takes the time.
        seed: Seed of the draws, at least 0. The same seed gives the same placement (on a CPU).
        candidates: The sites among which facilities are chosen, ``(m, 2)``, in free space; all ``m * n`` distances
            are held. None: anywhere in free space.

    Returns:
        The placement, whose facilities are free, and which costs no more than the best start. If interrupted (Ctrl-C)
        while it descends, the best found so far, with an ``OptimizationInterrupted`` warning.

    Raises:
        ValueError: If the workspace is none, demand or candidates are not points of free space, a weight is not
            positive and finite, another argument is out of its range, JAX cannot trace the distance, it gives NaN or
            less than 0, demand lies in more than ``k`` parts that no path joins, or no candidate reaches a point.

    References:
        Arthur and Vassilvitskii, "k-means++", SODA 2007; Teitz and Bart, "Heuristic methods for estimating the
        generalized vertex median of a weighted graph", Operations Research 16, 1968; Kingma and Ba, "Adam", ICLR
        2015. Torczon, "On the convergence of pattern search algorithms", SIAM J. Optim. 7, 1997, for the last search.
    """
    problem = _location_problem(distance, workspace, demand, objective, weights)
    sites = None if candidates is None else _free_points("candidates", workspace, candidates)
    of_sites = (problem.points, "demand points") if sites is None else (sites, "candidates")
    _check_counts(k, len(of_sites[0]), of_sites[1], num_restarts, num_iterations, seed)
    incumbents = _Incumbents(problem, starts(problem, sites, k, num_restarts, np.random.default_rng(seed)))
    start_costs = incumbents.costs.copy()
    unit = float(start_costs.min() / problem.objective.over(problem.weights))
    try:
        if unit > 0 and sites is None:
            _descend(problem, incumbents, unit, num_iterations)
            _settle(problem, incumbents, unit)
    except KeyboardInterrupt:
        message = "Interrupted: the placement is the best found so far."
        warnings.warn(message, OptimizationInterrupted, stacklevel=2)
    facilities = incumbents.x[incumbents.costs.argmin()]
    distances = problem.distances(facilities)
    nearest = distances.min(axis=0)
    return Placement(
        facilities=facilities,
        cost=float(problem.cost(nearest)),
        assignment=distances.argmin(axis=0),
        distances=nearest,
        start_costs=start_costs,
        costs=incumbents.costs,
    )


class _Incumbents:
    """The best placement found from each start, and what descent made of its cost."""

    def __init__(self, problem: LocationProblem, x: Float[np.ndarray, "restarts k 2"]):
        self.x, self.costs = x, problem.cost(problem.distances(x).min(axis=1))

    def offer(self, x: Float[np.ndarray, "restarts k 2"], costs: Float[np.ndarray, "restarts"]) -> None:
        """Keep what is cheaper."""
        cheaper = costs < self.costs
        x = np.where(cheaper[:, None, None], x, self.x)
        self.x, self.costs = x, np.where(cheaper, costs, self.costs)


def _descend(problem: LocationProblem, incumbents: _Incumbents, unit: float, num_iterations: int) -> None:
    """Adam from all starts at once, of which the incumbents keep the best iterates."""
    import optax

    weights, x = jnp.asarray(problem.weights / problem.weights.max()), incumbents.x
    adam = optax.adam(optax.cosine_decay_schedule(_STEP * unit, num_iterations))
    state = adam.init(jnp.asarray(x))
    temperatures = unit * np.geomspace(*_TEMPERATURES, num_iterations)
    near, restart = problem.near(x), np.arange(len(x))[:, None, None]

    def offered(x: Float[np.ndarray, "restarts k 2"]) -> tuple[np.ndarray, np.ndarray]:
        distances, slopes = pair_slopes(problem.distance, x[restart, near], problem.points[:, None])
        incumbents.offer(x, problem.cost(distances.min(axis=2)))
        return distances, slopes

    for temperature in tqdm(temperatures, desc="place", unit=" steps", delay=2, leave=False, disable=None):
        distances, slopes = offered(x)
        of_near = (jnp.asarray(each) for each in (distances, slopes, near))
        pulls = soft_pulls(problem.objective, weights, *of_near, x.shape[1], jnp.asarray(temperature))
        steps, state = adam.update(pulls, state)
        steps = np.asarray(steps, np.float64)
        x = moved(problem.workspace, x.reshape(-1, 2), steps.reshape(-1, 2)).reshape(x.shape)
    offered(x)


def _settle(problem: LocationProblem, incumbents: _Incumbents, unit: float) -> None:
    """Search around the facilities of the cheapest placement, which move there; costs stay those of descent."""
    first, last = (share * unit for share in _RADII)
    best = int(incumbents.costs.argmin())
    radius = np.full(incumbents.x.shape[1], first)
    for turn in range(_MOST_ROUNDS):
        x = incumbents.x[best]
        if turn % _ROUNDS_NEAR == 0:
            near = problem.near(x)
        x, radius = searched(problem, x, radius, near, turn)
        incumbents.x[best] = x
        if radius.max() < last:
            break
