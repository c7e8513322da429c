"""SBA*: best-first search whose vertices are samples, each drawn near the most promising one so far.

In A* a vertex is done once its neighbors are known. In a continuous space it never is: one can always draw another
sample near it, but the more samples there are and the more of those drawn were rejected, the less a new one tells.
So the key of a vertex is its cost estimate divided by the chance that a sample near it is both free and new.
"""

import time
from collections import defaultdict
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from typing import NamedTuple, TypeAlias

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial import KDTree

from plr_jax._arrays import as_number, require_integer, runs
from plr_jax._problem import Problem, motion_costs
from plr_jax._types import ArrayLike, HeuristicFn, JointConfigurations
from plr_jax.collision.team import JointMotionTest
from plr_jax.planners._heuristics import estimates, require_heuristic
from plr_jax.planners._solution import Solution, Stats, Status, solution_of, straight_line_bound

Path: TypeAlias = Float[np.ndarray, "steps robots dof"]

# Of a neighborhood, in the longer side of the workspace times the square root of the number of robots.
_RADIUS = 0.1
_NUM_EXPANDED = 4  # vertices at a time, so that their samples share the calls of the tests
_NUM_SAMPLES = 8  # drawn near each of them
_NUM_PARENTS = 12  # nearest neighbors that are tried as a vertex's parent


def sba_star_plan(
    problem: Problem, heuristic: HeuristicFn, *, seed: int = 0, time_limit: float = 60.0, max_nodes: int = 50_000
) -> Solution:
    """Plan by sampling-based A*: best-first search over a tree of random joint configurations.

    Each step expands the vertices of the least key: it samples their neighborhoods, rejects the samples to which a
    straight motion collides, and joins each of the others to the neighbor by which it is reached at least cost. The
    key of a vertex is ``(g + h + r) / ((1 - density) (1 - constriction))``: cost-to-come, heuristic and the radius of
    its neighborhood, over the share of it that is free of other samples and of obstacles, as far as known. The search
    ends at the first vertex that sees the goal from within its neighborhood.

    Args:
        problem: What to solve.
        heuristic: Estimated cost-to-go. Where it is ``inf``, the estimate of the tree's parent vertex is taken; a
            negative one counts as 0.
        seed: Seed of the samples.
        time_limit: Seconds after which to give up, positive.
        max_nodes: Number of vertices at which to give up, positive.

    Returns:
        The first path found, not shortened, or none: a path is found with a probability that goes to one with the
        number of nodes, but that there is none is never shown. ``Ctrl-C`` ends the search too. The statistics count
        samples drawn as children scored.

    Raises:
        ValueError: If a limit is not positive, or the heuristic is not one for this team.

    References:
        Persson and Sharf, Sampling-based A* algorithm for robot path-planning, IJRR 33(13), 2014: without its
        anytime and annealing schedules, with a smooth count of near samples as its density. Section V of the paper.
    """
    require_heuristic(heuristic)
    require_integer("seed", seed, 0)
    require_integer("max_nodes", max_nodes, 1)
    as_number("time_limit", time_limit, "positive", lambda seconds: seconds > 0)
    search = _SBAStarSearch(problem, heuristic, seed, max_nodes)
    path, status = None, Status.INTERRUPTED
    with suppress(KeyboardInterrupt):
        path, status = search.run(time_limit)
    bound = straight_line_bound(problem)
    return solution_of(problem, path, bound, status, search.stats(), search.q[: search.size].copy())


class Neighbors(NamedTuple):
    """Pairs of a new point, by its place among the new ones, and a vertex, by its row, with their distances."""

    point: Int[np.ndarray, "pairs"]
    row: Int[np.ndarray, "pairs"]
    distance: Float[np.ndarray, "pairs"]

    def take(self, pairs: np.ndarray) -> "Neighbors":
        """Some of the pairs, by index or mask."""
        return Neighbors(*(column[pairs] for column in self))

    def nearest(self, count: int) -> "Neighbors":
        """Of each point, that many nearest."""
        pairs = self.take(np.lexsort((self.distance, self.point)))
        return pairs.take(runs(np.bincount(pairs.point))[1] < count)


class _SBAStarSearch:
    """The tree, one row a vertex, of which the first ``size`` are in use, and what its keys are made of."""

    def __init__(self, problem: Problem, heuristic: HeuristicFn, seed: int, max_nodes: int):
        self.problem, self.heuristic, self.max_nodes = problem, heuristic, max_nodes
        self.random = np.random.default_rng(seed)
        self.is_free = JointMotionTest(problem.workspace, problem.robots)
        # How far a unit of each coordinate moves a robot: of a heading, the robot's farthest corner.
        self.unit = np.ones(problem.starts.shape)
        for i, robot in enumerate(problem.robots):
            self.unit[i, 2:] = robot.circumscribed_radius if robot.dof == 3 else 0.0
        self.radius = _RADIUS * float(problem.workspace.bounds.width.max()) * np.sqrt(len(problem.robots))
        capacity = max_nodes + _NUM_EXPANDED * _NUM_SAMPLES
        self.near = _Neighborhoods(capacity, problem.starts.size, self.radius)
        self.q = np.zeros((capacity, *problem.starts.shape))
        self.cost, self.to_go = np.zeros((2, capacity))
        self.crowd, self.num_drawn, self.num_rejected = np.zeros((3, capacity))
        self.parent = np.full(capacity, -1)
        self.size, self.num_expansions, self.num_scored, self.num_valid = 0, 0, 0, 0
        self.seconds: dict[str, float] = defaultdict(float)
        self.history: tuple[tuple[float, float], ...] = ()
        self.began = time.perf_counter()
        self.insert(problem.starts[None], np.array([-1]), straight_line_bound(problem))

    def run(self, time_limit: float) -> tuple[Path | None, Status]:
        """Expand until a path is found or a limit is reached."""
        first_new = 0
        while True:
            path = self.connect_to_goal(np.arange(first_new, self.size))
            if path is not None:
                return path, Status.SOLVED
            if self.size >= self.max_nodes:
                return None, Status.MEMORY_LIMIT
            if time.perf_counter() - self.began >= time_limit:
                return None, Status.TIME_LIMIT
            first_new = self.size
            self.expand()

    def expand(self) -> None:
        """Sample near the vertices of the least keys, and join to the tree what can be reached."""
        with self.timed("choose"):
            chosen = self.least_keys()
            owner = np.repeat(chosen, _NUM_SAMPLES)
            samples = self.q[owner] + self.offsets(len(owner))
        with self.timed("check"):
            reached = self.is_free(self.q[owner], samples)
        np.add.at(self.num_drawn, owner, 1)
        np.add.at(self.num_rejected, owner[~reached], 1)
        self.num_expansions += len(chosen)
        self.num_scored += len(samples)
        self.num_valid += int(reached.sum())
        if reached.any():
            self.insert(samples[reached], owner[reached], self.to_go[owner[reached]])

    def least_keys(self) -> Int[np.ndarray, "chosen"]:
        """The vertices to expand, by what a sample near them promises."""
        rows = slice(self.size)
        # One is drawn more than was: a vertex of which nothing is known is not constricted.
        constriction = self.num_rejected[rows] / (1 + self.num_drawn[rows])
        density = self.crowd[rows] / (1 + self.crowd[rows])
        key = (self.cost[rows] + self.to_go[rows] + self.radius) / ((1 - density) * (1 - constriction))
        if self.size <= _NUM_EXPANDED:
            return np.arange(self.size)
        return np.argpartition(key, _NUM_EXPANDED)[:_NUM_EXPANDED]

    def offsets(self, n: int) -> Float[np.ndarray, "n robots dof"]:
        """Points drawn uniformly from the ball of a neighborhood, as changes of configuration."""
        moves = self.unit > 0
        direction = self.random.normal(size=(n, moves.sum()))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        away = self.radius * self.random.random((n, 1)) ** (1 / moves.sum())
        offsets = np.zeros((n, *self.unit.shape))
        offsets[:, moves] = away * direction / self.unit[moves]
        return offsets

    def insert(self, q: JointConfigurations, owner: Int[np.ndarray, "n"], inherited: ArrayLike) -> None:
        """Add vertices that can be reached from their owners, each joined to its best neighbor."""
        rows = np.arange(self.size, self.size + len(q))
        self.q[rows] = q
        with self.timed("neighbors"):
            neighbors = self.near.insert((q * self.unit).reshape(len(q), -1))
            # Count each neighbor by a Gaussian of its distance, for the new vertices and for the old ones near them.
            weight = np.exp(-2 * (neighbors.distance / self.radius) ** 2)
            np.add.at(self.crowd, rows[neighbors.point], weight)
            old = neighbors.row < rows[0]
            np.add.at(self.crowd, neighbors.row[old], weight[old])
        with self.timed("join"):
            self.join(rows, owner, neighbors.take(old).nearest(_NUM_PARENTS))
        with self.timed("heuristic"):
            to_go = estimates(self.heuristic, q)
        self.to_go[rows] = np.where(np.isfinite(to_go), to_go, inherited)
        self.size += len(q)

    def join(self, rows: Int[np.ndarray, "n"], owner: Int[np.ndarray, "n"], neighbors: Neighbors) -> None:
        """Give each new vertex the parent by which its cost is least, of its owner and its old neighbors."""
        self.parent[rows] = owner
        # The root, alone, has no owner.
        self.cost[rows] = np.where(owner < 0, 0.0, self.cost[owner] + self.step_cost(owner, rows))
        child, parent = rows[neighbors.point], neighbors.row
        cost = self.cost[parent] + self.step_cost(parent, child)
        better = np.flatnonzero(cost < self.cost[child])
        free = better[self.is_free(self.q[parent[better]], self.q[child[better]])]
        last_is_cheapest = free[np.argsort(-cost[free], kind="stable")]
        self.parent[child[last_is_cheapest]] = parent[last_is_cheapest]
        self.cost[child[last_is_cheapest]] = cost[last_is_cheapest]

    def step_cost(self, i: Int[np.ndarray, "n"], j: Int[np.ndarray, "n"]) -> Float[np.ndarray, "n"]:
        """Cost of the straight motions between vertices."""
        return motion_costs(self.problem, self.q[i], self.q[j]).sum(axis=1)

    def connect_to_goal(self, rows: Int[np.ndarray, "n"]) -> Path | None:
        """The path by way of the best of the given vertices that sees the goal and has it in its neighborhood."""
        to_goal = motion_costs(self.problem, self.q[rows], self.problem.goals)
        rows, to_goal = (x[np.linalg.norm(to_goal, axis=1) <= self.radius] for x in (rows, to_goal.sum(axis=1)))
        goals = np.broadcast_to(self.problem.goals, (len(rows), *self.problem.goals.shape))
        seen = self.is_free(self.q[rows], goals)
        if not seen.any():
            return None
        cost = self.cost[rows] + to_goal
        best = np.argmin(np.where(seen, cost, np.inf))
        self.history = ((time.perf_counter() - self.began, float(cost[best])),)
        return np.concatenate([self.path_to(int(rows[best])), self.problem.goals[None]])

    def path_to(self, row: int) -> Path:
        """The path through the tree to a vertex."""
        path = [row]
        while self.parent[path[-1]] >= 0:
            path.append(int(self.parent[path[-1]]))
        return self.q[path[::-1]]

    def stats(self) -> Stats:
        """What was done so far."""
        counts = self.size, self.num_expansions, self.num_scored, self.num_valid
        return Stats(*counts, dict(self.seconds), self.history)

    @contextmanager
    def timed(self, phase: str) -> Iterator[None]:
        """Count the seconds of a phase."""
        began = time.perf_counter()
        yield
        self.seconds[phase] += time.perf_counter() - began


class _Neighborhoods:
    """Near vertices: a k-d tree of most of them, and a list of those that came since it was built."""

    def __init__(self, capacity: int, dim: int, radius: float):
        self.points, self.radius = np.empty((capacity, dim)), radius
        self.size, self.tree = 0, KDTree(np.empty((0, dim)))

    def insert(self, points: Float[np.ndarray, "n dim"]) -> Neighbors:
        """Add points, and find the others within the radius of each, the new ones among them."""
        rows = np.arange(self.size, self.size + len(points))
        self.points[rows] = points
        self.size += len(points)
        if self.size > 256 + 1.25 * self.tree.n:
            self.tree = KDTree(self.points[: self.size])
        indexed = KDTree(points).sparse_distance_matrix(self.tree, self.radius, output_type="ndarray")
        to_recent = np.linalg.norm(points[:, None] - self.points[self.tree.n : self.size], axis=2)
        i, j = np.nonzero(to_recent <= self.radius)
        point, neighbor = np.append(indexed["i"], i), np.append(indexed["j"], self.tree.n + j)
        distance = np.append(indexed["v"], to_recent[i, j])
        others = neighbor != rows[point]
        return Neighbors(point[others], neighbor[others], distance[others])
