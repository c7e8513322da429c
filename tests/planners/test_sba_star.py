import numpy as np
import pytest
from planner_helpers import ROOM, exact

from plr_jax import (
    DiscRobot,
    Problem,
    RectangleRobot,
    Status,
    path_cost,
    sba_star_plan,
    scenes,
    straight_line,
    validate,
    zero,
)
from plr_jax.planners._sba_star import _Neighborhoods, _SBAStarSearch

ALONE = Problem(ROOM, [DiscRobot(0.4)], [(1, 1)], [(9, 9)])
MIXED = Problem(ROOM, [DiscRobot(0.4), RectangleRobot(2, 1)], [(1, 1, 5), (1, 8, 0)], [(9, 5, 5), (8, 8, 3)])


def grown(problem, num_steps, heuristic=None, seed=0):
    """A search after some expansions."""
    search = _SBAStarSearch(problem, heuristic or straight_line(problem), seed, 10_000)
    for _ in range(num_steps):
        search.expand()
    return search


def distances_between(search):
    points = (search.q[: search.size] * search.unit).reshape(search.size, -1)
    return np.linalg.norm(points[:, None] - points, axis=2)


# Paths


@pytest.mark.parametrize(
    ("problem", "heuristic"),
    [(scenes.single_door(), exact), (scenes.cross(2), straight_line)],
    ids=["single_door", "cross"],
)
def test_scenes_of_the_paper(problem, heuristic):
    solution = sba_star_plan(problem, heuristic(problem), seed=1)
    report = validate(problem, solution.path)
    assert report.valid, report.message
    assert solution.status == Status.SOLVED
    assert solution.cost == pytest.approx(report.cost) and solution.cost >= solution.lower_bound
    assert solution.stats.history[-1][1] == pytest.approx(solution.cost)


def test_the_seed_decides():
    problem = scenes.single_door()
    first, again, other = (sba_star_plan(problem, straight_line(problem), seed=seed) for seed in (3, 3, 4))
    assert np.array_equal(first.path, again.path) and np.array_equal(first.samples, again.samples)
    assert not np.array_equal(first.path, other.path)


# The tree


@pytest.mark.parametrize("problem", [scenes.four_rooms(2), MIXED], ids=["discs", "mixed"])
def test_costs_are_those_of_free_paths_through_the_tree(problem):
    search = grown(problem, 30)
    leaves = np.setdiff1d(np.arange(search.size), search.parent)
    assert len(leaves) > 10
    for leaf in leaves[::10]:
        path = search.path_to(int(leaf))
        assert np.array_equal(path[0], problem.starts) and np.array_equal(path[-1], search.q[leaf])
        assert path_cost(problem, path) == pytest.approx(search.cost[leaf])
        assert validate(problem, path).clearance >= -1e-6


def test_no_neighbor_among_the_nearest_would_have_been_a_better_parent_in_the_open():
    search = grown(ALONE, 20)
    distance = distances_between(search)
    for row in range(1, search.size):
        expanded = search.parent[row]
        older = np.flatnonzero(distance[row, :row] <= search.radius)
        nearest = older[np.argsort(distance[row, older])][:5]
        # Vertices of one batch do not know one another: leave out those that came with it.
        nearest = nearest[nearest < row - 32]
        assert (search.cost[row] <= search.cost[nearest] + distance[row, nearest] + 1e-9).all()
        assert distance[row, expanded] <= search.radius + 1e-12


def test_the_crowd_of_a_vertex_is_a_sum_over_all_its_neighbors():
    search = grown(scenes.four_rooms(2), 60)
    stats = search.stats()
    assert search.num_drawn.sum() == stats.num_children_scored == 8 * stats.num_expansions
    assert search.num_drawn.sum() - search.num_rejected.sum() == stats.num_children_valid == stats.num_nodes - 1
    distance = distances_between(search)
    weight = np.where(distance <= search.radius, np.exp(-2 * (distance / search.radius) ** 2), 0)
    assert search.size > 300
    assert np.allclose(search.crowd[: search.size], weight.sum(axis=1) - 1, rtol=0, atol=1e-9)


def test_keys_prefer_the_near_the_empty_and_the_open():
    search = _SBAStarSearch(ALONE, zero(), 0, 100)
    search.insert(np.linspace(2, 8, 8)[:, None, None] * np.ones((8, 1, 2)), np.zeros(8, int), np.zeros(8))
    search.cost[:9], search.to_go[:9], search.crowd[:9] = 1, 1, 1
    search.cost[0], search.to_go[1], search.crowd[2] = 5, 5, 3
    search.num_drawn[3:5], search.num_rejected[3] = 8, 8
    search.crowd[8] = 0.5
    assert set(search.least_keys()) <= {4, 5, 6, 7, 8} and 8 in search.least_keys()
    search.crowd[5:8] = 2
    search.to_go[2], search.crowd[2] = 0, 1
    assert {2, 4, 8} <= set(search.least_keys())


def test_offsets_fill_the_ball_of_what_moves():
    search = _SBAStarSearch(MIXED, zero(), 0, 10)
    offsets = search.offsets(20_000)
    assert (offsets[:, 0, 2] == 0).all()
    away = np.linalg.norm(offsets * search.unit, axis=(1, 2)) / search.radius
    assert away.max() <= 1 + 1e-12
    assert np.mean(away**5) == pytest.approx(0.5, abs=0.01)  # five coordinates move
    assert np.abs(offsets.mean(axis=0)).max() < 0.05


def test_neighborhoods_find_what_brute_force_finds():
    rng = np.random.default_rng(0)
    points = rng.random((1_500, 3))
    near = _Neighborhoods(len(points), 3, 0.15)
    begin = 0
    while begin < len(points):
        end = min(len(points), begin + int(rng.integers(1, 40)))
        found = near.insert(points[begin:end])
        distance = np.linalg.norm(points[begin:end, None] - points[:end], axis=2)
        distance[np.arange(end - begin), np.arange(begin, end)] = np.inf
        i, j = np.nonzero(distance <= 0.15)
        order = np.lexsort((found.row, found.point))
        assert np.array_equal(found.point[order], i) and np.array_equal(found.row[order], j)
        assert np.allclose(found.distance[order], distance[i, j], rtol=1e-12)
        nearest = found.nearest(3)
        for k in np.unique(nearest.point):
            expected = np.argsort(distance[k])[:3]
            expected = expected[distance[k, expected] <= 0.15]
            assert np.array_equal(nearest.row[nearest.point == k], expected)
        begin = end


# Heuristics and limits


def test_no_estimate_is_no_wall():
    solution = sba_star_plan(ALONE, lambda q: np.full(len(q), np.inf), seed=0)
    assert solution.solved and validate(ALONE, solution.path).valid


def test_limits():
    problem = scenes.four_rooms(4)
    full = sba_star_plan(problem, straight_line(problem), max_nodes=50)
    assert full.status == Status.MEMORY_LIMIT and 50 <= full.stats.num_nodes < 50 + 32
    assert full.path is None and full.cost == np.inf and len(full.samples) == full.stats.num_nodes
    late = sba_star_plan(problem, straight_line(problem), time_limit=1e-9)
    assert late.status == Status.TIME_LIMIT and late.stats.num_expansions == 0


@pytest.mark.parametrize(
    ("heuristic", "limit", "message"),
    [
        *((answer, {}, "A heuristic must") for answer in (
            lambda q: np.full(len(q), np.nan), lambda q: 0.0, lambda q: np.zeros((len(q), 1)))),
        (zero(), {"time_limit": 0.0}, "time_limit must be positive"),
        (zero(), {"time_limit": float("nan")}, "time_limit must be positive"),
        (zero(), {"max_nodes": 0}, "max_nodes must be an integer >= 1"),
    ],
)  # fmt: skip
def test_other_arguments_are_refused(heuristic, limit, message):
    with pytest.raises(ValueError, match=message):
        sba_star_plan(ALONE, heuristic, **limit)


def test_an_interrupt_leaves_what_there_is():
    calls = []

    def interrupted(q):
        calls.append(len(q))
        if len(calls) == 3:
            raise KeyboardInterrupt
        return np.zeros(len(q))

    solution = sba_star_plan(ALONE, interrupted)
    assert solution.status == Status.INTERRUPTED and solution.path is None
    assert 1 < solution.stats.num_nodes == len(solution.samples) <= 1 + calls[1]


def test_a_plain_function_sees_few_batch_sizes():
    sizes = set()

    def counting(q):
        sizes.add(len(q))
        return np.zeros(len(q))

    assert sba_star_plan(scenes.single_door(), counting, max_nodes=300).stats.num_nodes > 100
    assert sizes <= {1, 2, 4, 8, 16, 32}
