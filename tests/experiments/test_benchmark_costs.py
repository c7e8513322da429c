"""Rivals of the exact oracle, the maps they get, and exponents of growth."""

import sys

import numpy as np
import pytest
import shapely

from experiments.benchmarks import _growth, _oracle
from plr_jax import VisibilityGraph, Workspace, scenes


def test_it_is_said_why_a_rival_is_absent(monkeypatch):
    oracle = VisibilityGraph(*_oracle.polygon_field(16, 0))
    monkeypatch.delenv(_oracle.RIVALS_PYTHON, raising=False)
    assert "names no Python" in _oracle._rival("pyvisgraph", oracle, 0, None)["skipped"]
    monkeypatch.setenv(_oracle.RIVALS_PYTHON, "/no/such/python")
    assert "cannot be run" in _oracle._rival("pyvisgraph", oracle, 0, None)["skipped"]
    assert "over the limit" in _oracle._rival("pyvisgraph", oracle, 0, "a smaller map")["skipped"]


@pytest.mark.parametrize(
    ("script", "reason"),
    [("import time; time.sleep(60)", "over the limit"), ("raise KeyError(7)", "failed: KeyError")],
)
def test_a_rival_that_takes_too_long_or_crashes_is_recorded_so(script, reason, monkeypatch, tmp_path):
    python = tmp_path / "python"
    python.write_text(f'#!/bin/sh\nexec "{sys.executable}" -c "{script}"\n')
    python.chmod(0o755)
    monkeypatch.setenv(_oracle.RIVALS_PYTHON, str(python))
    monkeypatch.setattr(_oracle, "RIVAL_LIMIT", 2.0)
    oracle = VisibilityGraph(*_oracle.polygon_field(16, 0))
    assert reason in _oracle._rival("pyvisgraph", oracle, 0, None)["skipped"]


def test_octagons_are_disjoint_and_all_their_corners_stand_out():
    workspace, goal = _oracle.polygon_field(300, seed=3)
    holes = list(workspace.free_space.interiors)
    assert len(holes) == 300 // 8 and all(len(hole.coords) == 9 for hole in holes)
    polygons = [shapely.Polygon(hole) for hole in holes]
    assert all(polygon.equals(polygon.convex_hull) for polygon in polygons)
    assert workspace.is_free(goal[None])[0]
    assert len(workspace.boundary.vertices) == 8 * len(holes) + 4


@pytest.mark.parametrize("workspace", [scenes.maze().workspace, _oracle.polygon_field(40, 0)[0]])
def test_obstacles_in_a_slit_frame_leave_the_same_free_space(workspace):
    obstacles = _oracle._obstacles(workspace.free_space, 1.0)
    assert all(not obstacle.interiors for obstacle in obstacles)
    within = shapely.difference(shapely.box(*workspace.free_space.bounds), shapely.union_all(obstacles))
    assert shapely.symmetric_difference(within, workspace.free_space).area < 1e-6


def test_rivals_get_obstacles_that_overlap_where_ours_touch():
    squares = [[(1, 1), (2, 1), (2, 2), (1, 2)], [(2, 2), (3, 2), (3, 3), (2, 3)]]
    polygons = _oracle._polygons(Workspace(((0, 0), (4, 4)), squares), np.array([0.5, 0.5]))
    assert len(polygons["holes"]) == 1
    apart = _oracle._polygons(Workspace(((0, 0), (4, 4)), squares[:1]), np.array([0.5, 0.5]))
    assert sorted(map(tuple, apart["holes"][0])) == sorted(map(tuple, np.array(squares[0], float).tolist()))


def test_the_exponent_is_that_of_the_upper_half():
    sizes = [1, 10, 100, 1_000, 10_000]
    power = _growth.fit(sizes, [5.0, 5.0, *(0.5 * n**1.5 for n in sizes[2:])])
    assert power == pytest.approx((1.5, 0.5, 100))
    assert _growth.fit([2, 3, 4, 8], [9, 3, 16, 64])[:2] == pytest.approx((2, 1))
