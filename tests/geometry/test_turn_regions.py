import numpy as np
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph

TEN = ((0, 0), (10, 10))


def random_workspace(seed, lattice, squeeze):
    rng = np.random.default_rng(seed)
    if lattice:
        cells = np.argwhere(rng.random((10, 10)) < 0.3)
        return Workspace(TEN, [shapely.box(x, y, x + 1, y + 1) for x, y in cells], squeeze=squeeze)
    return Workspace(TEN, [rng.uniform(0, 10, 2) + rng.uniform(-2, 2, (3, 2)) for _ in range(8)], squeeze=squeeze)


def hard_points(workspace, seed):
    """On vertices and edges of the triangles, beside them by about the tolerance, and anywhere."""
    rng, triangles = np.random.default_rng(seed), workspace.triangulation.triangles
    on_edges = ((triangles + np.roll(triangles, 1, axis=1)) / 2).reshape(-1, 2)
    beside = workspace.tolerance * rng.choice([0.01, 1, 10, 100], (len(on_edges), 1))
    x = [on_edges, on_edges + beside * rng.normal(size=on_edges.shape), workspace.boundary.vertices]
    x = np.concatenate([*x, workspace.boundary.vertices + beside[0] * rng.normal(size=2)])
    x = np.concatenate([rng.permutation(x)[:150], workspace.sample_free(50, seed)])
    return x[workspace.is_free(x)]


@given(st.integers(0, 100_000), st.booleans(), st.booleans())
@settings(max_examples=40, deadline=None)
def test_turn_points_by_triangle_are_as_good_as_all_of_them(seed, lattice, squeeze):
    workspace = random_workspace(seed, lattice, squeeze)
    x = hard_points(workspace, seed)
    oracle = VisibilityGraph(workspace, x[seed % len(x)])
    x = x[~oracle._goal_table.sees(np.zeros(len(x), int), x)]
    table = oracle._corners.table

    def sees(point, vertex):
        return table.sees(vertex - 1, x[point])

    found = oracle._regions.first_visible(x, sees)
    expected = oracle._turns.first_visible(x, sees)
    np.testing.assert_allclose(found[1], expected[1], rtol=0, atol=1e-8)
    np.testing.assert_array_equal(found[0] < 0, expected[0] < 0)


def test_only_the_corners_around_which_paths_come_count():
    """Left of a wall that stands on the floor paths turn at its upper left corner, above it at the right one."""
    workspace = Workspace(TEN, [shapely.box(4, 0, 6, 8)])
    oracle = VisibilityGraph(workspace, (8.0, 4.0))
    regions, triangles = oracle._regions, workspace.triangulation.triangles
    x = np.array([[1.0, 2.0], [5.0, 9.0], [9.0, 2.0]])
    triangle = workspace.triangulation.locator.find(x)
    at = [regions.turns.points[regions.turn[regions.first[t] : regions.first[t + 1]]].tolist() for t in triangle]
    assert [4.0, 8.0] in at[0] and [6.0, 8.0] in at[1]
    assert len(regions.first) == len(triangles) + 1
