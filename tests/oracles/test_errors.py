"""Messages for invalid arguments of oracles."""

import numpy as np
import pytest
from grid_helpers import drawn
from oracle_helpers import CUT, UNIT, WALL
from piece_helpers import box

from plr_jax import Dubins, Euclidean, NearestGoal, ReedsShepp, Roadmap, VisibilityGraph
from plr_jax.oracles import GridField, GridGraph, VoxelGraph

AROUND = VisibilityGraph(WALL, (8, 4))
DOOR, CUBE = drawn("..#..", ".....", "..#.."), np.ones((3, 3, 3), bool)
WIDE, ROWS = ((0, 0), (3, 2)), np.array([[0.0, 1, 2], [10, 11, 12]])


def roadmap(**changes):
    good = {"domain": UNIT, "is_free": CUT.is_free, "goal": (0.1, 0.1), "num_samples": 10}
    return Roadmap(**good | {"is_visible": CUT.is_visible} | changes)


@pytest.mark.parametrize(
    ("ask", "message"),
    [
        (lambda: Euclidean((0, np.nan)), "finite coordinates"),
        (lambda: Euclidean(3.0), r"shape \(dim,\)"),
        (lambda: Euclidean((0, 0))(np.zeros((2, 3))), r"shape \(n, 2\), got \(2, 3\)"),
        (lambda: Euclidean((0, 0))(np.zeros(2)), r"x\[None\]"),
        (lambda: Dubins((0, 0), 1), r"goal pose must be one point of shape \(3,\)"),
        (lambda: ReedsShepp((0, 0, np.inf), 1), "goal pose must have finite"),
        (lambda: Dubins((0, 0, 0), 0), "radius must be a positive finite number, got 0"),
        (lambda: ReedsShepp((0, 0, 0), "wide"), "radius must be a positive finite number, got 'wide'"),
        (lambda: Dubins((0, 0, 0), 1)(np.zeros((2, 2))), r"x must have shape \(n, 3\), got \(2, 2\)"),
        (lambda: ReedsShepp((0, 0, 0), 1)(np.ma.masked_less([[0.0, 1.0, 2.0]], 1)), "some are masked"),
        (lambda: Dubins((0, 0, 0), 1).shortest_path((0, np.nan, 0)), "start pose must have finite"),
        (lambda: ReedsShepp((0, 0, 0), 1).shortest_path((3e200, 4e200, 1)), "nearer to the goal"),
        (lambda: AROUND.with_goal((5, 4)), r"goal \[5.0, 4.0\] lies in an obstacle \(clearance -1\)"),
        (lambda: AROUND.with_workspace(WALL.with_obstacles([box(7, 3, 9, 5)])), "lies in an obstacle"),
        (lambda: VisibilityGraph(WALL, (11, 4)), "outside the bounds"),
        (lambda: VisibilityGraph(WALL, (1, np.nan)), "finite"),
        (lambda: VisibilityGraph(WALL, (1, 2, 3)), r"goal must be one point of shape \(2,\), got shape \(3,\)"),
        (lambda: VisibilityGraph(WALL, [(1, 1), (2, 2), (3, 3)]), r"one point .* shape \(3, 2\).*NearestGoal"),
        (lambda: AROUND.directions(np.zeros(2)), r"x must have shape \(n, 2\)"),
        (lambda: AROUND.between(np.zeros((2, 2)), np.zeros((3, 2))), "equally many points, got 2 and 3"),
        (lambda: AROUND.between(np.zeros((1, 2)), np.zeros((1, 3))), r"y must .*\(n, 2\)"),
        (lambda: AROUND.shortest_path(np.zeros((1, 2))), r"The start must be one point of shape \(2,\)"),
        (lambda: NearestGoal([]), "NearestGoal needs a list of distance functions"),
        (lambda: NearestGoal(AROUND), "NearestGoal needs a list of distance functions"),
        (lambda: NearestGoal([AROUND, lambda x: x[:, 0]]), "NearestGoal needs a list of distance functions"),
        (lambda: roadmap(goal=(0.5, 0.5)), "not free; move it"),
        (lambda: roadmap(goal=(1.5, 0.5)), "outside the domain.*move it inside"),
        (lambda: roadmap(goal=(np.nan, 0.5)), "finite coordinates"),
        (lambda: roadmap(domain=3.0), "The domain must be a Box"),
        (lambda: roadmap(num_samples=0), "num_samples"),
        (lambda: roadmap(is_visible=None), "Give is_visible"),
        (lambda: roadmap(is_visible=None, resolution=0.0), "resolution must be a positive finite number"),
        (lambda: roadmap(is_visible=lambda a, b: np.ones((len(a), 1), bool)), "is_visible must give one boolean"),
        (lambda: roadmap(is_visible=lambda a, b: np.ma.masked_equal(a[:, 0] < 2, True)), "is_visible .* some masked"),
        (lambda: roadmap(is_free=lambda x: np.all(x < 1e-3, axis=1), goal=(0, 0)), "shrink the domain"),
        (lambda: roadmap(is_free=lambda x: np.ones(len(x))), "is_free must give one boolean"),
        (lambda: roadmap(weights=(1.0, 0.0)), r"weights must be positive, one per axis, got \[1.0, 0.0\]"),
        (lambda: roadmap(weights=(1.0,)), r"weights must be one point of shape \(2,\)"),
        (lambda: GridGraph(DOOR.astype(int)), "booleans of shape .*got int64 of shape"),
        (lambda: GridGraph(DOOR[:0]), "at least one"),
        (lambda: GridGraph(DOOR, connectivity=6), "connectivity must be 4 or 8, got 6"),
        (lambda: GridGraph(DOOR, squeeze=True), "squeeze=True needs connectivity=8"),
        (lambda: GridGraph(DOOR, (2, 0)), "The goal must be a point in a free cell"),
        (lambda: GridGraph(DOOR)(np.zeros((1, 2))), "must have a goal: use"),
        (lambda: GridGraph(DOOR, (0, 0))(np.zeros((1, 3))), r"x must have shape \(n, 2\)"),
        (lambda: GridGraph(DOOR).between(np.zeros((1, 2)), np.zeros((2, 2))), "equally many points, got 1 and 2"),
        (lambda: VoxelGraph(CUBE.astype(int), (0, 0, 0)), "booleans of 3 axes.*got int64"),
        (lambda: VoxelGraph(CUBE[:0], (0, 0, 0)), "at least one free"),
        (lambda: VoxelGraph(CUBE, (0, 0, 0), 8), "moves must be 6, 18 or 26, got 8"),
        (lambda: VoxelGraph(CUBE, (0, 0, 4)), "The goal must be a point in a free cell"),
        (lambda: VoxelGraph(CUBE, (0, 0, 0), bounds=((0, 0), (1, 1))), "bounds must have 3 axes"),
        (lambda: VoxelGraph(CUBE, (0, 0, 0))(np.zeros((1, 2))), r"x must have shape \(n, 3\)"),
        (lambda: GridField(ROWS - 1, WIDE), r"at least 0, got -1 at \(0, 0\); mask"),
        (lambda: GridField(np.where(ROWS > 1, ROWS, -np.inf), WIDE), "at least 0, got -inf"),
        (lambda: GridField(ROWS[0], WIDE), r"grid of 2 axes.*got shape \(3,\)"),
        (lambda: GridField(np.zeros((0, 3)), WIDE), "at least one cell, got shape"),
        (lambda: GridField(ROWS * 1j, WIDE), "values must be distances on a grid of 2 axes"),
        (lambda: GridField(ROWS, WIDE)(np.zeros((2, 3))), r"x must have shape \(n, 2\)"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_invalid_arguments_raise(ask, message):
    with pytest.raises(ValueError, match=message):
        ask()
