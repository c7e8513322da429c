"""From a map to a file of kilobytes that answers: what the package promises as a whole."""

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


def test_a_roadmap_is_summarized_with_less_error_than_its_own():
    workspace, goal = scene("maze")
    exact = plr_jax.VisibilityGraph(workspace, goal)
    roadmap = plr_jax.Roadmap.from_workspace(workspace, goal, 10_000)
    # Samples from around a cell average the roadmap's noise.
    plr = plr_jax.construct(roadmap, workspace.bounds, max_bytes=1536, margin=0.25, num_samples=96)
    x = workspace.sample_free(30_000, seed=0)
    own, ours = np.abs(roadmap(x) - exact(x)), np.abs(np.asarray(plr(x)) - exact(x))
    assert ours.max() < own.max() and ours.max() <= 0.134
    assert ours.mean() <= 1.05 * own.mean()
