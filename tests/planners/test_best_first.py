"""Best-first search: its children, the order of its nodes, its limits, and what an empty frontier proves."""

import heapq
from itertools import product

import numpy as np
import pytest
from planner_helpers import DOOR, ROOMS, TIGHT_TEAM, TRIO, apart, hallway, joint_lattice_of, reachable, search_budget

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace, bl_plan, scenes, validate
from plr_jax.planners import BLOptions, Status, best_first, straight_line, zero
from plr_jax.planners.best_first import BestFirstSearch, best_successors, tabulate

CELL = Problem(Workspace(((0, 0), (3, 2))), [DiscRobot(0.4)] * 2, [(0.5, 0.5), (2.5, 1.5)], [(2.5, 1.5), (0.5, 0.5)])
ENDS = [(0.5, 0.5), (1.5, 0.5), (2.5, 1.5)]
THREE = Problem(CELL.workspace, [DiscRobot(0.4)] * 3, ENDS, ENDS[::-1])
PAIR = Problem(
    Workspace(((0, 0), (2, 2))),
    [DiscRobot(0.3), RectangleRobot(0.8, 0.3)],
    [(0.5, 0.5, 1), (1.5, 1.5, 0)],
    [(1.5, 1.5, 1), (0.5, 0.5, 0)],
)
DIAGONAL = [(0.5, 0.5), (2.5, 2.5)]
DISCS = Problem(TIGHT_TEAM.workspace, [DiscRobot(0.4), DiscRobot(0.3)], DIAGONAL, DIAGONAL[::-1])


class Separable:
    """A heuristic with given terms."""

    def __init__(self, terms):
        self.per_robot = terms

    def __call__(self, q):
        return self.per_robot(q).sum(axis=1)


def search_of(problem, step, heuristic=None, weight=1.0, limits=None):
    joint = joint_lattice_of(problem, step)
    terms = tabulate(joint, heuristic or straight_line(problem))
    return BestFirstSearch(joint, terms, weight, limits or search_budget())


def run_on(search):
    """Search until the search ends; return its status."""
    status, turn = None, 256
    while status is None:
        status = search.run(turn)
        turn *= 2
    return status


# Children


def free_states(joint, num, seed):
    """Return random joint configurations in which no two robots overlap; some are close together."""
    rng = np.random.default_rng(seed)
    found = []
    while len(found) < num:
        state = np.array([[rng.integers(len(lattice.q)) for lattice in joint.lattices]])
        if apart(joint, state, np.zeros((1, len(joint.lattices)), np.uint8)).all():
            found.append(state[0])
    return np.array(found, dtype=np.int32)


def all_children(joint, terms, state):
    """Return all joint primitives of a state that are free, with their scores."""
    primitive = np.array(list(product(*(range(term.shape[1]) for term in terms))), dtype=np.uint8)
    score = sum(term[state[i], primitive[:, i]].astype(float) for i, term in enumerate(terms))
    valid = np.isfinite(score)
    valid[valid] = apart(joint, np.repeat(state[None], valid.sum(), axis=0), primitive[valid])
    return {tuple(p): s for p, s in zip(primitive[valid].tolist(), score[valid].tolist(), strict=True)}


CHILDREN = [(TIGHT_TEAM, 1.0, 10_000), (DISCS, 0.5, 100), (TIGHT_TEAM, 1.0, 1), (TIGHT_TEAM, 1.0, 100)]


@pytest.mark.parametrize(("problem", "step", "width"), CHILDREN)
def test_children_are_the_best_free_primitives(problem, step, width):
    search = search_of(problem, step, weight=2.0)
    joint, terms, state = search.joint, search.scores, free_states(search.joint, 8, seed=3)
    sizes = np.cumprod([term.shape[1] for term in terms])
    children = best_successors(joint, terms, state, width)
    assert children.step_score.shape[1] == min(width, sizes[-1])
    num_valid = 0
    for row in range(len(state)):
        known = np.isfinite(children.step_score[row])
        keys = [tuple(p) for p in children.primitive[row, known].tolist()]
        expected, found = all_children(joint, terms, state[row]), children.step_score[row, known]
        assert len(set(keys)) == len(keys) and set(keys) <= set(expected)
        np.testing.assert_allclose(found, [expected[key] for key in keys], rtol=1e-5)
        assert (np.diff(found) >= 0).all(), "best first"
        assert not children.is_complete[row] or set(keys) == set(expected)
        if width >= 100 and expected:
            assert found[0] == pytest.approx(min(expected.values()), rel=1e-5)
        num_valid += len(keys)
    if width > sizes[-1]:
        assert children.is_complete.all() and children.num_valid == num_valid
        assert children.num_scored == len(state) * sizes.sum()
        assert 0 < num_valid < 0.9 * len(state) * sizes[-1], "some children collide"
    assert children.is_complete.all() == (width >= sizes[-1])


def test_children_of_one_robot_are_its_best_motions():
    search = search_of(DOOR, 0.8, weight=2.0)
    terms, state = search.scores, np.arange(len(search.joint.lattices[0].q), dtype=np.int32)[:, None]
    for width in (1, 4, 8, 9):
        children = best_successors(search.joint, terms, state, width)
        np.testing.assert_array_equal(children.step_score, np.sort(terms[0], axis=1)[:, :width])
        np.testing.assert_array_equal(children.is_complete, np.isfinite(terms[0]).sum(axis=1) <= width)
        assert children.num_scored == terms[0].size
        assert children.num_valid == np.isfinite(terms[0]).sum(), "counted before the cut"


# Heuristics


@pytest.mark.parametrize("chunk", [300, 1 << 15])
def test_scores_add_costs_and_weighted_terms(chunk, monkeypatch):
    monkeypatch.setattr(best_first, "_CHUNK", chunk)
    joint, heuristic = joint_lattice_of(TRIO, 1.5), straight_line(TRIO)
    tables = tabulate(joint, heuristic)
    search = BestFirstSearch(joint, tables, 3.0, search_budget())
    assert search.least_estimate == pytest.approx(3 * heuristic(TRIO.starts[None])[0], rel=1e-12)
    for i, (lattice, table, score) in enumerate(zip(joint.lattices, tables, search.scores, strict=True)):
        q = np.repeat(TRIO.starts[None], len(lattice.q), axis=0)
        q[:, i, : lattice.q.shape[1]] = lattice.q
        np.testing.assert_array_equal(table, heuristic.per_robot(q)[:, i])
        np.testing.assert_allclose(score, lattice.cost + 3 * table[lattice.child], rtol=1e-6)


@pytest.mark.parametrize("large", [np.inf, 1e300])  # float32 holds at most 3e38
def test_infinite_estimates_prune_nothing(large):
    heuristic = Separable(lambda q: np.where(q[..., 1] > 5, large, q[..., 0]))
    assert validate(DOOR, bl_plan(DOOR, heuristic, BLOptions(step=0.5)).path).valid


@pytest.mark.usefixtures("unchecked_types")
def test_invalid_estimates_raise():
    for terms, message in (
        (lambda q: np.full(q.shape[:2], np.nan), "must not return NaN"),
        (lambda q: np.zeros(len(q)), r"must return an array of shape \(\d+, 1\)"),
        (lambda q: "near", "The result of a heuristic must be numbers"),
    ):
        with pytest.raises(ValueError, match=message):
            bl_plan(DOOR, Separable(terms), BLOptions(step=0.5))


def test_negative_estimates_count_as_zero_and_masked_as_infinite():
    joint = joint_lattice_of(DOOR, 0.5)
    (table,) = tabulate(joint, Separable(lambda q: np.ma.masked_greater(q[..., 0] - 4, 3)))
    x = joint.lattices[0].q[:, 0] - 4
    np.testing.assert_array_equal(table, np.where(x > 3, np.inf, np.maximum(x, 0)))


# Nodes


def nodes_of_reference_search(lattice, term, first):
    """Return nodes and costs of best-first search with partial expansion, for one robot and one child at a time."""
    states, costs, claimed, found = [lattice.start], [0.0], {lattice.start}, lattice.start == lattice.goal
    frontier, pushed, left = [(first, 0, 0)], 0, {}
    while frontier and not found:
        node = heapq.heappop(frontier)[2]
        state = states[node]
        if node not in left:
            order = np.argsort(term[state], kind="stable")
            left[node] = [int(p) for p in order if np.isfinite(term[state, p])]
        unclaimed = [p for p in left[node] if lattice.child[state, p] not in claimed]
        if unclaimed:
            best, child = unclaimed[0], int(lattice.child[state, unclaimed[0]])
            states.append(child)
            costs.append(costs[node] + lattice.cost[state, best])
            claimed.add(child)
            pushed += 1
            heapq.heappush(frontier, (costs[node] + term[state, best], -pushed, len(states) - 1))
            found = child == lattice.goal
        left[node] = [p for p in unclaimed[1:] if lattice.child[state, p] not in claimed]
        if left[node]:
            pushed += 1
            heapq.heappush(frontier, (costs[node] + term[state, left[node][0]], -pushed, node))
    return states, costs


WEIGHTED = [(DOOR, 0.4, 0.0), (DOOR, 0.4, 1.0), (scenes.maze(), 0.04, 2.0)]


@pytest.mark.parametrize(("problem", "step", "weight"), WEIGHTED)
def test_nodes_equal_reference_search(problem, step, weight, monkeypatch):
    monkeypatch.setattr(best_first, "_BATCH", 1)
    search = search_of(problem, step, weight=weight)
    first = float(search.least_estimate)
    assert run_on(search) is Status.SOLVED
    states, costs = nodes_of_reference_search(search.joint.lattices[0], search.scores[0], first)
    assert search.node_states[:, 0].tolist() == states
    np.testing.assert_allclose(search.costs, costs, rtol=1e-12)


EXHAUSTED = [(hallway(4), 1024, 1), (hallway(4), 1, 1), (CELL, 1, 16), (PAIR, 3, 8)]


@pytest.mark.parametrize(("problem", "width", "batch"), EXHAUSTED)
def test_exhausted_search_has_all_reachable_states(problem, width, batch, monkeypatch):
    monkeypatch.setattr(best_first, "_WIDTH", width)
    monkeypatch.setattr(best_first, "_BATCH", batch)
    search = search_of(problem, 1.0)
    search.goal = np.full(len(problem.robots), -1)  # nowhere
    expected = reachable(search.joint)
    assert run_on(search) is Status.EXHAUSTED and search.is_complete
    states = list(map(tuple, search.node_states.tolist()))
    assert len(states) == len(set(states)) == search.budget.num_nodes and set(states) == expected
    assert not search.successors and search.budget.num_children_valid >= len(states) - 1
    # Only the bytes of nodes are still counted.
    of_nodes = search.budget.memory - search.num_bytes_needed(search.joint) - search.max_product_bytes
    assert of_nodes % max(1, len(states) - 1) == 0 and of_nodes >= 100 * (len(states) - 1)


def test_cut_search_is_incomplete(monkeypatch):
    """With one child per node, the search misses reachable states, and the only way of a team."""
    monkeypatch.setattr(best_first, "_WIDTH", 1)
    monkeypatch.setattr(best_first, "_MAX_WIDTH", 1)
    search = search_of(THREE, 1.0)
    search.goal = np.full(3, -1)  # nowhere
    assert run_on(search) is Status.EXHAUSTED and not search.is_complete
    states = set(map(tuple, search.node_states.tolist()))
    assert states < reachable(search.joint)
    cut = bl_plan(THREE, zero(), BLOptions(("bl",), step=1.0, time_limit=20))
    assert cut.status is Status.MEMORY_LIMIT and cut.path is None


# Limits and pauses


LIMITS = [
    ({"max_expansions": 40}, Status.EXPANSION_LIMIT, (41, 2000)),
    ({"max_memory": 1e6}, Status.MEMORY_LIMIT, (2, 2000)),
    ({"seconds": 0.0}, Status.TIME_LIMIT, (1, 1)),
]


@pytest.mark.parametrize(("limit", "status", "num_states"), LIMITS)
def test_search_stops_at_limit(limit, status, num_states):
    search = search_of(ROOMS, 0.4, zero(), 0.0)
    search.budget = search.memory_use.budget = search_budget(**limit)
    search.memory_use.add(search.memory_use.num_bytes)
    assert search.run(10_000) is status and search.goal_node is None
    assert num_states[0] <= len(search.states) <= num_states[1]
    assert search.budget.num_expansions == 40 or status is not Status.EXPANSION_LIMIT
    assert search.budget.memory >= 1e6 or status is not Status.MEMORY_LIMIT


def test_search_past_deadline_raises():
    with pytest.raises(TimeoutError):
        search_of(ROOMS, 0.5, limits=search_budget(seconds=-1.0))
    with pytest.raises(TimeoutError):
        tabulate(joint_lattice_of(ROOMS, 0.5), zero(), -1.0)


def test_paused_search_in_portions_equals_whole_search(monkeypatch):
    whole = search_of(ROOMS, 0.6)
    assert run_on(whole) is Status.SOLVED
    monkeypatch.setattr(best_first, "_PRODUCTS", 1)
    paused = search_of(ROOMS, 0.6)
    pauses, turn = 0, 5
    while (status := paused.run(turn)) is None:
        assert paused.budget.num_expansions >= turn
        turn, pauses = turn + 5, pauses + 1
    assert status is Status.SOLVED and pauses > 2
    np.testing.assert_array_equal(paused.node_states, whole.node_states)
    np.testing.assert_array_equal(paused.solution_states, whole.solution_states)
