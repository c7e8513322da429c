"""Steps of a team, drawn by hand and against all combinations of primitives."""

from itertools import product

import numpy as np
import pytest

from plr_jax.planners.lacam import PIBT, Moves


def random_moves(rng, num_robots=4, num_primitives=4):
    """Collisions by chance, but for staying beside one another."""
    collide = {}
    for i in range(num_robots):
        for j in range(i):
            table = rng.random((num_primitives, num_primitives)) < 0.45
            table[0, 0] = False
            collide[i, j], collide[j, i] = table, table.T
    neighbors = [
        [
            (j, [sum(1 << q for q in np.flatnonzero(row).tolist()) for row in collide[i, j]])
            for j in range(num_robots)
            if j != i
        ]
        for i in range(num_robots)
    ]
    ranked = [rng.permutation(num_primitives).tolist() for _ in range(num_robots)]
    return Moves([list(range(num_primitives))] * num_robots, ranked, neighbors), collide


def collides(collide, step):
    return any(table[step[i], step[j]] for (i, j), table in collide.items())


@pytest.mark.parametrize("seed", range(40))
def test_without_constraints_there_is_a_step_that_collides_with_nothing(seed):
    rng = np.random.default_rng(seed)
    moves, collide = random_moves(rng)
    order = rng.permutation(4).tolist()
    step = PIBT(moves).find(order, ())
    assert step is not None and not collides(collide, step)
    # The first in order has its best primitive for which the others could make way at all.
    best = next(
        p
        for p in moves.ranked[order[0]]
        if any(rest[order[0]] == p and not collides(collide, rest) for rest in product(range(4), repeat=4))
    )
    assert step[order[0]] == best


@pytest.mark.parametrize("seed", range(40))
def test_constraints_are_kept(seed):
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


def test_who_stands_in_the_way_makes_way():
    # Robot 0 wants where 1 stands; 1 may go where 2 stands; 2 may go on.
    none, way = [0, 0], [0, 0b01]  # going collides with the other's staying
    moves = Moves([[0, 1]] * 3, [[1, 0], [0, 1], [0, 1]], [[(1, way)], [(0, [0b10, 0]), (2, way)], [(1, [0b10, 0])]])
    assert PIBT(moves).find([0, 1, 2], ()) == [1, 1, 1]
    blocked = moves._replace(ranked=[[1, 0], [0, 1], [0]])
    assert PIBT(blocked).find([0, 1, 2], ()) == [0, 0, 0]
    assert PIBT(moves._replace(neighbors=[[(1, none)], [], []])).find([0, 1, 2], ()) == [1, 0, 0]


def test_a_step_is_found_however_many_choices_it_would_take():
    # A clique in which every motion of one robot asks all others to make way, which none of them can.
    num = 30
    bits = [0] + [0b1] * 8
    back = [0b111111110] + [0] * 8
    neighbors = [[(j, bits if i < j else back) for j in range(num) if j != i] for i in range(num)]
    moves = Moves([list(range(9))] * num, [[*range(1, 9), 0]] * num, neighbors)
    step = PIBT(moves)
    assert step.find(range(num), ()) is not None and step.num_left > -100 * num
