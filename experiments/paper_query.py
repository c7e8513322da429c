"""Query time, the paper's main claim: PLRs beside search in the roadmap that they summarise, on the maze.

A roadmap joins a point to the nearest vertex that it sees, or to all visible vertices within the PRM* radius. Then A*
of NetworkX, guided by the straight line, or Dijkstra's algorithm of SciPy finds the way. SciPy's search starts at the
goal, which takes about as long as a search from the point. A *tree* stores one such search, so that a query only
looks up a vertex and tests walls. Pairs that see each other are answered by the straight line. The visibility graph
is exact.
"""

import math
import tempfile
import time
import tracemalloc
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import jax
import networkx
import numpy as np
from jaxtyping import Float, Int

from experiments._c_headers import compiled_header, object_for_size, section_bytes
from experiments._nearest_vertex import NearestVertex
from experiments._runner import run
from experiments.table1 import POINT_SEED
from plr_jax import PLR, Roadmap, VisibilityGraph, construct, construct_pairs, scenes
from plr_jax.geometry.graph import dijkstra
from plr_jax.plr import NumpyPLR

PROBLEM = scenes.maze()
WORKSPACE, GOAL = PROBLEM.workspace, PROBLEM.goals[0]
NUM_VERTICES = 1_000, 10_000, 100_000
SUMMARISED = 10_000  # vertices of the roadmap that the planes summarise, as in the paper
PLANES_BYTES = 2_048
CONES_BYTES = 1_024
PAIRS_BYTES = 4_096
BATCHES = 1, 1_000, 1_000_000
MOST_IN_A_TABLE = 1_000  # vertices whose distances from one another are stored
NUM_POINTS = 100_000
# A contender is timed until its calls of one batch took _ENOUGH_SECONDS, or until there are _MOST_CALLS of them.
_LEAST_CALLS = 20  # of one query
_MOST_CALLS = 200
_ENOUGH_SECONDS = 0.5
NUM_SEARCHED = 50  # pairs whose errors are measured by searches
GOAL_VERTEX = 0  # of a Roadmap

Points = Float[np.ndarray, "n columns"]
Answer = Callable[[Points], Any]


class Contender(NamedTuple):
    """A way to answer queries.

    Attributes:
        method: The stored distance.
        query: The program that answers.
        num_bytes: Memory that queries need. For C: code and tables.
        answer: Function from float64 points ``(n, 2)`` or pairs of points ``(n, 4)`` to distances ``(n,)``.
        batches: Numbers of queries in a call.
        vectorized: Function with the same answers for many points at once, if ``answer`` takes only one point.
        num_points: Most points or pairs whose errors are measured.
    """

    method: str
    query: str
    num_bytes: int
    answer: Answer
    batches: tuple[int, ...] = BATCHES
    vectorized: Answer | None = None
    num_points: int = NUM_POINTS


def summaries(num_vertices: int, seed: int, folder: Path) -> Iterator[Contender]:
    """Yield PLRs of a roadmap and of the exact distance, each as three contenders."""
    roadmap, exact = Roadmap.from_workspace(WORKSPACE, GOAL, num_vertices, seed=seed), prepared_graph()
    planes = construct(roadmap, WORKSPACE.bounds, max_bytes=PLANES_BYTES, seed=seed)
    cones = construct(exact, WORKSPACE.bounds, leaf="cone", max_bytes=CONES_BYTES, seed=seed)
    yield from plr_contenders(f"PLR of PRM*, {num_vertices:,} vertices: planes", planes, folder / "planes")
    yield from plr_contenders("PLR of the exact distance: cones", cones, folder / "cones")


def prepared_graph() -> VisibilityGraph:
    """Return the visibility graph after one pair query and one goal query, so that its tables exist."""
    exact = VisibilityGraph(WORKSPACE, GOAL)
    exact.between(GOAL[None], PROBLEM.starts[:1])
    exact(PROBLEM.starts[:1])
    return exact


def on_rows(pairs: Callable[[Points, Points], Any]) -> Answer:
    """Wrap ``pairs(a, b)`` so that it takes rows ``(ax, ay, bx, by)``."""
    return lambda x: pairs(x[:, :2], x[:, 2:])


def plr_contenders(method: str, plr: PLR, folder: Path) -> Iterator[Contender]:
    """Yield a PLR in C, NumPy and JAX. C has no batch of one: calling it from Python would dominate the time."""
    sizes = section_bytes(object_for_size(plr, folder))
    yield Contender(method, "C", sum(sizes.values()), compiled_header(plr, folder), BATCHES[1:])
    numpy_bytes, function = measure_memory(partial(NumpyPLR, plr.to_bytes()))
    yield Contender(method, "NumPy", numpy_bytes, function)
    yield Contender(method, "JAX", plr.resident_bytes, jax.jit(plr))


# A point, vertices of a roadmap that edges join to it, and the lengths of these edges.
Joined = tuple[Float[np.ndarray, "2"], Int[np.ndarray, " edges"], Float[np.ndarray, " edges"]]
Join = Callable[[NearestVertex, Float[np.ndarray, "1 2"]], Joined]


class AStar:
    """A* in a roadmap. Each search adds its two ends as vertices, and removes them once it has found a path."""

    def __init__(self, roadmap: Roadmap):
        self.graph = roadmap.graph.to_networkx()
        self.places: dict[Any, list[float]] = dict(enumerate(roadmap.graph.vertices.tolist()))

    def __call__(self, start: Joined, end: Joined) -> float:
        for name, (place, vertices, lengths) in {"start": start, "end": end}.items():
            self.places[name] = place.tolist()
            edges = zip(vertices.tolist(), lengths.tolist(), strict=True)
            self.graph.add_weighted_edges_from((name, vertex, length) for vertex, length in edges)
        length = networkx.astar_path_length(self.graph, "start", "end", self._straight)
        self.graph.remove_nodes_from(["start", "end"])
        return length

    def _straight(self, a: Any, b: Any) -> float:
        return math.dist(self.places[a], self.places[b])


def join_nearest(nearest: NearestVertex, x: Float[np.ndarray, "1 2"]) -> Joined:
    return x[0], *nearest.connect(x)


def join_visible(nearest: NearestVertex, x: Float[np.ndarray, "1 2"]) -> Joined:
    """Join a point to all vertices that it sees within the radius, which doubles until there are some."""
    roadmap, radius, seen = nearest.roadmap, nearest.roadmap.radius, np.empty(0, int)
    while not len(seen):
        near = np.array(nearest.tree.query_ball_point(x[0], radius), int)
        seen = near[roadmap.is_visible(np.repeat(x, len(near), axis=0), roadmap.graph.vertices[near])]
        radius *= 2
    return x[0], seen, np.linalg.norm(roadmap.graph.vertices[seen] - x[0], axis=1)


def roadmap_contenders(nearest: NearestVertex, a_star: AStar, graph_bytes: int) -> Iterator[Contender]:
    """Yield A*, Dijkstra and tree lookups, joined by the nearest or the best visible vertex."""
    roadmap = nearest.roadmap
    vertices, adjacency = roadmap.graph.vertices, roadmap.graph.adjacency
    csr_bytes = sum(part.nbytes for part in (vertices, adjacency.data, adjacency.indices, adjacency.indptr))
    goal = roadmap.goal, np.array([GOAL_VERTEX]), np.zeros(1)
    for label, join, lookup in (("nearest", join_nearest, nearest), ("best visible", join_visible, roadmap)):
        method = f"PRM*, {len(vertices) - 1:,} vertices, {label}"

        def by_a_star(x: Points, join: Join = join) -> Float[np.ndarray, "1"]:
            return np.array([a_star(join(nearest, x), goal)])

        def by_dijkstra(x: Points, join: Join = join) -> Float[np.ndarray, "1"]:
            _, joined, lengths = join(nearest, x)
            distances, _ = dijkstra(roadmap.graph.adjacency, GOAL_VERTEX)
            return np.array([(lengths + distances[joined]).min()])

        yield Contender(method, "A\\*, NetworkX", graph_bytes, by_a_star, (1,), lookup)
        yield Contender(method, "Dijkstra, SciPy", csr_bytes, by_dijkstra, (1,), lookup)
        yield Contender(method, "tree, SciPy", vertices.nbytes + roadmap.distances.nbytes, lookup)


def pair_contenders(nearest: NearestVertex, a_star: AStar, graph_bytes: int) -> Iterator[Contender]:
    """Yield A* for each pair, and a table of all pairs of vertices if they are few."""
    graph, sees = nearest.roadmap.graph, nearest.roadmap.is_visible
    method = f"PRM*, {len(graph.vertices) - 1:,} vertices, nearest"

    def search(a: Points, b: Points) -> float:
        if sees(a, b)[0]:
            return float(np.linalg.norm(a - b))
        return a_star(join_nearest(nearest, a), join_nearest(nearest, b))

    def by_a_star(x: Points) -> Float[np.ndarray, " n"]:
        return np.array([search(pair[None, :2], pair[None, 2:]) for pair in x])

    yield Contender(method, "A\\*, NetworkX", graph_bytes, by_a_star, (1,), num_points=NUM_SEARCHED)
    if len(graph.vertices) - 1 <= MOST_IN_A_TABLE:
        lengths, num = graph.adjacency, len(graph.vertices)
        table = np.stack([dijkstra(lengths, vertex)[0] for vertex in range(num)]).astype(np.float32)

        def by_table(x: Points) -> Float[np.ndarray, " n"]:
            a, b = x[:, :2], x[:, 2:]
            (first, to_first), (second, to_second) = nearest.connect(a), nearest.connect(b)
            through = to_first + table[first, second] + to_second
            return np.where(sees(a, b), np.linalg.norm(a - b, axis=1), through)

        yield Contender(method, "table, SciPy", graph.vertices.nbytes + table.nbytes, by_table)


def measure_memory(make: Callable[[], Any]) -> tuple[int, Any]:
    """Make an object. Return the bytes that Python and NumPy allocate for it and still hold, and the object."""
    tracemalloc.start()
    made = make()
    num_bytes = tracemalloc.get_traced_memory()[0]
    tracemalloc.stop()
    return num_bytes, made


def errors(contender: Contender, truth: Answer, x: Points) -> dict[str, float]:
    """Return a contender's mean and largest error at the first of the points or pairs ``x``."""
    x = x[: contender.num_points]
    error = np.abs(np.asarray((contender.vectorized or contender.answer)(x)) - truth(x))
    return {"mean": float(error.mean()), "max": float(error.max())}


def microseconds(answer: Answer, x: Points, batch: int) -> float:
    """Return the median microseconds per query, in calls of ``batch`` queries.

    The first call, which may compile, is not timed.
    """
    jax.block_until_ready(answer(x[:batch]))
    seconds: list[float] = []
    least = _LEAST_CALLS if batch == 1 else 1
    while len(seconds) < least or (len(seconds) < _MOST_CALLS and sum(seconds) < _ENOUGH_SECONDS):
        begin = batch * len(seconds) % len(x)
        some = x[begin : begin + batch]
        began = time.perf_counter()
        jax.block_until_ready(answer(some))
        seconds.append(time.perf_counter() - began)
    return 1e6 * float(np.median(seconds)) / batch


def row_of(contender: Contender, truth: Answer, x: Points, batches: tuple[int, ...]) -> dict[str, Any]:
    """Return a row of the results: bytes, errors, and microseconds per query for each batch."""
    times = {str(n): microseconds(contender.answer, x, n) for n in batches if n in contender.batches}
    row = {"method": contender.method, "query": contender.query, "bytes": contender.num_bytes}
    row |= {**errors(contender, truth, x), "microseconds": times}
    print(row, flush=True)
    return row


def compute(seed: int, smoke: bool) -> dict[str, Any]:
    num_vertices = (200,) if smoke else NUM_VERTICES
    summarised = 200 if smoke else SUMMARISED
    batches = (1, 1_000) if smoke else BATCHES
    x = WORKSPACE.sample_free(batches[-1], POINT_SEED)
    pairs = np.concatenate([x, WORKSPACE.sample_free(batches[-1], POINT_SEED + 1)], axis=1)
    exact_bytes, exact = measure_memory(prepared_graph)

    goal_row = partial(row_of, truth=exact, x=x, batches=batches)
    pair_row = partial(row_of, truth=on_rows(exact.between), x=pairs, batches=batches)
    all_pairs = construct_pairs(WORKSPACE, max_bytes=PAIRS_BYTES)
    pair_plr = [
        Contender("pairs", "NumPy", *measure_memory(lambda: on_rows(all_pairs.numpy()))),
        Contender("pairs", "JAX", all_pairs.resident_bytes, on_rows(all_pairs)),
        Contender("visibility graph", "NumPy", exact_bytes, on_rows(exact.between)),
    ]
    with tempfile.TemporaryDirectory() as folder:
        goal_rows = [goal_row(each) for each in summaries(summarised, seed, Path(folder))]
    goal_rows.append(goal_row(Contender("visibility graph", "NumPy", exact_bytes, exact)))
    pair_rows = list(map(pair_row, pair_plr))
    for number in num_vertices:
        nearest = NearestVertex(Roadmap.from_workspace(WORKSPACE, GOAL, number, seed=seed))
        graph_bytes, a_star = measure_memory(lambda nearest=nearest: AStar(nearest.roadmap))
        goal_rows += map(goal_row, roadmap_contenders(nearest, a_star, graph_bytes))
        pair_rows += map(pair_row, pair_contenders(nearest, a_star, graph_bytes))
    points = min(NUM_POINTS, len(x))
    return {"batches": batches, "points": points, "searched": NUM_SEARCHED, "goal": goal_rows, "pairs": pair_rows}


if __name__ == "__main__":
    run("paper_query", __doc__, compute)
