import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest

from plr_jax import Euclidean, VisibilityGraph, Workspace, construct, metrics, scenes

ROOM = Workspace(((0, 0), (8, 8)))
GOAL = np.array([1.0, 3.0])


def towards_goal(x):
    offset = GOAL - x
    length = np.linalg.norm(offset, axis=1, keepdims=True)
    return np.divide(offset, length, out=np.zeros_like(offset), where=length > 0)


def distance(x):
    return jnp.sqrt(((x - GOAL) ** 2).sum(axis=-1))


def to_the_right(x):
    return np.tile([1.0, 0.0], (len(x), 1))


@dataclasses.dataclass(frozen=True)
class Leaves:
    """A plane a leaf, of leaves side by side along the first axis."""

    edges: tuple[float, ...]
    slope: tuple[tuple[float, float], ...]
    height: tuple[float, ...]

    domain = ROOM.bounds

    @property
    def leaf_boxes(self):
        return tuple(
            np.stack([self.edges[k : k - 1 or None], np.full(len(self.slope), 8.0 * k)], axis=1) for k in (0, 1)
        )

    def __call__(self, x):
        leaf = jnp.searchsorted(jnp.array(self.edges[1:-1]), x[..., 0], side="right")
        return jnp.array(self.height)[leaf] + (jnp.array(self.slope)[leaf] * x).sum(axis=-1)


def report(approximation, directions=towards_goal, workspace=ROOM, goal=GOAL, x=None, **options):
    x = ROOM.sample_free(500, 0) if x is None else x
    return metrics.gradient_report(approximation, directions, workspace, goal, x, **options)


# --- angles ----------------------------------------------------------------------------------------------


def test_the_exact_gradient_has_no_angle():
    result = report(distance)
    assert result.max_angle < 0.01 and result.num_points == 500
    assert result.num_undirected == result.num_not_finite == result.num_zero == 0
    assert result.jumps is None and result.walks is None and result.share_reached is None


def test_known_angles_their_quantiles_and_where_the_largest_is():
    """The exact direction is turned against the gradient, which points to the right, row by row or everywhere."""

    def of_turned(degrees):
        turned = np.stack([np.cos(np.radians(degrees)), np.sin(np.radians(degrees))], axis=1)
        x = np.stack([np.arange(1, 101) / 20, np.ones(100)], axis=1)
        return report(lambda x: -x[..., 0], lambda x: turned, x=x)

    for degrees in (-179, -90, -1e-3, 0, 1e-4, 2, 45, 179.99):
        result = of_turned(np.full(100, degrees))
        np.testing.assert_allclose([*result.angles.values(), result.max_angle], abs(degrees), atol=1e-4)
    result, each = of_turned(np.arange(1, 101)), np.arange(1, 101)
    assert result.angles == {q: pytest.approx(np.quantile(each, q), abs=1e-4) for q in (0.5, 0.9, 0.99)}
    assert result.max_angle == pytest.approx(100, abs=1e-4) and result.max_at == (5.0, 1.0)


def test_what_has_no_direction_or_no_gradient_is_counted():
    x = np.array([[1.0, 3.0], [2, 3], [5, 5], [6, 6], [7, 7]])

    def directions(x):
        return np.where((x == 5).all(axis=1, keepdims=True), np.nan, towards_goal(x))

    def field(x):
        # Without slope at (6, 6), not finite at (7, 7).
        return jnp.where(x[..., 0] > 6.5, jnp.inf, jnp.where(x[..., 0] > 5.5, 3.0, x[..., 0]))

    result = report(field, directions, x=x)
    assert (result.num_undirected, result.num_not_finite, result.num_zero) == (2, 1, 1)
    assert result.max_angle == 0.0 and result.max_at == (2.0, 3.0)
    assert "over 3 points" in str(result)


def test_a_zero_gradient_is_excused_in_the_leaf_of_the_goal_alone():
    leaves = Leaves((0, 2, 4, 8), ((0, 0), (0, 0), (1, 0)), (0, 0, 0))
    x = np.array([[1.0, 1.0], [3, 1], [3, 2], [7, 1]])
    assert report(leaves, x=x).num_zero == 2


def test_share_reached_counts_points_with_a_direction():
    x = np.array([[1.0, 3.0], [2, 3], [3, 3], [4, 3], [5, 3]])
    result = report(distance, x=x, reaches=lambda x: x[:, 0] < 4.5)
    assert result.share_reached == 0.75 and "reaches the goal from 75.00%" in str(result)


# --- leaves ----------------------------------------------------------------------------------------------


def test_known_jumps():
    """At x = 2 the planes meet; at x = 4 they jump by 0.5 and more the higher, up to 1.3, or not."""
    jumping = Leaves((0, 2, 4, 8), ((1, 0), (3, 0), (3, 0.1)), (0, -4, -4 + 0.5))
    jumps = report(jumping, to_the_right).jumps
    assert jumps.num_points == 2 * 8
    assert jumps.quantiles[0.5] < 1.3 and 0.5 <= jumps.max <= 1.3 and jumps.max_at[0] == 4
    assert jumps.max == pytest.approx(0.5 + 0.1 * jumps.max_at[1], abs=1e-5)
    continuous = dataclasses.replace(jumping, slope=((1, 0), (3, 0), (-2, 0)), height=(0, -4, 16))
    assert report(continuous, to_the_right).jumps.max < 1e-5


def test_faces_within_walls_do_not_count():
    wall = Workspace(((0, 0), (8, 8)), [[(3.9, -1), (4.1, -1), (4.1, 9), (3.9, 9)]])
    leaves = Leaves((0, 4, 8), ((1, 0), (1, 0)), (0, 100))
    result = report(leaves, workspace=wall)
    assert result.jumps == metrics.JumpReport(0.0, {0.5: 0.0, 0.9: 0.0, 0.99: 0.0}, None, 0)


def test_walks_that_go_somewhere_stall_or_hit_a_wall_where_there_is_a_way():
    """From left to right: to the goal, to the left, into each other by two, up into the ceiling."""
    leaves = Leaves((0, 2, 3, 4, 5, 8), ((0, 0.1), (1, 0), (-1, 0), (1, 0), (0, -1)), (0, 0, 0, 0, 0))
    walks = report(leaves, goal=np.array([1.0, 3.5])).walks
    assert (walks.num_leaves, walks.num_into_wall, walks.num_stalled) == (5, 1, 2)
    only_left = report(leaves, lambda x: np.where(x[:, :1] < 3.2, towards_goal(x), np.nan), goal=np.array([1.0, 3.5]))
    assert only_left.walks.num_leaves == 2


# --- PLRs ------------------------------------------------------------------------------------------------


def test_a_plr_of_the_maze_points_the_way():
    """Twin of the jumps: the planes' own values on both sides of the point of a face."""
    problem = scenes.maze()
    workspace, exact = problem.workspace, VisibilityGraph(problem.workspace, problem.goals[0])
    plr = construct(exact, workspace.bounds, max_bytes=6144)
    first, again = (
        report(plr, exact.directions, workspace, exact.goal, workspace.sample_free(5_000, 1)) for _ in "12"
    )
    assert first == again and first.angles[0.5] < 2.5
    assert first.num_not_finite == first.num_zero == first.num_undirected == 0
    jumps, walks = first.jumps, first.walks
    assert 0 < jumps.quantiles[0.5] < 1e-3 and jumps.max < 0.01
    assert walks.num_stalled <= 0.01 * walks.num_leaves
    assert f"max {jumps.max:.3g}" in str(first) and f"{walks.num_leaves:,} leaves" in str(first)
    assert json.loads(json.dumps(dataclasses.asdict(first)))["max_at"] == list(first.max_at)
    lo, hi = plr.leaf_boxes
    beside = np.flatnonzero(((lo <= jumps.max_at) & (jumps.max_at <= hi)).all(axis=1))
    values = plr.slope[beside] @ np.array(jumps.max_at) + plr.intercept[beside]
    assert np.ptp(values) == pytest.approx(jumps.max, rel=1e-3)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        *(
            (dict(approximation=approximation), "JAX cannot differentiate")
            for approximation in (
                lambda x: np.hypot(x[:, 0], x[:, 1]),
                Euclidean(GOAL),
                lambda x: np.ma.masked_greater(np.ones(len(x)), 0),
            )
        ),
        (dict(approximation=lambda x: x), r"must give shape \(500,\), got \(500, 2\)"),
        (dict(directions=lambda x: x[:, 0]), "exact directions must have shape"),
        (dict(directions=lambda x: np.full_like(x, np.nan)), "none has both"),
        (dict(directions=lambda x: np.ma.masked_greater(x, 0)), "directions .* are masked"),
        (dict(goal=(1, 2, 3)), "The goal must be one point"),
        *(
            (dict(reaches=reaches), f"reaches must return one boolean a point, .* {message}")
            for reaches, message in (
                (lambda x: np.full(len(x), np.nan), "got float64"),
                (lambda x: np.ones(1, bool), r"of shape \(1,\)"),
                (lambda x: np.ma.masked_array(np.ones(len(x), bool), x[:, 0] > 0), "some masked"),
            )
        ),
        (dict(x=np.zeros((3, 3))), "x must have shape"),
        (dict(x=np.empty((0, 2))), "Of 0 points none"),
    ],
)
def test_mistakes_are_explained(arguments, message):
    with pytest.raises(ValueError, match=message):
        report(**{"approximation": distance} | arguments)
