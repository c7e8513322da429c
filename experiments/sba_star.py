"""SBA*, sampling-based A*, under each heuristic: whether heuristics help it. The paper found that they do not.

In A*, a node is done once it is expanded. In a continuous space, another sample can always be drawn near a vertex.
A vertex promises less the more samples are near it, and the more of them were rejected. So the key of a vertex is its
cost estimate over the chance that a sample near it is new and free. The search follows Persson and Sharf,
"Sampling-based A* algorithm for robot path-planning", IJRR 33(13), 2014, without their anytime and annealing
schedules; the density of a vertex grows from 0 to 1 with the samples in the tree that are near it.

A run is of one scene as published, one heuristic and one seed. It ends at its first path, or at a number of vertices.
Vertices and costs depend on the seed alone; seconds do not. Every path is checked by ``validate``. ``p_value``
compares the numbers of vertices with those of the runs without a heuristic (Mann-Whitney U test). A run without a
path enters the test with the number of vertices at which it ended.
"""

import itertools
import time
from typing import Any

import numpy as np
from jaxtyping import Float, Int
from scipy.spatial.distance import cdist
from scipy.stats import mannwhitneyu
from tqdm import tqdm

from experiments._measures import columns
from experiments._planning import HEURISTICS, PLR_BYTES, SCENES, SMOKE_BYTES, build
from experiments._runner import run
from plr_jax import HeuristicFn, Problem, exact_lower_bound, validate
from plr_jax.collision.motions import JointMotionTest
from plr_jax.metrics import path_cost

NAMES = ("single door", "four rooms 2", "cross 2")
NUM_SEEDS = 20
MAX_VERTICES = 20_000

RADIUS = 0.1  # of a neighborhood, relative to max(width) * sqrt(number of robots)
NUM_EXPANDED = 4  # vertices expanded per step, whose samples are tested in one call
NUM_SAMPLES = 8  # drawn near each vertex that is expanded
NUM_PARENTS = 12  # nearest neighbors that are tried as a vertex's parent
_FEW_VERTICES = 200  # with --smoke, and of the search that only compiles


class Search:
    """A tree of samples, one row a vertex, of which the first ``size`` are in use."""

    def __init__(self, problem: Problem, heuristic: HeuristicFn, seed: int, max_vertices: int):
        self.problem, self.heuristic, self.max_vertices = problem, heuristic, max_vertices
        self.rng = np.random.default_rng(seed)
        self.is_free_motion = JointMotionTest(problem.workspace, problem.robots)
        self.radius = RADIUS * float(problem.workspace.bounds.width.max()) * np.sqrt(len(problem.robots))
        capacity = max_vertices + NUM_EXPANDED * NUM_SAMPLES
        self.q = np.zeros((capacity, *problem.starts.shape))
        # num_near: number of neighbors, each weighted by a Gaussian of its distance.
        self.cost, self.estimate, self.num_near, self.num_drawn, self.num_rejected = np.zeros((5, capacity))
        self.parent = np.full(capacity, -1)
        self.q[0], self.size = problem.starts, 1
        self.estimate[0] = heuristic(problem.starts[None])[0]

    def run(self) -> Float[np.ndarray, "steps robots 2"] | None:
        """Expand vertices until one of them sees the goal from within its neighborhood."""
        new, goals = np.zeros(1, int), self.problem.goals
        while self.size < self.max_vertices:
            near = new[np.linalg.norm(self.q[new] - goals, axis=(1, 2)) <= self.radius]
            sees = near[self.is_free_motion(self.q[near], np.broadcast_to(goals, self.q[near].shape))]
            if len(sees):
                return self._path_to_goals(sees[np.argmin(self.cost[sees] + lengths(self.q[sees], goals))])
            new = self.expand()
        return None

    def _path_to_goals(self, row: int) -> Float[np.ndarray, "steps robots 2"]:
        path = [self.problem.goals]
        while row >= 0:
            path.append(self.q[row])
            row = self.parent[row]
        return np.array(path[::-1])

    def expand(self) -> Int[np.ndarray, " new"]:
        """Sample near the vertices of the least keys, and join the samples that can be reached to the tree."""
        # 1. key = (cost-to-come + heuristic + radius) / ((1 - density) (1 - constriction)). Without the radius, the
        # start would keep the key 0 under the heuristic 0.
        rows = slice(self.size)
        density = self.num_near[rows] / (1 + self.num_near[rows])
        constriction = self.num_rejected[rows] / (1 + self.num_drawn[rows])
        key = (self.cost[rows] + self.estimate[rows] + self.radius) / ((1 - density) * (1 - constriction))
        chosen = np.argpartition(key, min(NUM_EXPANDED, self.size) - 1)[:NUM_EXPANDED]

        # 2. Samples, uniform in the ball around each of these vertices.
        owner = np.repeat(chosen, NUM_SAMPLES)
        direction = self.rng.normal(size=(len(owner), self.problem.starts.size))
        direction /= np.linalg.norm(direction, axis=1, keepdims=True)
        away = self.radius * self.rng.random((len(owner), 1)) ** (1 / direction.shape[1])
        samples = self.q[owner] + (away * direction).reshape(-1, *self.problem.starts.shape)
        reached = self.is_free_motion(self.q[owner], samples)
        np.add.at(self.num_drawn, owner, 1)
        np.add.at(self.num_rejected, owner[~reached], 1)
        return self.insert(samples[reached], owner[reached])

    def insert(self, q: Float[np.ndarray, "n robots 2"], owner: Int[np.ndarray, " n"]) -> Int[np.ndarray, " n"]:
        """Add vertices. The parent of each is the one of least cost among its owner and the nearest old vertices."""
        new, end = np.arange(len(q)), self.size + len(q)
        rows = self.size + new
        self.q[rows] = q
        # 1. num_near = sum of exp(-2 distance**2 / radius**2) over the neighbors within the radius.
        flat = self.q[:end].reshape(end, -1)
        squared = cdist(flat[rows], flat, "sqeuclidean")
        squared[new, rows] = np.inf
        vertex, neighbor = np.nonzero(squared <= self.radius**2)
        weight = np.exp(-2 * squared[vertex, neighbor] / self.radius**2)
        is_old = neighbor < self.size
        np.add.at(self.num_near, rows[vertex], weight)
        np.add.at(self.num_near, neighbor[is_old], weight[is_old])
        # 2. Parents: the owner, or one of the nearest old vertices if the cost by it is less.
        self.parent[rows], self.cost[rows] = owner, self.cost[owner] + lengths(self.q[owner], q)
        nearest = np.argpartition(squared[:, : self.size], min(NUM_PARENTS, self.size) - 1, axis=1)
        for parent in nearest[:, :NUM_PARENTS].T:
            cost = self.cost[parent] + lengths(self.q[parent], q)
            better = np.flatnonzero((squared[new, parent] <= self.radius**2) & (cost < self.cost[rows]))
            better = better[self.is_free_motion(self.q[parent[better]], q[better])]
            self.parent[rows[better]], self.cost[rows[better]] = parent[better], cost[better]
        # 3. Where the heuristic is infinite, use the owner's estimate.
        estimate = self.heuristic(q)
        self.estimate[rows] = np.where(np.isfinite(estimate), np.maximum(estimate, 0.0), self.estimate[owner])
        self.size = end
        return rows


def lengths(begin: Float[np.ndarray, "n robots 2"], end: Float[np.ndarray, "*n robots 2"]) -> Float[np.ndarray, " n"]:
    """Return the costs of straight motions of the team."""
    return np.linalg.norm(end - begin, axis=2).sum(axis=1)


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    names, num_seeds, most = (NAMES[:1], 2, _FEW_VERTICES) if smoke else (NAMES, NUM_SEEDS, MAX_VERTICES)
    plr_bytes, rows = SMOKE_BYTES if smoke else PLR_BYTES, []
    for name, kind in tqdm(list(itertools.product(names, HEURISTICS)), delay=3, disable=None):
        problem = SCENES[name]()
        heuristic, bound = build(problem, kind, plr_bytes), exact_lower_bound(problem)
        Search(problem, heuristic, seed, _FEW_VERTICES).run()  # compiles
        runs = [measure(problem, heuristic, seed + i, most, bound) for i in range(num_seeds)]
        row = {"scene": name, "heuristic": kind, **columns(runs)}
        blind = next((each for each in rows if each["scene"] == name), row)  # a scene's first row: no heuristic
        rows.append({**row, "p_value": float(mannwhitneyu(row["vertices"], blind["vertices"]).pvalue)})
    return {"max_vertices": most, "plr_bytes": plr_bytes, "seeds": num_seeds, "rows": rows}


def measure(problem: Problem, heuristic: HeuristicFn, seed: int, most: int, bound: float) -> dict[str, Any]:
    began = time.perf_counter()
    search = Search(problem, heuristic, seed, most)
    path = search.run()
    return {
        "seconds": round(time.perf_counter() - began, 3),
        "vertices": search.size,
        "valid": None if path is None else validate(problem, path).valid,
        "cost_over_bound": None if path is None else round(path_cost(problem, path) / bound, 5),
    }


if __name__ == "__main__":
    run("sba_star", "SBA* under each heuristic: vertices, seconds and cost of its first path.", compute)
