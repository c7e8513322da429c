"""What proofs are held against: brute-force distances and A*; and maps of which nothing can be proven."""

import numpy as np
import pytest

from experiments.baselines._brute_distance import MAZE, BruteDistance
from experiments.proving import _astar
from plr_jax import VisibilityGraph, Workspace, construct, scenes

pytestmark = pytest.mark.full


def test_brute_force_agrees_with_the_oracle():
    problem = scenes.maze()
    workspace, goal = problem.workspace, problem.goals[0]
    brute, oracle = BruteDistance(MAZE, goal), VisibilityGraph(workspace, goal)
    x = workspace.sample_free(2_000, 3)
    np.testing.assert_allclose(brute(x), oracle(x), rtol=0, atol=1e-9)
    grid = workspace.bounds.grid(97).reshape(-1, 2)
    assert (np.isinf(brute(grid)) == np.isinf(oracle(grid))).all()


def test_a_star_crosses_an_open_grid_as_by_hand():
    rng = np.random.default_rng(3)
    grid = _astar.random_grid(Workspace(((0, 0), (1, 1))), rng)
    a, b = 0, len(grid.points) - 1
    step = np.abs(np.diff(grid.points, axis=0)).max(axis=0)
    count = np.rint(np.abs(grid.points[b] - grid.points[a]) / step.min())
    expected = step.min() * (np.sqrt(2) * count.min() + np.ptp(count))
    cost, expanded, nodes = _astar.a_star(grid, a, b, [0.0] * len(grid.points))
    assert cost == pytest.approx(expected) and nodes <= expanded <= len(grid.points)


@pytest.mark.parametrize(
    ("bounds", "obstacles", "goal", "message"),
    [
        (
            ((25621.20448833581, 16249.040618084948), (26621.20448833581, 16549.04061808495)),
            [
                [
                    (25746.20448833581, 16511.540618084946),
                    (25746.41801413055, 16384.010589615387),
                    (25746.41801512221, 16384.01058961705),
                ],
                [
                    (25746.21120528183, 16507.528885731157),
                    (25669.129247229936, 16464.089320283372),
                    (26621.20448833581, 16436.540618084946),
                ],
            ],
            (25674.12932443736, 16508.751242945484),
            "all but touch",
        ),
        (
            ((-55037950.56443232, 51192343.53759958), (-55037950.46443233, 51192343.53859958)),
            [],
            (-55037950.559271306, 51192343.53810345),
            "an origin that is near",
        ),
    ],
)
def test_nearly_degenerate_maps_of_which_nothing_can_be_proven_are_refused(bounds, obstacles, goal, message):
    workspace = Workspace(bounds, obstacles)
    with pytest.raises(ValueError, match=message):
        construct(VisibilityGraph(workspace, goal), workspace.bounds, max_leaves=16, certified=True)
