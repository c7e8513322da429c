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


def turned(degrees):
    """A function whose gradient is everywhere turned against the direction to the right."""
    c, s = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    return lambda x: -(c * x[..., 0] + s * x[..., 1])


def to_the_right(x):
    return np.tile([1.0, 0.0], (len(x), 1))


@dataclasses.dataclass(frozen=True)
class Leaves:
    """A plane a leaf, of leaves side by side along the first axis."""

    edges: tuple[float, ...]
    slope: tuple[tuple[float, float], ...]
    height: tuple[float, ...]

    @property
    def domain(self):
        return ROOM.bounds

    @property
    def leaf_boxes(self):
        edges = np.array(self.edges)
        lo = np.stack([edges[:-1], np.zeros(len(edges) - 1)], axis=1)
        return lo, np.stack([edges[1:], np.full(len(edges) - 1, 8.0)], axis=1)

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


@pytest.mark.parametrize("degrees", [-179, -90, -1e-3, 0, 1e-4, 2, 45, 179.99])
def test_known_angles(degrees):
    result = report(turned(degrees), to_the_right, x=ROOM.sample_free(20, 0))
    np.testing.assert_allclose([*result.angles.values(), result.max_angle], abs(degrees), atol=1e-4)


def test_quantiles_and_where_the_largest_is():
    x = np.stack([np.arange(1, 101) / 20, np.ones(100)], axis=1)
    # The gradient turns by as many degrees as the row's number.
    angles = np.radians(np.arange(1, 101))
    result = report(
        lambda x: -x[..., 0], lambda x: np.stack([np.cos(angles), np.sin(angles)], axis=1), goal=(7, 7), x=x
    )
    assert result.angles == {q: pytest.approx(np.quantile(np.arange(1, 101), q), abs=1e-4) for q in (0.5, 0.9, 0.99)}
    assert result.max_angle == pytest.approx(100, abs=1e-4) and result.max_at == (5.0, 1.0)


def test_what_has_no_direction_or_no_gradient_is_counted():
    x = np.array([[1.0, 3.0], [2, 3], [5, 5], [6, 6], [7, 7]])

    def directions(x):
        result = towards_goal(x)
        result[(x == 5).all(axis=1)] = np.nan
        return result

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
    """At x = 2 the planes meet; at x = 4 they jump by 0.5 and more the higher, up to 1.3."""
    leaves = Leaves((0, 2, 4, 8), ((1, 0), (3, 0), (3, 0.1)), (0, -4, -4 + 0.5))
    result = report(leaves, to_the_right)
    assert result.jumps.num_points == 2 * 8
    assert result.jumps.quantiles[0.5] < 1.3 and 0.5 <= result.jumps.max <= 1.3
    assert result.jumps.max_at[0] == 4
    assert result.jumps.max == pytest.approx(0.5 + 0.1 * result.jumps.max_at[1], abs=1e-5)
    continuous = Leaves((0, 2, 4, 8), ((1, 0), (3, 0), (-2, 0)), (0, -4, 16))
    assert report(continuous, to_the_right).jumps.max < 1e-5


def test_faces_within_walls_do_not_count():
    wall = Workspace(((0, 0), (8, 8)), [[(3.9, -1), (4.1, -1), (4.1, 9), (3.9, 9)]])
    leaves = Leaves((0, 4, 8), ((1, 0), (1, 0)), (0, 100))
    result = report(leaves, workspace=wall)
    assert result.jumps == metrics.JumpReport(0.0, {0.5: 0.0, 0.9: 0.0, 0.99: 0.0}, None, 0)


def test_walks_that_go_somewhere_stall_or_hit_a_wall():
    """From left to right: to the goal, to the left, into each other by two, up into the ceiling."""
    leaves = Leaves((0, 2, 3, 4, 5, 8), ((0, 0.1), (1, 0), (-1, 0), (1, 0), (0, -1)), (0, 0, 0, 0, 0))
    walks = report(leaves, goal=np.array([1.0, 3.5])).walks
    assert (walks.num_leaves, walks.num_into_wall, walks.num_stalled) == (5, 1, 2)


def test_leaves_without_a_way_are_not_walked_from():
    leaves = Leaves((0, 2, 4, 8), ((1, 0), (1, 0), (1, 0)), (0, 0, 0))

    def only_left(x):
        return np.where(x[:, :1] < 3.5, towards_goal(x), np.nan)

    assert report(leaves, only_left).walks.num_leaves == 2


# --- PLRs ------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def maze():
    problem = scenes.maze()
    exact = VisibilityGraph(problem.workspace, problem.goals[0])
    return problem.workspace, exact, construct(exact, problem.workspace.bounds, max_bytes=6144)


def test_a_plr_of_the_maze_points_the_way(maze):
    workspace, exact, plr = maze
    x = workspace.sample_free(5_000, 1)
    result = report(plr, exact.directions, workspace, exact.goal, x)
    assert result.angles[0.5] < 2.5
    assert result.num_not_finite == result.num_zero == result.num_undirected == 0
    assert 0 < result.jumps.quantiles[0.5] < 1e-3 and result.jumps.max < 0.01
    assert result.walks.num_stalled <= 0.01 * result.walks.num_leaves
    assert f"max {result.jumps.max:.3g}" in str(result) and f"{result.walks.num_leaves:,} leaves" in str(result)
    text = json.dumps(dataclasses.asdict(result))
    assert json.loads(text)["max_at"] == list(result.max_at)
    assert result == report(plr, exact.directions, workspace, exact.goal, x)


def test_jumps_are_those_of_the_planes(maze):
    """Twin: the planes' own values on both sides of each point of a face."""
    workspace, exact, plr = maze
    result = report(plr, exact.directions, workspace, exact.goal, workspace.sample_free(10, 1))
    at = np.array(result.jumps.max_at)
    lo, hi = plr.leaf_boxes
    beside = np.flatnonzero(((lo <= at) & (at <= hi)).all(axis=1))
    values = plr.slope[beside] @ at + plr.intercept[beside]
    assert np.ptp(values) == pytest.approx(result.jumps.max, rel=1e-3)


# --- a caller's mistakes ---------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (dict(approximation=lambda x: np.hypot(x[:, 0], x[:, 1])), "JAX cannot differentiate"),
        (dict(approximation=Euclidean(GOAL)), "JAX cannot differentiate"),
        (dict(approximation=lambda x: x), r"must give shape \(500,\), got \(500, 2\)"),
        (dict(approximation=distance, directions=lambda x: x[:, 0]), "exact directions must have shape"),
        (dict(approximation=distance, directions=lambda x: np.full_like(x, np.nan)), "none has both"),
        (dict(approximation=distance, goal=(1, 2, 3)), "The goal must be one point"),
        (
            dict(approximation=distance, reaches=lambda x: np.full(len(x), np.nan)),
            "one boolean a point, .* got float64",
        ),
        (
            dict(approximation=distance, reaches=lambda x: np.ones(1, bool)),
            r"one boolean a point, .* of shape \(1,\)",
        ),
        (
            dict(approximation=distance, reaches=lambda x: np.ma.masked_array(np.ones(len(x), bool), x[:, 0] > 0)),
            "reaches must return one boolean a point, .* some masked",
        ),
        (dict(approximation=distance, directions=lambda x: np.ma.masked_greater(x, 0)), "directions .* are masked"),
        (dict(approximation=lambda x: np.ma.masked_greater(np.ones(len(x)), 0)), "JAX cannot differentiate"),
        (dict(approximation=distance, x=np.zeros((3, 3))), "x must have shape"),
        (dict(approximation=distance, x=np.empty((0, 2))), "Of 0 points none"),
    ],
)
def test_mistakes_are_explained(arguments, message):
    with pytest.raises(ValueError, match=message):
        report(**arguments)
