import numpy as np
import pytest
import shapely

from plr_jax import scenes


@pytest.mark.parametrize("num_robots", [2, 10, 20, 50])
def test_door(num_robots):
    problem = scenes.door(num_robots)
    half = num_robots // 2
    expected = [(1 + 1.7 * (k % 5), 2 + 3.9 * (k // 5)) for k in range(half)]
    np.testing.assert_allclose(problem.starts[:half], expected)
    np.testing.assert_allclose(problem.starts[half:], [(21 - x, y) for x, y in expected])
    np.testing.assert_allclose(problem.goals, np.roll(problem.starts, half, axis=0))
    assert {robot.radius for robot in problem.robots} == {0.4} and len(problem.robots) == num_robots
    free = shapely.union_all([shapely.box(0, 0, 10, 20), shapely.box(11, 0, 21, 20), shapely.box(10, 9.4, 11, 10.6)])
    assert problem.workspace.free_space.symmetric_difference(free).area < 1e-9


@pytest.mark.parametrize("num_robots", [0, 1, 3, 52, 2.0, True, "2"])
def test_door_of_another_number(num_robots, unchecked_types):
    with pytest.raises(ValueError, match="num_robots must be an"):
        scenes.door(num_robots)


@pytest.mark.parametrize(("num_robots", "seed"), [(2, 0), (25, 0), (100, 1), (300, 2)])
def test_crowd(num_robots, seed):
    problem = scenes.crowd(num_robots, seed)
    (side, height), covered = problem.workspace.bounds.width, num_robots * np.pi * 0.16
    assert side == height and covered / side**2 == pytest.approx(0.15) and not problem.workspace.obstacles
    for places in (problem.starts, problem.goals):
        away = np.hypot(*(places[:, None] - places).T)[~np.eye(num_robots, dtype=bool)]
        assert away.min() >= 0.85 and places.min() >= 0.45 and places.max() <= side - 0.45
    again, other = scenes.crowd(num_robots, seed), scenes.crowd(num_robots, seed + 1)
    np.testing.assert_array_equal(problem.starts, again.starts)
    assert (problem.starts != other.starts).any()
    # Uniform: the mean of the places is the middle, to a few standard errors.
    if num_robots >= 100:
        assert np.abs(np.concatenate([problem.starts, problem.goals]).mean(axis=0) / side - 0.5).max() < 0.1


@pytest.mark.parametrize("num_robots", [0, -1, 2.5, True])
def test_crowd_of_no_robots(num_robots, unchecked_types):
    with pytest.raises(ValueError, match="num_robots must be an integer"):
        scenes.crowd(num_robots)


@pytest.mark.parametrize("seed", [-1, 1.5, "a"])
def test_crowd_of_another_seed(seed, unchecked_types):
    with pytest.raises(ValueError, match="seed must be an integer"):
        scenes.crowd(3, seed)
