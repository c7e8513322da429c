"""What is done to a path that a search has found."""

import numpy as np
import pytest

from plr_jax.planners.driver import until_arrival


@pytest.mark.parametrize(
    ("rows", "kept"),
    [
        ([(0, 1), (2, 3)], 2),
        ([(0, 1), (2, 3), (2, 3), (2, 3)], 2),
        ([(0, 1), (2, 3), (2, 1), (2, 3), (2, 3)], 4),  # the team is at its goals once before
        ([(2, 3), (2, 3)], 1),
        ([(2, 3)], 1),
    ],
)
def test_a_path_ends_when_all_have_arrived_for_good(rows, kept):
    state = np.array(rows)
    np.testing.assert_array_equal(until_arrival(state), state[:kept])
