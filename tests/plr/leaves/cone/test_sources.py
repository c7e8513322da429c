import numpy as np
import pytest
from plr_helpers import UNIT, walled

from plr_jax import scenes
from plr_jax.geometry.box import Box
from plr_jax.oracles import VisibilityGraph
from plr_jax.plr.leaves.cone.sources import find_sources
from plr_jax.plr.sampling.cell_fit import Sampler, sample_pattern


def found_sources(distance_fn, domain):
    pattern = sample_pattern(domain.dim, 96, 0.0, 0)
    return find_sources(Sampler(distance_fn, domain, None, pattern, pattern, 20))


def noisy(distance_fn, noise, kind):
    rng = np.random.default_rng(7)
    draw = {"normal": lambda n: rng.normal(size=n), "uniform": lambda n: rng.uniform(-1, 1, n)}[kind]
    return lambda x: distance_fn(x) + noise * draw(len(x))


@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_corners_of_a_maze_are_found_exactly_each_once_with_its_parent(scene):
    problem = scene()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    found = found_sources(oracle.__call__, problem.workspace.bounds).sources
    gap = np.linalg.norm(found.points[:, None] - oracle.sources.points, axis=2)
    corner = gap.argmin(axis=1)
    assert gap.min(axis=1).max() < 1e-12 and len(np.unique(corner)) == len(corner) >= 12
    assert np.abs(found.distances - oracle.distances[corner]).max() < 1e-12
    assert np.array_equal(corner[found.parents], oracle.sources.parents[corner])


@pytest.mark.parametrize("kind", ["normal", "uniform"])
@pytest.mark.parametrize("scene", [scenes.maze, scenes.thin_maze])
def test_noise_averages_out(scene, kind):
    problem = scene()
    oracle = VisibilityGraph(problem.workspace, problem.goals[0])
    found = found_sources(noisy(oracle, 1e-6, kind), problem.workspace.bounds)
    gap = np.linalg.norm(found.sources.points[:, None] - oracle.sources.points, axis=2)
    assert len(found.sources.points) == 12 and len(np.unique(gap.argmin(axis=1))) == 12
    assert np.median(gap.min(axis=1)) < 3e-6 and gap.min(axis=1).max() < 5e-5
    assert 0.8 < found.noise / (1e-6 if kind == "normal" else 1e-6 / np.sqrt(3)) < 1.1
    is_root = found.sources.parents == np.arange(12)
    assert np.abs(found.sources.distances).min() < 1e-6 and 1 <= np.count_nonzero(is_root) <= 2


def test_the_goal_and_what_is_behind_a_wall():
    found = found_sources(walled, UNIT).sources
    known = np.array([[0.1, 0.1], [0.4, 0.7], [0.5, 0.7]])
    gap = np.linalg.norm(found.points[:, None] - known, axis=2)
    assert gap.min(axis=1).max() < 1e-11 and sorted(gap.argmin(axis=1)) == [0, 1, 2]


@pytest.mark.parametrize("dim", [1, 2, 3, 4])
def test_one_cone_is_one_source_in_any_dimension(dim):
    goal = np.linspace(0.2, 0.8, dim)
    seen = []

    def distance(x):
        seen.append(len(x))
        return np.linalg.norm(x - goal, axis=1)

    found = found_sources(distance, Box(np.zeros(dim), np.ones(dim))).sources
    assert len(found.points) == 1 and np.abs(found.points - goal).max() < 1e-12
    assert abs(found.distances[0]) < 1e-12 and sum(seen) == 96


def test_a_smooth_function_that_is_no_distance_has_none():
    found = found_sources(lambda x: 2 + np.sin(3 * x[:, 0]) * np.cos(2 * x[:, 1]), UNIT)
    assert len(found.sources.points) == len(found.sources.parents) == 0


def test_where_nothing_is_reached_there_are_none():
    assert len(found_sources(lambda x: np.full(len(x), np.inf), UNIT).sources.points) == 0


def test_the_number_of_samples_is_bounded():
    seen = []

    def rough(x):
        seen.append(len(x))
        return np.random.default_rng(len(seen)).random(len(x))

    found_sources(rough, UNIT)
    assert sum(seen) <= 96 * 2**11
