import numpy as np
import pytest
import shapely
from piece_helpers import random_obstacle

from plr_jax import VisibilityGraph, Workspace
from plr_jax.geometry.changes import may_see_polygons
from plr_jax.geometry.corners import CornerVisibility

BOUNDS = ((0, 0), (8, 8))


@pytest.mark.parametrize("seed", [*range(4), *(pytest.param(seed, marks=pytest.mark.full) for seed in range(4, 16))])
def test_changed_oracle_equals_rebuilt_oracle(seed):
    rng = np.random.default_rng(seed)
    kinds = ["grid"] if seed % 4 == 0 else ["grid", "thin", "polygon", "box"]
    workspace = Workspace(BOUNDS, squeeze=bool(seed % 2))
    goal = rng.uniform(4.1, 4.9, 2)
    oracle = VisibilityGraph(workspace, goal)
    for _ in range(6):
        present = [i for i, each in enumerate(workspace.obstacles) if not each.is_empty]
        add = [random_obstacle(rng, rng.choice(kinds)) for _ in range(rng.integers(0, 3))]
        remove = rng.choice(present, rng.integers(0, 3)).tolist() if present else []
        try:
            changed = workspace.with_obstacles(add, remove)
            rebuilt = Workspace(BOUNDS, changed.obstacles, squeeze=workspace.squeeze)
            truth = VisibilityGraph(rebuilt, goal)
        except ValueError:  # a goal that is covered, or walls that are too thin
            continue
        workspace, oracle = changed, oracle.with_workspace(changed)
        assert abs(workspace.free_space.area - rebuilt.free_space.area) < 64 * workspace.tolerance
        x = np.concatenate([rng.uniform(0, 8, (100, 2)), rng.integers(0, 9, (20, 2))])
        x = x[np.abs(rebuilt.clearance(x)) > 1e-7]
        # Slivers as thin as the tolerance may be kept or lost.
        np.testing.assert_allclose(oracle(x), truth(x), rtol=0, atol=1e-12 * 8 if kinds == ["grid"] else 1e-8)


def test_distances_beyond_a_change_are_reused():
    posts = [shapely.box(x, y, x + 0.3, y + 0.3) for x in range(8) for y in range(8)][:31]  # 8 bits number 128 edges
    before = VisibilityGraph(Workspace(BOUNDS, posts), (0.7, 0.7))
    after = before.with_workspace(before.workspace.with_obstacles([shapely.box(7.5, 7.5, 7.6, 7.6)]))
    assert np.isin(before.workspace.boundary.vertices @ [1, 1j], after.workspace.boundary.vertices @ [1, 1j]).all()
    assert after.workspace.boundary.edges.shape[0] == 4 + before.workspace.boundary.edges.shape[0]
    shared = (after.distances[1:, None] == before.distances[1:]).any(axis=1)
    assert shared.sum() == len(before.distances) - 1
    for workspace in (after.workspace, Workspace(((0, 0), (9, 9)), posts)):  # other bounds: nothing to reuse
        oracles = before.with_workspace(workspace), VisibilityGraph(workspace, (0.7, 0.7))
        np.testing.assert_equal(*((oracle.distances, oracle.family.table.edge) for oracle in oracles))


def test_removed_obstacles_keep_their_numbers():
    posts = [shapely.box(x, 3, x + 1, 5) for x in (1, 3, 5)]
    workspace = Workspace(BOUNDS, posts)
    without = workspace.with_obstacles(remove=[1])
    assert [each.is_empty for each in without.obstacles] == [False, True, False]
    assert without.free_space.area == pytest.approx(60) and not workspace.obstacles[1].is_empty
    back = without.with_obstacles([posts[1]])
    assert len(back.obstacles) == 4 and back.free_space.equals(workspace.free_space)
    last = back.with_obstacles(remove=[3, posts[2]])
    assert [i for i, each in enumerate(last.obstacles) if not each.is_empty] == [0]
    ring = np.array(posts[0].exterior.coords)[-2::-1]  # the same vertices, the other way round, not closed
    assert [each.is_empty for each in workspace.with_obstacles(remove=[ring]).obstacles] == [True, False, False]
    # A region that another obstacle covers stays blocked.
    over = workspace.with_obstacles([shapely.box(0, 4, 9, 9)], remove=posts[:1])
    assert over.free_space.area == pytest.approx(32 - 2)
    assert over.with_obstacles(remove=[3]).free_space.area == pytest.approx(60)


@pytest.mark.parametrize("seed", range(2))
def test_polygons_ruled_out_of_sight_are_hidden(seed):
    rng = np.random.default_rng(seed)
    workspace = Workspace(BOUNDS, [random_obstacle(rng, "polygon") for _ in range(6)], squeeze=bool(seed % 2))
    table = CornerVisibility.of(workspace).table
    view, lo = rng.integers(0, len(table.points), 4000), rng.uniform(0, 7.6, (4000, 2))
    size = rng.uniform(0.01, 0.4, (4000, 2))
    hulls = np.stack([lo + size * np.array(corner) for corner in ((0, 0), (1, 0), (1, 1), (0, 1))], axis=1)
    some = may_see_polygons(table, view, hulls)
    assert 300 < some.sum() < 3700
    for _ in range(20):
        x = lo + size * rng.random((4000, 2))
        seen = table.sees(view, x) & workspace.is_free(x)
        assert not seen[~some].any()
