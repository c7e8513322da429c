"""Solutions for the tests of what one can do with them: drawn by hand, and found at random."""

import numpy as np
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace
from plr_jax.planners import Stats, Status
from plr_jax.planners._solution import solution_of

ROOM = Workspace(((0, 0), (10, 10)))
PROBLEM = Problem(
    ROOM,
    [DiscRobot(0.5), RectangleRobot(2, 1)],
    [(1, 1, 7), (5, 5, 3.0)],
    [(4, 5, 7), (5, 8, -3.0)],
    rotation_weight=2.0,
)
TURN = 2 * np.pi - 6  # from heading 3 to -3 by the shorter way
PATH = np.array(
    [[(1, 1, 7), (5, 5, 3.0)], [(1, 5, 7), (5, 5, -3.0)], [(1, 5, 7), (5, 5, -3.0)], [(4, 5, 7), (5, 8, -3.0)]]
)
SOLUTION = solution_of(
    PROBLEM, PATH, 8.5, Status.SOLVED, Stats(9, 8, 7, 6, {"a": 0.1}, ((0.25, 99.5), (0.5, 1 / 3))), PATH, 1.25
)
NONE = solution_of(PROBLEM, None, 8.0, Status.EXHAUSTED, Stats(1), PROBLEM.starts[None])
COUNTS = ("num_nodes", "num_expansions", "num_children_scored", "num_children_valid", "num_bytes")
finite = st.floats(-1e6, 1e6)
amounts = st.floats(0, 1e300)


@st.composite
def findings(draw):
    """What a planner may have found: a random path, in which rows may repeat, or none; and what it says of it."""
    steps = draw(st.integers(1, 7))
    path = draw(arrays.arrays(np.float64, (steps, 2, 3), elements=finite))
    path = np.repeat(path, draw(st.lists(st.integers(1, 3), min_size=steps, max_size=steps)), axis=0)
    bounds = draw(st.tuples(*[amounts | st.just(float("inf"))] * 2))
    stats = {
        "history": tuple(draw(st.lists(st.tuples(amounts, amounts), max_size=3))),
        "seconds": draw(st.dictionaries(st.text(max_size=5), amounts, max_size=3)),
        **dict(zip(COUNTS, draw(st.tuples(*[st.integers(0, 2**60)] * len(COUNTS))), strict=True)),
    }
    return draw(st.sampled_from([path, None])), draw(st.sampled_from(Status)), bounds, stats


def found_by_a_planner(path, status, bounds, stats):
    return solution_of(PROBLEM, path, bounds[0], status, Stats(**stats), PROBLEM.starts[None], bounds[1])
