import numpy as np
import pytest

from plr_jax.spaces import Climbing, CostMap, LipschitzCost


def bumpy(q):
    return 2 + np.sin(3 * q[:, 0]) + 0.5 * np.cos(2 * q[:, 1])


BUMPY = LipschitzCost(bumpy, np.hypot(3, 1), 0.5)


def test_bounds_hold_all_samples_and_are_near_them_in_small_boxes():
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


def test_what_functions_round_in_32_bits_is_allowed_for():
    x = np.random.default_rng(0).random((2_000, 2))
    ends = x - 1e-9, x + 1e-9
    single = LipschitzCost(lambda q: bumpy(q).astype(np.float32), np.hypot(3, 1), 0.5)
    lower, upper = single.bounds(*ends)
    assert ((lower <= bumpy(x)) & (bumpy(x) <= upper)).all() and (upper - lower).max() < 1e-4
    np.testing.assert_array_equal(LipschitzCost(lambda q: np.full(len(q), np.float32(0.7)), 0.0, 0.7)(x), 0.7)
    climbing = Climbing(lambda q: np.tile(np.float32([0.3, 0]), (len(q), 1)), 1.0, 0.0, 0.3)
    _, uphill, least, most = climbing.pulls(*ends)
    slope = uphill @ (1, 0)
    assert (slope + least <= 1.3).all() and (slope + most >= 1.3).all()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((3.0, 1.0, 1.0), "cost_fn must be a function of configurations, got 3.0"),
        ((bumpy, -1.0, 1.0), "lipschitz must"),
        ((bumpy, np.nan, 1.0), "lipschitz must"),
        ((bumpy, np.inf, 1.0), "lipschitz must"),
        ((bumpy, "much", 1.0), "lipschitz must"),
        ((bumpy, 1.0, 0.0), "least must"),
        ((bumpy, 1.0, -2.0), "least must"),
        ((bumpy, 1.0, np.nan), "least must"),
    ],
)
@pytest.mark.usefixtures("unchecked_types")
def test_bad_arguments_are_refused(arguments, message):
    with pytest.raises(ValueError, match=message):
        LipschitzCost(*arguments)


@pytest.mark.parametrize(
    ("cost_fn", "message"),
    [
        (lambda q: 1.0, r"one number a point, shape \(3,\), got \(\)"),
        (lambda q: q, r"one number a point, shape \(3,\), got \(3, 2\)"),
        (lambda q: np.array([1.0, 0.1, 1.0]), "finite numbers of at least 0.5, got 0.1 at"),
        (lambda q: np.array([1.0, np.nan, 1.0]), "got nan at"),
        (lambda q: np.array([1.0, 1.0, np.inf]), "got inf at"),
    ],
)
def test_functions_that_return_something_else_are_refused(cost_fn, message):
    with pytest.raises(ValueError, match=message):
        LipschitzCost(cost_fn, 1.0, 0.5)(np.zeros((3, 2)))
    with pytest.raises(ValueError, match=message):
        LipschitzCost(cost_fn, 1.0, 0.5).bounds(np.zeros((3, 2)), np.ones((3, 2)))
