"""Straight-line distances; distances and paths of cars, compared with values by hand and with OMPL."""

import numpy as np
import pytest

from plr_jax import Dubins, Euclidean, ReedsShepp
from plr_jax._types import SymmetricFn


def test_distance_in_several_dimensions():
    np.testing.assert_allclose(Euclidean((0, 0))(np.array([[3, 4], [0, 0]])), [5, 0])
    np.testing.assert_allclose(Euclidean((1, 1, 1, 1))(np.array([[2.0, 2, 2, 2]])), [2])
    np.testing.assert_allclose(Euclidean([2.0])(np.array([[-1.5]])), [3.5])
    assert Euclidean((0, 0))(np.zeros((3, 2), dtype=np.float32)).dtype == np.float64


def test_points_that_are_not_finite_are_unreachable():
    x = np.array([[np.nan, 0.0], [0.0, np.inf], [np.inf, np.nan], [-np.inf, np.inf]])
    np.testing.assert_array_equal(Euclidean((0, 0))(x), [np.inf] * 4)


PI, RADIUS = np.pi, 1.7
GOAL = np.array([0.3, -0.8, 2.2])
LATTICE = np.stack(np.meshgrid(*[np.linspace(-4, 4, 9)] * 2, PI / 4 * np.arange(-3, 5)), axis=-1).reshape(-1, 3)
"""Poses at which many words begin, end or are equally long."""
both = pytest.mark.parametrize("car", [Dubins, ReedsShepp])


def random_poses(n, extent=8.0, seed=0):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-extent, extent, (n, 2)), rng.uniform(-PI, PI, n)])


def driven(pose, segments):
    """Return where a car ends after segments, each a letter and a signed length."""
    z, heading = complex(pose[0], pose[1]), pose[2]
    for letter, length in segments:
        turn = {"L": 1, "S": 0, "R": -1}[letter] * length / RADIUS
        # The chord of an arc is sin(turn / 2) / (turn / 2) of its length, and leaves at half the turn.
        z += length * np.sinc(turn / 2 / PI) * np.exp(1j * (heading + turn / 2))
        heading += turn
    return np.array([z.real, z.imag, heading])


def in_frame_of(goal, relative):
    """Return poses that are given relative to a goal."""
    turn = np.exp(1j * goal[2]) * (relative[:, 0] + 1j * relative[:, 1])
    return np.column_stack([goal[0] + turn.real, goal[1] + turn.imag, goal[2] + relative[:, 2]])


def ompl_distances(car, radius, starts, goal):
    """Return distances from starts to a goal in a state space of OMPL."""
    space = getattr(pytest.importorskip("ompl.base"), f"{car.__name__}StateSpace")(radius)

    def state_of(pose):
        state = space.allocState()
        state.setX(pose[0])
        state.setY(pose[1])
        state.setYaw(pose[2])
        return state

    return np.array([space.distance(state_of(start), state_of(goal)) for start in starts])


@pytest.mark.parametrize(
    ("pose", "forward", "both_ways"),
    [
        ((0, 0, 0), 0, 0),
        ((-5, 0, 0), 5, 5),
        ((9, 0, 0), 9 + 4 * PI, 9),  # half a circle, back, half a circle; in reverse
        ((0, 4, PI), 2 * PI, 2 * PI),  # half a circle to the left
        ((-2, 2, -PI / 2), PI, PI),
        ((-2, -2, PI / 2), PI, PI),
        ((2, 2, PI / 2), 3 * PI, PI),  # three quarters to the left; one in reverse
        ((-4, 4, 0), 2 * PI, 2 * PI),  # a quarter to the right, a quarter to the left
        ((0, 0, PI), 2 * PI * 7 / 3, 2 * PI),  # 60 degrees aside, 300, 60 back; three of 60 with cusps between them
        ((0, 1e-10, 0), None, 4e-5),  # four turns u, as R L forward and R L in reverse: 2 u**2 radii aside
    ],
)
def test_lengths_by_hand(pose, forward, both_ways):
    np.testing.assert_allclose(ReedsShepp((0, 0, 0), 2)([pose]), [both_ways], rtol=1e-9, atol=1e-12)
    if forward is not None:
        np.testing.assert_allclose(Dubins((0, 0, 0), 2)([pose]), [forward], rtol=1e-12, atol=1e-12)


@both
def test_lengths_equal_ompl(car):
    poses = np.concatenate([random_poses(1000, extent) for extent in (1, 4, 40)])
    expected = ompl_distances(car, RADIUS, poses, GOAL)
    np.testing.assert_allclose(car(GOAL, RADIUS)(poses), expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize(
    ("car", "goal", "tolerance"),
    [
        *((Dubins, goal, 1e-11) for goal in ((0, 0, 0), (100.1, -37.3, -1.1))),
        (ReedsShepp, (0, 0, 0), 1e-12),
        (ReedsShepp, GOAL, 1e-7),  # the rounding of poses shows: a path aside by as little as 1e-16 is 4e-8 long
    ],
)
def test_lengths_at_discontinuities_equal_ompl(car, goal, tolerance):
    found, expected = car(goal, 1)(in_frame_of(goal, LATTICE)), ompl_distances(car, 1.0, LATTICE, np.zeros(3))
    np.testing.assert_allclose(found, expected, rtol=tolerance, atol=tolerance)


@both
@pytest.mark.parametrize("extent", [0.01, 4, 40])
def test_paths_end_at_the_goal_and_have_the_distance(car, extent):
    oracle, poses = car(GOAL, RADIUS), random_poses(60, extent)
    for pose, length in zip(poses, oracle(poses), strict=True):
        path = oracle.shortest_path(pose)
        pieces = np.array([piece for _, piece in path])
        assert len(path) <= 5 and (np.abs(pieces) > 0).all()
        assert car is ReedsShepp or (len(path) <= 3 and (pieces > 0).all())
        assert np.abs(pieces).sum() == pytest.approx(length, rel=1e-12)
        error = driven(pose, path) - GOAL
        assert np.abs([*error[:2], np.angle(np.exp(1j * error[2]))]).max() < 1e-12 * (1 + extent)


def test_dubins_distance_jumps_where_one_turn_suffices():
    quarter = np.array([[-1.0, 1.0, -PI / 2]])
    for offset, turns in ((0, 0.25), (1e-12, 0.25), (-1e-12, 0.25), (1e-6, 1.25), (-1e-6, 0.25)):
        pose = in_frame_of(GOAL, quarter + np.array([offset, 0, 0]))
        np.testing.assert_allclose(Dubins(GOAL, 1)(pose), [turns * 2 * PI], atol=1e-5)
    turned, hardly = (Dubins(GOAL, 1)([GOAL + np.array([0, 0, angle])])[0] for angle in (1e-6, 1e-12))
    assert turned > 6 and hardly < 1e-11


@both
def test_headings_are_periodic_and_every_pose_is_reachable(car):
    oracle, poses = car(GOAL, RADIUS), random_poses(500)
    for turns in (-1, 3):
        np.testing.assert_allclose(oracle(poses + np.array([0, 0, 2 * PI * turns])), oracle(poses), atol=1e-7)
    assert oracle.shortest_path(oracle.goal) == []
    assert car((1, 2, 0.5), 3)([(1, 2, 0.5 + 2 * PI)]) < 1e-15 and 0 <= oracle([(0, 0, 1e300)])[0] < 30
    for bad in (np.nan, np.inf, -np.inf):
        np.testing.assert_array_equal(oracle(np.where(np.eye(3), bad, 1.0)), [np.inf] * 3)


@both
def test_distances_far_away_are_nearly_euclidean(car):
    oracle = car(GOAL, RADIUS)
    np.testing.assert_allclose(oracle([(1e9, 0, 1), (3e200, 4e200, 1)]), [1e9, 5e200], rtol=1e-7)


def test_batches_of_any_size_give_equal_distances():
    poses, oracle = random_poses(9001), ReedsShepp(GOAL, RADIUS)
    together = oracle(poses)
    np.testing.assert_array_equal(together, np.concatenate([oracle(part) for part in np.array_split(poses, 7)]))
    assert together.dtype == np.float64 and oracle(np.zeros((0, 3))).shape == (0,)


@pytest.mark.parametrize(
    ("oracle", "number"),
    [(Dubins(GOAL, 1.7), 1), (ReedsShepp(GOAL, 1.7), 2), (Euclidean(GOAL), 3), (Euclidean((1.0, 2.0)), 2)],
)
def test_symmetries_keep_distances_to_the_goal(oracle, number):
    x = random_poses(200, 20)[:, : oracle.dim]
    assert isinstance(oracle, SymmetricFn) and len(oracle.symmetries) == number
    for symmetry in oracle.symmetries:
        matrix, offset = symmetry.matrix, symmetry.offset
        np.testing.assert_allclose(oracle(x @ matrix.T + offset), oracle(x), rtol=1e-9, atol=1e-6)
        assert np.abs(matrix - np.eye(oracle.dim)).max() > 0.1
        np.testing.assert_allclose(matrix @ matrix.T, np.eye(oracle.dim), atol=1e-15)
        np.testing.assert_allclose(matrix @ oracle.goal + offset, oracle.goal, atol=1e-15)
