"""Sources of many goals, numbered: alike ones have one number, for ever."""

import numpy as np

from plr_jax.oracles.cells.family_sources import SharedCones

POINTS = np.array([[0.0, 0], [1, 0], [1, 1], [0.5, 0.25]])  # two corners, then two goals


def test_numbers_are_as_a_dictionary_would_give_them():
    rng = np.random.default_rng(0)
    cones, known = SharedCones(POINTS, num_turns=4, step=0.125), {}
    for _ in range(5):
        kind, steps = rng.integers(0, 8, 40), rng.integers(0, 4, 40)
        found = cones.numbers(kind, 0.125 * (steps + rng.uniform(-0.4, 0.4, 40)))  # nearer than half a step is alike
        expected = [known.setdefault(each, len(known)) for each in zip(kind.tolist(), steps.tolist(), strict=True)]
        np.testing.assert_array_equal(found, expected)
    kinds, steps = np.array(list(known)).T
    np.testing.assert_array_equal(cones.kind, kinds)
    np.testing.assert_array_equal(cones.sources.points, POINTS[kinds // 2])
    np.testing.assert_array_equal(cones.sources.distances, 0.125 * steps)
    np.testing.assert_array_equal(cones.view, kinds // 2)
    np.testing.assert_array_equal(cones.turn, [kind if kind < 4 else -1 for kind in kinds])


def test_sources_are_those_of_the_last_numbers_given():
    cones = SharedCones(POINTS, num_turns=4, step=1.0)
    assert len(cones.sources.points) == len(cones.numbers(np.zeros(0, np.int64), np.zeros(0))) == 0
    cones.numbers(np.array([1]), np.array([2.0]))
    assert cones.sources.distances.tolist() == [2]
    cones.numbers(np.array([1, 3]), np.array([2.0, 5.0]))
    assert cones.sources.distances.tolist() == [2, 5]
