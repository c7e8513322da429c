import numpy as np
import pytest
from eikonal_helpers import use_few_nodes
from space_helpers import Climb, SteadyCurrent

from plr_jax import PlaneSpace, Workspace, solve_eikonal
from plr_jax.spaces import CostMap, DirectionalCost, LipschitzCost
from plr_jax.spaces._costs import cost_bounds


def bumpy(q):
    return 2 + np.sin(3 * q[:, 0]) + 0.5 * np.cos(2 * q[:, 1])


BUMPY = LipschitzCost(bumpy, np.hypot(3, 1), 0.5)


def test_lipschitz_bounds_contain_samples_and_shrink_with_boxes():
    assert isinstance(BUMPY, CostMap)
    rng = np.random.default_rng(0)
    lo = rng.uniform(-2, 2, (200, 2))
    hi = lo + rng.uniform(0, 1, (200, 2)) * 2.0 ** -rng.integers(0, 8, (200, 1))
    lower, upper = BUMPY.bounds(lo, hi)
    samples = lo[:, None] + rng.random((200, 50, 2)) * (hi - lo)[:, None]
    values = bumpy(samples.reshape(-1, 2)).reshape(200, 50)
    np.testing.assert_array_equal(BUMPY(samples[:, 0]), values[:, 0])
    assert (lower <= values.min(axis=1)).all() and (upper >= values.max(axis=1)).all()
    assert (lower >= 0.5).all()
    diagonal = np.linalg.norm(hi - lo, axis=1)
    assert (upper - lower <= np.hypot(3, 1) * diagonal + 1e-12).all()


def test_bounds_allow_for_rounding_to_32_bits():
    x = np.random.default_rng(0).random((2_000, 2))
    ends = x - 1e-9, x + 1e-9
    single = LipschitzCost(lambda q: bumpy(q).astype(np.float32), np.hypot(3, 1), 0.5)
    lower, upper = single.bounds(*ends)
    assert ((lower <= bumpy(x)) & (bumpy(x) <= upper)).all() and (upper - lower).max() < 1e-4
    np.testing.assert_array_equal(LipschitzCost(lambda q: np.full(len(q), np.float32(0.7)), 0.0, 0.7)(x), 0.7)


HILL = Climb(lambda q: np.stack([np.sin(q[:, 0]), q[:, 1]], axis=1) / 2, rate=1.5, lipschitz=0.5, steepest=2.0)
CURRENT = SteadyCurrent((0.2, -0.1))
SQUARE = PlaneSpace(Workspace(((0, 0), (1, 1))))


def climbing_cost(q, v):
    return np.linalg.norm(v, axis=1) + 1.5 * np.maximum(0, np.sum(HILL.gradient_fn(q) * v, axis=1))


@pytest.mark.parametrize(("cost", "truth"), [(HILL, climbing_cost), (CURRENT, lambda q, v: CURRENT.time(v))])
def test_directional_bounds_contain_costs_of_motions(cost, truth):
    assert isinstance(cost, DirectionalCost)
    rng = np.random.default_rng(0)
    lo = rng.uniform(-1.5, 1.2, (300, 2))
    hi = lo + rng.uniform(0, 0.3, (300, 2)) * 2.0 ** -rng.integers(0, 8, (300, 1))
    least, most, pulls = cost_bounds(SQUARE.motion_cost, cost, lo, hi)
    for _ in range(50):
        angle = rng.uniform(0, 2 * np.pi, 300)
        v = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        value = truth(lo + rng.random((300, 2)) * (hi - lo), v)
        pull = np.sum(pulls * v, axis=2).max(axis=0)
        assert (least + pull <= value + 1e-12).all() and (value <= most + pull + 1e-12).all()


def test_solver_bounds_contain_travel_time_in_current(monkeypatch):
    use_few_nodes(monkeypatch)
    goal, x = np.array([0.7, 0.6]), np.random.default_rng(0).random((2_000, 2))
    plr = solve_eikonal(SQUARE, goal, cost_map=CURRENT, max_leaves=50).numpy()
    time, (lower, upper) = CURRENT.time(goal - x), plr.bounds(x)
    assert (lower <= time).all() and (time <= upper).all()
    assert np.abs(plr(x) - time).mean() < 0.04 * time.mean()
