"""From a map to a file of kilobytes that answers: what the package promises as a whole."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely

import plr_jax
from plr_jax.metrics import error_map


def scene(name, data_dir=None):
    if name == "arena":
        path = data_dir / "polyanya_arena" / "arena_polygons.json"
        return plr_jax.scenes.read_polygons(path), np.array([1.0, 11.0])
    problem = getattr(plr_jax.scenes, name)()
    return problem.workspace, problem.goals[0]


def beside_walls(workspace, n, seed):
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
        ("maze", 6144, 0.0018, 0.00015),
        ("thin_maze", 2048, 0.005, 0.0005),
        ("thin_maze", 6144, 0.0018, 0.00015),
        ("arena", 4096, np.inf, 0.05),  # where the largest distance is 58.9
    ],
)
def test_every_free_point_has_an_answer_as_near_as_a_budget_of_bytes_allows(name, max_bytes, largest, mean, request):
    """Table I of the paper, 0.018 and 0.007 at 30.24 KB, at a fraction of its memory."""
    workspace, goal = scene(name, request.getfixturevalue("data_dir") if name == "arena" else None)
    oracle = plr_jax.VisibilityGraph(workspace, goal)
    plr = plr_jax.construct(oracle, workspace.bounds, max_bytes=max_bytes)
    assert plr.num_bytes <= max_bytes
    report = error_map(plr, oracle, workspace.sample_free(100_000, seed=0))
    assert report.num_unanswered == 0
    assert report.max <= largest and report.mean <= mean
    near = beside_walls(workspace, 4_000, seed=1)
    answers = np.asarray(plr(near))
    assert np.isfinite(answers).all()
    # A point beside a wall is answered from its own side of the wall.
    distance = oracle(near.astype(np.float64))
    assert np.quantile(np.abs(answers - distance), 0.99) <= 0.02 * distance.max()


@pytest.mark.full
def test_a_roadmap_is_summarized_with_less_error_than_its_own():
    workspace, goal = scene("maze")
    exact = plr_jax.VisibilityGraph(workspace, goal)
    roadmap = plr_jax.Roadmap.from_workspace(workspace, goal, 10_000)
    # Samples from around a cell average the roadmap's noise.
    plr = plr_jax.construct(
        roadmap, workspace.bounds, max_bytes=1536, options=plr_jax.BuildOptions(margin=0.25, num_samples=96)
    )
    x = workspace.sample_free(30_000, seed=0)
    own, ours = np.abs(roadmap(x) - exact(x)), np.abs(np.asarray(plr(x)) - exact(x))
    assert ours.max() < own.max() and ours.max() <= 0.134
    assert ours.mean() <= 1.05 * own.mean()


def queries_of(workspace, goal):
    """What answers distances to the goal, from NumPy's points and, but for oracles, from JAX's."""
    oracle, bounds, to = plr_jax.VisibilityGraph(workspace, goal), workspace.bounds, {"max_bytes": 300}
    pairs = plr_jax.construct_pairs(workspace)
    metric = plr_jax.construct_metric_pairs(lambda x, y: np.linalg.norm(x - y, axis=1), bounds, max_leaves=8)
    plrs = [plr_jax.construct(oracle, bounds, leaf=leaf, **to) for leaf in ("plane", "continuous", "cone")]
    stack = plr_jax.stack(plrs[:1])
    oracles = {
        "visibility": oracle,
        "between": lambda x: oracle.between(x, np.tile(goal, (len(x), 1))),
        "roadmap": plr_jax.Roadmap.from_workspace(workspace, goal, num_samples=30),
        "field": plr_jax.GridField(np.ones((3, 4)), bounds),
        "descend": lambda x: plr_jax.descend(plrs[2], workspace, x, goal).lengths,
    }
    compiled = {
        **{plr.leaf.name: plr for plr in plrs},
        "pairs": lambda x: pairs(x, goal.astype(np.float32)) + pairs(goal.astype(np.float32), x),
        "pairs, lower": lambda x: pairs.bounds(x, goal.astype(np.float32))[0],
        "pairs, to": pairs.to(goal),
        # In a domain far from the origin a stack counts points from a corner, which 32-bit points may be outside of.
        **({} if bounds.lo[0] > 20 else {"stack": lambda x: stack(np.zeros(len(x), int), x)}),
        "metric": lambda x: metric(
            x, jnp.asarray(goal, x.dtype) if isinstance(x, jax.Array) else goal.astype(x.dtype)
        ),
    }
    return oracles, compiled


@pytest.mark.full
@pytest.mark.parametrize("corner", [(0.0, -0.3), (1000.1, 30.3)])
def test_what_is_free_is_answered_finitely_by_everything(corner):
    """Also where rounding, or a tolerance, decides whether a point is on the bounds or outside."""
    lo, hi = np.array(corner), np.add(corner, (10.0, 7.0))
    wall, goal = np.add([(3, 0), (4, 0), (4, 4), (3, 4)], corner), np.add(corner, (9.1, 1.3))
    workspace = plr_jax.Workspace((lo, hi), [wall])
    oracles, compiled = queries_of(workspace, goal)
    steps = np.array([-1e-5, -5e-6, -1e-6, -1e-9, -1e-16, 0, 1e-16, 1e-9])[:, None, None] * (hi - lo)
    ends = np.concatenate([lo + steps, hi - steps]).reshape(-1, 2)
    inside = np.random.default_rng(0).uniform(lo, hi, ends.shape)
    on_faces = np.concatenate([ends, np.where([1, 0], ends, inside), np.where([0, 1], ends, inside)])
    single = on_faces.astype(np.float32)
    single = np.concatenate([single, *(np.nextafter(single, np.float32(to)) for to in (-np.inf, np.inf))])
    free = {}
    with jax.enable_x64(True):
        doubles = jnp.asarray(on_faces)
        doubles = doubles[workspace.is_free(doubles)]
        for name, fn in compiled.items():
            assert np.isfinite(fn(doubles)).all(), name
    for x in (on_faces, single):
        free[x.dtype.name] = x = x[workspace.is_free(x)]
        for name, fn in {**oracles, **compiled}.items():
            assert np.isfinite(fn(x)).all(), name
    traced = jnp.asarray(single)[workspace.is_free(jnp.asarray(single))]
    for name, fn in compiled.items():
        assert np.isfinite(jax.jit(fn)(traced)).all(), name
    # What is clipped to the bounds, in 64 or 32 bits, is free.
    clipped = np.clip(on_faces, lo, hi)
    away = (clipped[:, 0] < lo[0] + 2.9) | (clipped[:, 0] > lo[0] + 4.1) | (clipped[:, 1] > lo[1] + 4.1)
    assert workspace.is_free(clipped[away]).all() and workspace.is_free(clipped[away].astype(np.float32)).all()
    assert workspace.is_free(jnp.asarray(clipped[away], jnp.float32)).all()
    assert len(doubles) > 15 and len(traced) > 50 and all(len(x) > 15 for x in free.values())
    assert not workspace.is_free(jnp.asarray(lo - 1e-5 * (hi - lo), jnp.float32)[None]).any()
