"""Lengths and paths that others have published."""

import csv
import json
from collections import defaultdict

import numpy as np
import pytest
from oracle_helpers import box

from plr_jax import scenes
from plr_jax.geometry.workspace import Workspace
from plr_jax.oracles import VisibilityGraph


def without_grazed(path):
    """A path without repeated points and without those on the straight line between their neighbors."""
    kept = [path[0]]
    for point in path[1:]:
        if np.linalg.norm(point - kept[-1]) < 1e-9:
            continue
        while len(kept) > 1:
            u, v = kept[-1] - kept[-2], point - kept[-1]
            if abs(u[0] * v[1] - u[1] * v[0]) > 1e-9:
                break
            kept.pop()
        kept.append(point)
    return np.array(kept)


def by_goal(rows):
    """Rows (start x, start y, goal x, goal y, length) grouped into (goal, starts, lengths)."""
    groups = defaultdict(list)
    for sx, sy, gx, gy, published in rows:
        groups[gx, gy].append((sx, sy, published))
    return [(goal, np.array(g)[:, :2], np.array(g)[:, 2]) for goal, g in groups.items()]


def test_polyanya_arena_lengths(data_dir):
    folder = data_dir / "polyanya_arena"
    with open(folder / "arena_euclid.csv") as file:
        columns = ("start_x", "start_y", "goal_x", "goal_y", "euclid_length")
        rows = [[float(row[c]) for c in columns] for row in csv.DictReader(file)]
    assert len(rows) == 160
    oracle = VisibilityGraph(scenes.read_polygons(folder / "arena_polygons.json"), rows[0][2:4])
    for goal, starts, published in by_goal(rows):
        np.testing.assert_allclose(oracle.with_goal(goal)(starts), published, rtol=0, atol=1e-4)


@pytest.mark.parametrize("name", ["dao/den009d", "dao/den101d", "dao/den312d", "da2/ht_store"])
def test_movingai_lengths_lie_between_straight_and_octile(data_dir, name):
    scenario = scenes.read_scen(data_dir / "movingai" / f"{name}.map.scen")
    rows = np.column_stack([scenario.starts, scenario.goals, scenario.octile_lengths])
    assert len(rows) >= 70
    workspace = scenes.read_polygons(data_dir / "movingai" / f"{name}_polygons.json")
    oracle, total = VisibilityGraph(workspace, rows[0, 2:4]), 0.0
    for goal, starts, octile in by_goal(rows):
        distance = oracle.with_goal(goal)(starts)
        assert (distance >= np.linalg.norm(starts - goal, axis=1) - 1e-9).all()
        assert (distance <= octile + 2e-3).all()
        total += distance.sum()
    assert total > 0.92 * rows[:, 4].sum()  # steps in eight directions are 8.3 % longer at most, but at corners


def environment(data, name, squeeze):
    if name == "grid_env":
        cells = [box(x, y, x + 1, y + 1) for x, y in data["blocked_cells"]]
        return Workspace(((0, 0), (data["size_x"], data["size_y"])), cells, squeeze=squeeze)
    return Workspace.from_polygons([{"outer": data["boundary"], "holes": data["holes"]}], squeeze=squeeze)


@pytest.mark.parametrize("file", ["cases_2.7.2.json", "cases_2021.json"])
@pytest.mark.parametrize("name", ["grid_env", "poly_env", "overlap_poly_env", "separated_env"])
def test_extremitypathfinder_lengths_and_paths(data_dir, file, name):
    data = json.loads((data_dir / "extremitypathfinder" / file).read_text())[name]
    workspace = environment(data, name, squeeze=True)
    assert data["cases"]
    for case in data["cases"]:
        oracle = VisibilityGraph(workspace, case["goal"])
        distance = oracle(np.array([case["start"]]))[0]
        path = oracle.shortest_path(case["start"])
        if case["length"] is None:
            assert np.isinf(distance)
            assert len(path) == 0
            continue
        assert distance == pytest.approx(case["length"], abs=1e-6)
        published = without_grazed(np.array(case["path"], dtype=float))
        np.testing.assert_allclose(without_grazed(path), published, atol=1e-9)
    for start, goal in data.get("invalid_queries", []):
        if workspace.is_free(np.array([goal]))[0]:
            assert np.isinf(VisibilityGraph(workspace, goal)(np.array([start]))[0])
        else:
            with pytest.raises(ValueError, match="goal"):
                VisibilityGraph(workspace, goal)


@pytest.mark.parametrize("thickness", [0.001, 0.04])
@pytest.mark.parametrize("height", [1e-7, 5e-9, 1e-4])
def test_no_wall_is_seen_through_along_the_wall_it_stands_on(thickness, height):
    """A viewpoint barely above the floor must not see the floor beyond a wall that stands on it."""
    far = 0.5 + thickness
    workspace = Workspace(((0, 0), (1, 1)), [[(0.5, 0), (far, 0), (far, 1), (0.5, 1)]])
    oracle = VisibilityGraph(workspace, (0.1, height))
    assert np.isinf(oracle(np.array([[far, 0.0], [far + 1e-4, 0.0], [0.9, 0.5], [1.0, 0.0]]))).all()
    assert np.isfinite(oracle(np.array([[0.5, 0.0], [0.3, 0.0], [0.5, 1.0], [0.0, 0.0]]))).all()


def test_a_short_wall_on_a_floor_is_walked_around():
    workspace = Workspace(((0, 0), (1, 1)), [[(0.5, 0), (0.501, 0), (0.501, 0.2), (0.5, 0.2)]])
    oracle = VisibilityGraph(workspace, (0.1, 1e-7))
    expected = np.hypot(0.4, 0.2 - 1e-7) + 0.001 + 0.2
    np.testing.assert_allclose(oracle(np.array([[0.501, 0.0]])), expected, atol=1e-9)
