"""Obstacles that are thin, in whole or in part: pairs against the exact oracle of the tests."""

import numpy as np
import pytest
from exact_plane import ExactPlane
from hostile_plans import hostile_plan, judge
from piece_helpers import TEN, box

from plr_jax import VisibilityGraph, Workspace, construct_pairs
from plr_jax.pairs.construct import outline_of
from plr_jax.pairs.thin_parts import with_thin_parts

# A thick slanted bar; its left wall goes on as a thin wall.
BAR = [(3, 5), (8, 5.5), (7.9, 6.5), (2.9, 6)]
BAR_AND_BLADE = [BAR, [(3, 5), (3.3, 2), (3.3 + 1e-7, 2), (3 + 1e-7, 5 + 1e-8)]]
# A room behind a thin wall: nothing leads into it.
ROOM = [box(2, 2, 4, 8), box(6, 2, 8, 8), box(2, 2, 8, 3), [(2, 8), (8, 8), (8, 8 + 1e-7), (2, 8 + 1e-7)]]


def beside(a, b, away):
    """Points beside a wall, from one to nine tenths of its length."""
    dx, dy = np.subtract(b, a)
    return a + np.linspace(0.1, 0.9, 40)[:, None] * (dx, dy) + away * np.array((-dy, dx)) / np.hypot(dx, dy)


@pytest.mark.parametrize(
    ("obstacles", "goal", "x"),
    [
        (BAR_AND_BLADE, (5, 4), beside((3, 5), (2.9, 6), 1e-9)),
        (ROOM, (9, 9), [(5, 5), (4, 7.9), (5, 8.1)]),
        (ROOM, (5, 7), [(4, 3), (6, 8 - 1e-3), (1, 1), (5, 8.001)]),
    ],
)
def test_pairs_beside_thin_parts_have_exact_distance(obstacles, goal, x):
    pairs = construct_pairs(Workspace(TEN, obstacles), max_bytes=2_000)
    exact = ExactPlane(TEN, obstacles).distances(goal, x)
    for got in (pairs(np.array(x, float), np.array(goal, float)), pairs.numpy()(x, goal)):
        np.testing.assert_allclose(got, exact, atol=2e-4)


SLIVER = [(632, 793), (637, 1154), (635, 1154)]
PLANK = [(346, 577), (346.0005, 577), (402.0005, 871), (402, 871)]  # 5e-7 widths thick


@pytest.mark.parametrize(
    ("obstacles", "x", "y", "corners"),
    [
        ([SLIVER, [(632, 793), (407, 861), (397, 793)]], (595.04, 804.3), (700, 500), [(632, 793)]),
        ([SLIVER, [(632, 793), (407, 861), (397, 793)]], (600, 700), (640, 900), [(632, 793)]),
        # Beside a tip in the middle of a thin wall, no path leads through the wall.
        ([PLANK, [(374, 724), (200, 730), (200, 720)]], (300, 750), (300, 700), [(374, 724)]),
        ([PLANK, [(374, 724), (200, 730), (200, 720)]], (300, 750), (390, 724), [(402, 871), (402.0005, 871)]),
        # No path leads through a thin wall 2e-6 widths beyond a tip.
        ([PLANK, [(373.998, 724), (200, 730), (200, 720)]], (300, 700), (390, 724), [(346, 577), (346.0005, 577)]),
    ],
)
def test_paths_squeeze_through_contacts_of_thin_obstacles_only(obstacles, x, y, corners):
    pairs = construct_pairs(Workspace(((0, 0), (1024, 1024)), obstacles, squeeze=True), max_bytes=2_000).numpy()
    expected = np.linalg.norm(np.diff([x, *corners, y], axis=0), axis=1).sum()
    lower, upper = pairs.bounds(x, y)
    assert pairs(x, y) == pytest.approx(expected, abs=2e-2) and lower <= expected <= upper


def test_lower_bounds_hold_where_a_tip_almost_touches_a_wall_that_is_hardly_thick():
    """Corners in front of tips moved 5e-6 widths, through the wall, so that its far side hid them."""
    tip = (6.874998590212537, 3.281251128794903)
    wall = [(5.365886685883218, 1.39647090977969), (5.365926913414429, 1.396438700220883)]
    wall += [(8.540985254153487, 5.361868939869193), (8.540945026622275, 5.361901149428)]
    needles = [[tip, (4.184053, 8.125986), (4.135243, 8.098551)], [tip, (1.284329, 9.711063), (1.282487, 9.709461)]]
    workspace, goal = Workspace(TEN, [wall, *needles]), (3.80524, 6.815452)
    x = workspace.sample_free(200, seed=0)
    lower, _ = construct_pairs(workspace, max_bytes=2_000).numpy().bounds(x, goal)
    assert (lower <= VisibilityGraph(workspace, goal)(x)).all()


MORE_PLANS = [(0, 42), (1, 2), (1, 67), (1, 97), (1, 187)]


# Plans whose pairs were wrong: tips of thin obstacles, thin walls at thick ones, details finer than 32-bit floats,
# goals in line with a thin wall that hangs from a tip.
@pytest.mark.parametrize(
    ("seed", "number"), [(0, 27), (5, 11), *(pytest.param(*plan, marks=pytest.mark.full) for plan in MORE_PLANS)]
)
def test_pairs_of_hostile_plans_equal_exact_oracle(seed, number):
    result = judge(hostile_plan(seed, number), ["pairs"])
    assert result.counts["pairs: asked"] > 50 and not result.failures


def test_only_thin_part_of_wall_is_thin():
    workspace = Workspace(TEN, [BAR, [(3, 5), (3.3, 2), (3 + 1e-7, 5 + 1e-8)]])
    outline, vertex = outline_of(workspace.boundary, workspace.bounds.lo, 10.0, workspace.tolerance)
    found, at = with_thin_parts(outline, vertex, workspace.free_space, 10.0)
    ends = found.positions[found.following] - found.positions
    thin, length = found.is_thin, np.linalg.norm(ends, axis=1)
    assert length[thin].sum() == pytest.approx(2 * np.hypot(0.3, 3), abs=1e-2)
    tip = np.flatnonzero((np.abs(found.positions - (3.3, 2)) < 1e-6).all(axis=1))
    assert len(tip) == 2 and at[tip[0]] == at[tip[1]] >= 0
    np.testing.assert_array_equal(at[at >= 0][np.append(True, np.diff(at[at >= 0]) != 0)], vertex)
