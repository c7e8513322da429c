import numpy as np
import pytest

from plr_jax import PlaneSpace, Workspace, solve_eikonal
from plr_jax.spaces import Climbing, Current, DirectionalCost

HILL = Climbing(lambda q: np.stack([np.sin(q[:, 0]), q[:, 1]], axis=1) / 2, rate=1.5, lipschitz=0.5, steepest=2.0)
WHIRL = Current(lambda q: 0.3 * np.stack([-q[:, 1], q[:, 0]], axis=1), speed=1.0, lipschitz=0.3, fastest=0.8)


def climbing_cost(q, v):
    return np.linalg.norm(v, axis=1) + 1.5 * np.maximum(0, np.sum(HILL.gradient_fn(q) * v, axis=1))


def time_in_current(q, v):
    """The least ``t`` at which the vehicle, carried along for as long, gets to ``v``."""
    w = WHIRL.velocity_fn(q)
    a, b, c = 1 - np.sum(w * w, axis=1), np.sum(w * v, axis=1), np.sum(v * v, axis=1)
    t = (-b + np.sqrt(b * b + a * c)) / a
    np.testing.assert_allclose(np.linalg.norm(v - t[:, None] * w, axis=1), t, rtol=1e-9)
    return t


@pytest.mark.parametrize(("cost", "truth"), [(HILL, climbing_cost), (WHIRL, time_in_current)])
def test_bounds_hold_for_motions_all_ways_everywhere_in_boxes(cost, truth):
    assert isinstance(cost, DirectionalCost)
    rng = np.random.default_rng(0)
    lo = rng.uniform(-1.5, 1.2, (300, 2))
    hi = lo + rng.uniform(0, 0.3, (300, 2)) * 2.0 ** -rng.integers(0, 8, (300, 1))
    first, second, least, most = cost.pulls(lo, hi)
    lower, upper = cost.bounds(lo, hi)
    for _ in range(50):
        angle = rng.uniform(0, 2 * np.pi, 300)
        v = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        value = truth(lo + rng.random((300, 2)) * (hi - lo), v)
        pull = np.maximum(np.sum(first * v, axis=1), np.sum(second * v, axis=1))
        assert (least + pull <= value + 1e-12).all() and (value <= most + pull + 1e-12).all()
        assert (lower <= value + 1e-12).all() and (value <= upper + 1e-12).all()


@pytest.mark.parametrize(("cost", "truth"), [(HILL, climbing_cost), (WHIRL, time_in_current)])
def test_it_answers_what_the_dearest_way_costs(cost, truth):
    q = np.random.default_rng(0).uniform(-1.5, 1.5, (20, 2))
    angle = np.linspace(0, 2 * np.pi, 2001)
    dearest = [truth(np.tile(x, (2001, 1)), np.stack([np.cos(angle), np.sin(angle)], axis=1)).max() for x in q]
    np.testing.assert_allclose(cost(q), dearest, rtol=1e-5)


def test_a_steady_current_is_crossed_in_the_known_time():
    goal, w = np.array([0.7, 0.6]), np.array([0.2, -0.1])
    current = Current(lambda q: np.tile(w, (len(q), 1)), speed=1.0, lipschitz=0.0, fastest=0.25)
    plr = solve_eikonal(PlaneSpace(Workspace(((0, 0), (1, 1)))), goal, cost_map=current, max_leaves=1_000)
    x = np.random.default_rng(0).random((5_000, 2))
    a, b = 1 - w @ w, (goal - x) @ w
    time = (-b + np.sqrt(b * b + a * np.sum((goal - x) ** 2, axis=1))) / a
    lower, upper = (np.asarray(bound) for bound in plr.bounds(x))
    assert (lower <= time).all() and (time <= upper).all()
    assert np.abs(np.asarray(plr(x)) - time).mean() < 0.02 * time.mean()


@pytest.mark.usefixtures("unchecked_types")
@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: Climbing(3, 1.0, 0.0, 1.0), "gradient_fn must be a function"),
        (lambda: Climbing(HILL.gradient_fn, -1.0, 0.0, 1.0), "rate must be"),
        (lambda: Current(3, 1.0, 0.0, 0.5), "velocity_fn must be a function"),
        (lambda: Current(WHIRL.velocity_fn, 0.0, 0.0, 0.5), "speed must be a positive"),
        (lambda: Current(WHIRL.velocity_fn, 1.0, 0.0, 1.0), "fastest must be below speed, 1, got 1"),
        (lambda: WHIRL(np.full((1, 2), 9.0)), "vectors of at most 0.8"),
        (lambda: Current(lambda q: q[:, 0], 1.0, 0.0, 0.5)(np.zeros((2, 2))), r"shape \(2, 2\), got \(2,\)"),
    ],
)
def test_bad_arguments_and_answers_are_refused(make, message):
    with pytest.raises(ValueError, match=message):
        make()
