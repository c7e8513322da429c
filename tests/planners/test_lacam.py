"""Lazy search (LaCAM): its moves, collisions, steps and limits, and what an empty stack proves."""

from itertools import combinations, product

import numpy as np
import pytest
from planner_helpers import hallway, reachable, search_budget
from team_helpers import TEAMS, search_of, team_of

from plr_jax import scenes
from plr_jax.collision.motions import motions_apart
from plr_jax.planners import Status, lacam
from plr_jax.planners.lacam import PIBT, Moves


def test_exhausted_search_has_all_reachable_states():
    search = search_of(hallway(5), 1.0)
    assert search.run(10**6) is Status.EXHAUSTED and search.goal_node is None
    assert set(map(tuple, search.node_states.tolist())) == reachable(search.joint)


def test_paused_search_equals_whole_search():
    whole, paused = search_of(scenes.door(20), 0.4), search_of(scenes.door(20), 0.4)
    assert whole.run(10_000) is Status.SOLVED
    for patience in (2, 3, 5):
        assert paused.run(patience) is None and paused.num_idle == patience
    assert paused.run(10_000) is Status.SOLVED
    np.testing.assert_array_equal(whole.solution_states, paused.solution_states)


LIMITS = [
    ({"max_expansions": 7}, Status.EXPANSION_LIMIT),
    ({"max_memory": 1e4}, Status.MEMORY_LIMIT),
    ({"seconds": -1.0}, Status.TIME_LIMIT),
    ({}, None),
]


@pytest.mark.parametrize(("limit", "status"), LIMITS)
def test_search_stops_at_limit(limit, status):
    search = search_of(scenes.door(20), 0.4, search_budget(**limit))
    assert search.run(10) is status and search.budget.memory == search.memory_use.num_bytes > 0


def wandered(joint, seed, steps=4):
    """Return a state that each robot reaches alone from its start."""
    rng, state = np.random.default_rng(seed), []
    for lattice in joint.lattices:
        node = lattice.start
        for _ in range(steps):
            node = int(rng.choice(lattice.child[node][np.isfinite(lattice.cost[node])]))
        state.append(node)
    return np.array(state)


@pytest.mark.parametrize("name", TEAMS)
def test_moves_rank_free_primitives_of_each_robot(name):
    joint, moves_of = team_of(*TEAMS[name])
    state = wandered(joint, seed=0)
    moves = moves_of(state)
    for i, (lattice, costs) in enumerate(zip(joint.lattices, joint.costs_to_go, strict=True)):
        assert moves.child[i] == lattice.child[state[i]].tolist()
        free = np.flatnonzero(np.isfinite(lattice.cost[state[i]]))
        assert sorted(moves.ranked[i]) == free.tolist() and 0 in free
        assert (np.diff(costs[lattice.child[state[i]]][moves.ranked[i]]) >= 0).all()


@pytest.mark.parametrize("few_pairs", [0, 64], ids=["by cells", "each by itself"])
@pytest.mark.parametrize("name", ["crowd", "mixed"])  # rooms keep robots apart
def test_collisions_of_moves_equal_pair_tests(name, few_pairs, monkeypatch):
    monkeypatch.setattr(lacam, "_FEW_PAIRS", few_pairs)
    joint, moves_of = team_of(*TEAMS[name])
    robots, tolerance = joint.problem.robots, joint.problem.workspace.tolerance
    num_colliding = 0
    for seed in range(3):
        state = wandered(joint, seed, 12)
        moves = moves_of(state)
        for i, j in combinations(range(len(robots)), 2):
            a, b = joint.lattices[i], joint.lattices[j]
            p, q = (index.ravel() for index in np.indices((a.cost.shape[1], b.cost.shape[1])))
            apart = motions_apart(
                robots[i], a.q[[state[i]] * p.size], a.q[a.child[state[i], p]],
                robots[j], b.q[[state[j]] * q.size], b.q[b.child[state[j], q]], tolerance,
            )  # fmt: skip
            collide = ~apart.reshape(a.cost.shape[1], b.cost.shape[1])
            for robot, other, expected in ((i, j, collide), (j, i, collide.T)):
                (said,) = [bits for k, bits in moves.neighbors[robot] if k == other] or [[0] * len(expected)]
                # Collisions of motions that are not free are not needed.
                for p in moves.ranked[robot]:
                    colliding = [q for q in moves.ranked[other] if said[p] >> q & 1]
                    assert sorted(colliding) == [q for q in np.flatnonzero(expected[p]) if q in moves.ranked[other]]
            num_colliding += collide.sum()
    assert num_colliding > 0 and any(moves_of._between_cells) == (few_pairs == 0 and name == "crowd")


def test_moves_in_portions_and_past_deadline(monkeypatch):
    joint, moves = team_of(*TEAMS["mixed"])
    state = np.array([lattice.start for lattice in joint.lattices])
    state[2] = state[0]  # equal discs that meet
    whole = moves(state)
    monkeypatch.setattr(lacam, "_MOST", 1)
    assert moves(state) == whole and any(whole.neighbors)
    moves.deadline = -1.0
    with pytest.raises(TimeoutError):
        moves(state)


def random_moves(rng, num_robots=4, num_primitives=4):
    """Return random moves and their collisions, in which robots that stay do not collide."""
    collide = {}
    for i in range(num_robots):
        for j in range(i):
            table = rng.random((num_primitives, num_primitives)) < 0.45
            table[0, 0] = False
            collide[i, j], collide[j, i] = table, table.T
    as_bits = {pair: [sum(1 << q for q in np.flatnonzero(row).tolist()) for row in collide[pair]] for pair in collide}
    neighbors = [[(j, as_bits[i, j]) for j in range(num_robots) if j != i] for i in range(num_robots)]
    ranked = [rng.permutation(num_primitives).tolist() for _ in range(num_robots)]
    return Moves([list(range(num_primitives))] * num_robots, ranked, neighbors), collide


def collides(collide, step):
    return any(table[step[i], step[j]] for (i, j), table in collide.items())


@pytest.mark.parametrize("seed", range(20))
def test_free_step_exists_without_constraints(seed):
    rng = np.random.default_rng(seed)
    moves, collide = random_moves(rng)
    order = rng.permutation(4).tolist()
    step = PIBT(moves).find(order, ())
    assert step is not None and not collides(collide, step)
    # The first robot has its best primitive for which the others can make way.
    best = next(
        p
        for p in moves.ranked[order[0]]
        if any(rest[order[0]] == p and not collides(collide, rest) for rest in product(range(4), repeat=4))
    )
    assert step[order[0]] == best


@pytest.mark.parametrize("seed", range(20))
def test_steps_keep_constraints(seed):
    rng = np.random.default_rng(100 + seed)
    moves, collide = random_moves(rng)
    order = rng.permutation(4).tolist()
    constraints = [(robot, int(rng.integers(4))) for robot in order[: 1 + seed % 4]]
    step = PIBT(moves).find(order, constraints)
    if step is not None:
        assert all(step[robot] == primitive for robot, primitive in constraints)
        assert not collides(collide, step)
    if len(constraints) == 4:
        whole = [dict(constraints)[i] for i in range(4)]
        assert (step is not None) == (not collides(collide, whole))


def test_step_is_found_within_few_choices():
    # In this clique, each motion asks all other robots to make way, but no robot can.
    num = 30
    bits = [0] + [0b1] * 8
    back = [0b111111110] + [0] * 8
    neighbors = [[(j, bits if i < j else back) for j in range(num) if j != i] for i in range(num)]
    moves = Moves([list(range(9))] * num, [[*range(1, 9), 0]] * num, neighbors)
    step = PIBT(moves)
    assert step.find(range(num), ()) is not None and step.num_left > -100 * num
