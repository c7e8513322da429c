"""One library of exact distances on one map: a task comes in as JSON, what it took and found goes out as JSON.

Run by the Python of an environment of their own, which needs neither this project nor JAX::

    pip install "extremitypathfinder[numba]==2.7.2" pyvisgraph==0.2.1 tqdm

Both libraries answer one query a call. What can be prepared, is: a query of extremitypathfinder does not test whether
its ends are free. Only the goal is not put into pyvisgraph's graph beforehand: its answers are then too long, as the
straight way to the goal is missed.
"""

import json
import pickle
import statistics
import sys
import time
from importlib.metadata import version


def main():
    task = json.load(sys.stdin)
    prepare = {"extremitypathfinder": extremitypathfinder, "pyvisgraph": pyvisgraph}[task["rival"]]
    square = [[0.0, 0.0], [8.0, 0.0], [8.0, 8.0], [0.0, 8.0]]
    wall = [[3.0, 1.0], [3.0, 6.0], [5.0, 6.0], [5.0, 1.0]]
    _, distance = prepare({"outer": square, "holes": [wall], "obstacles": [wall], "goal": [1.0, 4.0]})
    distance([7.0, 4.0])  # whatever is compiled, is so now
    start = time.perf_counter()
    environment, distance = prepare(task)
    seconds = time.perf_counter() - start
    times, distances = [], []
    for x in task["queries"]:
        start = time.perf_counter()
        distances.append(distance(x))
        times.append(time.perf_counter() - start)
        if sum(times) > task["query_limit"]:
            break
    num_bytes = len(pickle.dumps(environment))
    report = {"prepare": seconds, "query": statistics.median(times), "bytes_pickled": num_bytes}
    json.dump({**report, "version": version(task["rival"]), "distances": distances}, sys.stdout)


def extremitypathfinder(task):
    from extremitypathfinder import PolygonEnvironment  # pyright: ignore[reportMissingImports]

    environment = PolygonEnvironment()
    environment.store(task["outer"], task["holes"])
    goal = tuple(task["goal"])
    return environment, lambda x: environment.find_shortest_path(tuple(x), goal, verify=False)[1]


def pyvisgraph(task):
    from math import dist, inf

    from pyvisgraph import Point, VisGraph  # pyright: ignore[reportMissingImports]

    graph, goal = VisGraph(), Point(*task["goal"])
    graph.build([[Point(*vertex) for vertex in ring] for ring in task["obstacles"]], status=False)

    def distance(x):
        path = [(point.x, point.y) for point in graph.shortest_path(Point(*x), goal)]
        return sum(map(dist, path, path[1:])) if path else inf

    return (graph.graph, graph.visgraph), distance


if __name__ == "__main__":
    main()
