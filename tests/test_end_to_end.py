"""From a map to a file of kilobytes that answers: what the package promises as a whole."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import plr_jax
from plr_jax.metrics import error_map


def points_beside_walls(workspace, n, seed):
    """Free float32 points on the walls, or at most one rounding away from them."""
    rng = np.random.default_rng(seed)
    wall = workspace.free_space.boundary
    x = shapely.get_coordinates(shapely.line_interpolate_point(wall, rng.uniform(0, wall.length, 4 * n)))
    x = x.astype(np.float32)
    toward = rng.choice(np.array([-np.inf, 0, np.inf], np.float32), size=x.shape)
    x = np.where(toward == 0, x, np.nextafter(x, toward))
    x = x[workspace.bounds.contains(x) & workspace.is_free(x.astype(np.float64))]
    assert len(x) >= n
    return x[:n]


@pytest.mark.parametrize(
    ("name", "max_bytes", "largest", "mean"),
    [
        ("maze", 1024, 0.01, 0.001),
        pytest.param("maze", 6144, 0.0018, 0.00015, marks=pytest.mark.full),
        ("thin_maze", 2048, 0.005, 0.0005),
        pytest.param("thin_maze", 6144, 0.0018, 0.00015, marks=pytest.mark.full),
    ],
)
def test_few_kilobytes_answer_every_free_point(name, max_bytes, largest, mean):
    """Table I of the paper, 0.018 and 0.007 at 30.24 KB, at a fraction of its memory."""
    problem = getattr(plr_jax.scenes, name)()
    workspace, goal = problem.workspace, problem.goals[0]
    oracle = plr_jax.VisibilityGraph(workspace, goal)
    plr = plr_jax.construct(oracle, workspace.bounds, max_bytes=max_bytes)
    assert plr.num_bytes <= max_bytes
    answer = plr.numpy()
    report = error_map(answer, oracle, workspace.sample_free(30_000, seed=0))
    assert report.num_unanswered == 0
    assert report.max <= largest and report.mean <= mean
    near = points_beside_walls(workspace, 4_000, seed=1)
    answers = answer(near)
    assert np.isfinite(answers).all()
    # A point beside a wall is answered from its own side of the wall.
    distance = oracle(near.astype(np.float64))
    assert np.quantile(np.abs(answers - distance), 0.99) <= 0.02 * distance.max()


@pytest.mark.full
@pytest.mark.parametrize("corner", [(0.0, -0.3), (1000.1, 30.3)])
def test_free_points_at_bounds_have_finite_answers(corner):
    """Points beside the bounds, where rounding or a tolerance decides whether a point is free."""
    lo, hi = np.array(corner), np.add(corner, (10.0, 7.0))
    wall, goal = np.add([(3, 0), (4, 0), (4, 4), (3, 4)], corner), np.add(corner, (9.1, 1.3))
    workspace = plr_jax.Workspace((lo, hi), [wall])
    oracle = plr_jax.VisibilityGraph(workspace, goal)
    plane, cone = (plr_jax.construct(oracle, (lo, hi), leaf=leaf, max_bytes=300) for leaf in ("plane", "cone"))
    pairs = plr_jax.construct_pairs(workspace)
    host = {
        "visibility": oracle,
        "between": lambda x: oracle.between(x, np.tile(goal, (len(x), 1))),
        "roadmap": plr_jax.Roadmap.from_workspace(workspace, goal, num_samples=30),
        "descend": lambda x: plr_jax.descend(cone, workspace, x, goal).lengths,
    }
    compiled = {
        "plane": plane,
        "cone": cone,
        "pairs": lambda x: pairs(x, goal.astype(np.float32)) + pairs(goal.astype(np.float32), x),
        "pairs, to": pairs.to(goal),
    }
    steps = np.array([-1e-5, -5e-6, -1e-6, -1e-9, -1e-16, 0, 1e-16, 1e-9])[:, None, None] * (hi - lo)
    ends = np.concatenate([lo + steps, hi - steps]).reshape(-1, 2)
    inside = np.random.default_rng(0).uniform(lo, hi, ends.shape)
    beside = np.concatenate([ends, np.where([1, 0], ends, inside), np.where([0, 1], ends, inside)])
    single = beside.astype(np.float32)
    single = np.concatenate([single, *(np.nextafter(single, np.float32(to)) for to in (-np.inf, np.inf))])

    def assert_finite(x, functions):
        free = x[np.asarray(workspace.is_free(x))]
        assert len(free) > 15
        free = free[np.arange(len(single)) % len(free)]  # of one shape, so that each function is compiled once
        for name, fn in functions.items():
            assert np.isfinite(fn(free)).all(), name

    assert_finite(beside, host | compiled)
    assert_finite(single, host | compiled)
    assert_finite(jnp.asarray(single), {name: jax.jit(fn) for name, fn in compiled.items()})
    with jax.enable_x64(True):
        assert_finite(jnp.asarray(beside), compiled)
    assert not workspace.is_free(jnp.asarray(lo - 1e-5 * (hi - lo), jnp.float32)[None]).any()
    # Points clipped to the bounds, in 64 or 32 bits, are free.
    clipped = np.clip(beside, lo, hi)
    clipped = clipped[(np.abs(clipped[:, 0] - lo[0] - 3.5) > 0.6) | (clipped[:, 1] > lo[1] + 4.1)]  # off the wall
    for x in (clipped, clipped.astype(np.float32), jnp.asarray(clipped, jnp.float32)):
        assert workspace.is_free(x).all()
