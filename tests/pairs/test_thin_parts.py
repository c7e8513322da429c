"""Obstacles that are thin, in whole or in part: pairs against the exact oracle of the tests."""

import numpy as np
import pytest
from exact_plane import ExactPlane
from hostile_plans import hostile_plan, judge
from piece_helpers import TEN, box

from plr_jax import VisibilityGraph, Workspace, construct_pairs, scenes
from plr_jax.pairs.construct import outline_of
from plr_jax.pairs.thin_parts import with_thin_parts

# A thick slanted bar; its left wall goes on as a thin wall.
BAR = [(3, 5), (8, 5.5), (7.9, 6.5), (2.9, 6)]
BAR_AND_BLADE = [BAR, [(3, 5), (3.3, 2), (3.3 + 1e-7, 2), (3 + 1e-7, 5 + 1e-8)]]
# A room behind a thin wall: nothing leads into it.
ROOM = [box(2, 2, 4, 8), box(6, 2, 8, 8), box(2, 2, 8, 3), [(2, 8), (8, 8), (8, 8 + 1e-7), (2, 8 + 1e-7)]]


def beside(a, b, away):
    """Points beside a wall, from one to nine tenths of its length."""
    (ax, ay), (bx, by) = a, b
    share, length = np.linspace(0.1, 0.9, 40), np.hypot(bx - ax, by - ay)
    return np.stack(
        [ax + share * (bx - ax) - away * (by - ay) / length, ay + share * (by - ay) + away * (bx - ax) / length], 1
    )


@pytest.mark.parametrize(
    ("obstacles", "goal", "x"),
    [
        (BAR_AND_BLADE, (5, 4), beside((3, 5), (2.9, 6), 1e-9)),
        (ROOM, (9, 9), [(5, 5), (4, 7.9), (5, 8.1)]),
        (ROOM, (5, 7), [(4, 3), (6, 8 - 1e-3), (1, 1), (5, 8.001)]),
    ],
)
def test_pairs_beside_thin_parts_have_the_exact_distance(obstacles, goal, x):
    pairs = construct_pairs(Workspace(TEN, obstacles), max_bytes=2_000)
    exact = ExactPlane(TEN, obstacles).distances(goal, x)
    for got in (pairs(np.array(x, float), np.array(goal, float)), pairs.numpy()(x, goal)):
        np.testing.assert_allclose(got, exact, atol=2e-4)


@pytest.mark.full
def test_pairs_beside_a_thick_wall_that_a_thin_wall_continues_are_right_on_a_real_map(data_dir):
    workspace = scenes.read_workspace(data_dir / "jupedsim" / "arena.wkt")
    # Both points of each pair; the first one is 1e-9 to 1e-6 beside the wall at the end of which a slit begins.
    x = [(49.521819585782964, 60.27599892689271), (49.521865085323995, 60.28508064139136)]
    x += [(49.52183551767964, 60.279178935609494), (49.523288979204466, 60.569285880)]
    y = [(58.755567397358625, 50.20885404118824), (58.96630933718653, 52.35301974687714)]
    y += [(60.85424855338122, 58.04282701548594), (55.72046457295163, 60.5199417119682)]
    pairs, x, y = construct_pairs(workspace), np.array(x), np.array(y)
    exact = VisibilityGraph(workspace, y[0]).between(x, y)
    for got in (pairs(x, y), pairs.numpy()(x, y)):
        np.testing.assert_allclose(got, exact, atol=2e-5 * workspace.bounds.width.max())


# Plans whose pairs were wrong: tips of thin obstacles, thin walls at thick ones, details finer than 32-bit floats,
# goals in line with a thin wall that hangs from a tip.
@pytest.mark.parametrize(("seed", "number"), [(0, 27), (0, 42), (1, 2), (1, 67), (1, 97), (1, 187), (5, 11)])
def test_pairs_of_hostile_plans_are_right(seed, number):
    result = judge(hostile_plan(seed, number), ["pairs"])
    assert result.counts["pairs: asked"] > 50 and not result.failures


def test_only_the_thin_part_of_a_wall_is_thin_and_a_sharp_thin_tip_has_two_points():
    workspace = Workspace(TEN, [BAR, [(3, 5), (3.3, 2), (3 + 1e-7, 5 + 1e-8)]])
    outline, vertex = outline_of(workspace.boundary, workspace.bounds.lo, 10.0, workspace.tolerance, False)
    found, at = with_thin_parts(outline, vertex, workspace.free_space, 10.0)
    ends = found.positions[found.following] - found.positions
    thin, length = found.is_thin, np.linalg.norm(ends, axis=1)
    assert length[thin].sum() == pytest.approx(2 * np.hypot(0.3, 3), abs=1e-2)
    tip = np.flatnonzero((np.abs(found.positions - (3.3, 2)) < 1e-6).all(axis=1))
    assert len(tip) == 2 and at[tip[0]] == at[tip[1]] >= 0
    np.testing.assert_array_equal(at[at >= 0][np.append(True, np.diff(at[at >= 0]) != 0)], vertex)
