"""The independent check of paths: verdicts, the first violation and the clearance."""

from functools import partial
from itertools import combinations

import numpy as np
import pytest
import shapely
from piece_helpers import box
from robot_helpers import BAR, DISC, PEBBLE, POINT, WING, along, random_motions, shapes

from experiments import _dbcbs
from plr_jax import DiscRobot, Problem, RectangleRobot, Workspace, validate
from plr_jax.collision.motions import JointMotionTest
from plr_jax.collision.walls import MotionTest

UP = np.pi / 2
ROOM = Workspace(((0, 0), (4, 4)), [box(3, 3.5, 3.5, 4), box(1.8, 1.8, 2.2, 2.2)])


def report(robots, *rows, workspace=ROOM):
    path = np.array(rows, dtype=float)
    return validate(Problem(workspace, robots, path[0], path[-1]), path)


def test_removed_obstacle_keeps_numbers_of_others():
    without = ROOM.with_obstacles(remove=[0])
    assert report([DISC], [(3.3, 3.3)], [(3.3, 3.7)], workspace=without).valid
    result = report([DISC], [(1, 2)], [(3, 2)], workspace=without)
    assert result.message.startswith("Robot 0 collides with obstacle 1")


def test_free_path_is_valid_with_cost_and_clearance():
    result = report([DISC], [(1, 1)], [(1, 3)], [(2, 3)])
    assert result.valid and result.when is None
    assert result.cost == pytest.approx(3.0)
    assert result.clearance == pytest.approx(3 - 2.2 - 0.3, abs=1e-9)
    assert result.message.startswith("Valid: clearance 0.5, of robot 0")
    alone = report([DISC], [(1, 1)])
    assert alone.valid and alone.cost == 0 and alone.clearance == pytest.approx(0.7)


def test_robots_that_touch_have_clearance_zero():
    result = report([DISC], [(1, 2.5)], [(3, 2.5 - 1e-10)])
    assert result.valid and result.clearance >= 0
    assert result.message.startswith("Valid: clearance 0, of robot 0")


def test_clearance_holds_between_rows_and_during_turns():
    assert report([DISC], [(1, 2.6)], [(3, 2.6)]).clearance == pytest.approx(0.1)
    diagonal = np.hypot(0.9, 0.3) / 2
    turning = report([BAR], [(2, 2.7, 0)], [(2, 2.7, UP)])
    assert turning.clearance == pytest.approx(0.5 - diagonal, abs=5e-7)
    pair = report([BAR, DISC], [(1, 1, 0), (1, 1.9, 0)], [(1, 1, UP), (1, 1.9, 0)])
    assert pair.clearance == pytest.approx(0.9 - 0.3 - diagonal, abs=5e-7)
    assert pair.who == (0, 1)


def test_touching_is_valid():
    assert report([DISC], [(1, 2.5)], [(3, 2.5)]).clearance == pytest.approx(0, abs=1e-9)
    for robots, start, end in (
        ([POINT], [(1, 2.2)], [(3, 2.2)]),
        ([BAR], [(1, 2.35, 0)], [(3, 2.35, 0)]),
        ([DISC, DISC], [(1, 1), (1, 1.6)], [(3, 1), (3, 1.6)]),
        ([POINT, POINT], [(0.5, 1), (3.5, 1)], [(3.5, 1), (0.5, 1)]),
    ):
        room = ROOM if len(robots) == 1 else Workspace(ROOM.bounds)
        assert report(robots, start, end, workspace=room).valid


VIOLATIONS = [
    (POINT, (1, 2), (3, 2), 0.4, (1.8, 2)),
    (DISC, (1, 2), (3, 2), 0.25, (1.5, 2)),
    (BAR, (1, 2, 0), (3, 2, 0), 0.175, (1.35, 2)),
    (BAR, (1, 2, UP), (3, 2, UP), 0.325, (1.65, 2)),
]


@pytest.mark.parametrize(("robot", "start", "end", "when", "where"), VIOLATIONS)
def test_first_violation_names_robot_place_and_time(robot, start, end, when, where):
    rest = (0.5, 3.5, 0)[: len(start)]
    result = report([DISC, robot], [rest, start], [rest, start], [rest, end])
    assert not result.valid
    assert result.who == (1,)
    assert result.when == pytest.approx(1 + when, abs=1e-3)
    assert result.where == pytest.approx(where, abs=2e-3)
    assert result.message.startswith("Robot 1 collides with obstacle 1 at step 1.")
    assert result.clearance < -0.1


def test_leaving_bounds_is_reported():
    result = report([DISC], [(1, 1)], [(-1, 1)], [(1, 1)])
    assert not result.valid and result.when == pytest.approx(0.35, abs=1e-3)
    assert "Robot 0 leaves the bounds at step 0.3" in result.message


def test_earliest_meeting_of_robots_is_reported():
    start, end = [(0.5, 1), (3.5, 1), (0.5, 3)], [(3.5, 1), (0.5, 1), (2.9, 3)]
    result = report([DISC, DISC, DISC], start, end)
    assert (result.valid, result.who) == (False, (0, 1))
    assert result.when == pytest.approx((3 - 0.6) / 2 / 3, abs=1e-3)
    assert "Robots 0 and 1 collide at step 0.4" in result.message
    assert result.clearance == pytest.approx(-0.6, abs=0.05)


@pytest.mark.parametrize("robot", [BAR, WING])
def test_body_that_passes_over_a_point_collides(robot):
    start, post, end = (1.0, 1.0, 0.0), (2.0, 1.0, 0.0), (3.0, 1.0, 0.0)
    assert not report([robot, POINT], [start, post], [end, post]).valid
    assert not report([POINT, robot], [post, start], [post, end]).valid


@pytest.mark.parametrize("width", [1e-5, 1e-8, 1e-10])
def test_thin_walls_stop_all_robots(width):
    wall, bar = shapely.box(2, 0.5, 2 + width, 4), RectangleRobot(0.2, 0.1)
    for angle in (0, 12.3):  # degrees
        rotate = partial(shapely.affinity.rotate, angle=angle, origin=(2, 2))
        thin = Workspace(((0, 0), (4, 4)), [rotate(wall)])
        places = rotate(shapely.MultiPoint([(1, 2), (2, 0.5), (2 + width, 0.5), (2, 2), (3, 2)]))
        start, tip, other_tip, inside, end = shapely.get_coordinates(places)
        for robot, turn in ((POINT, 0), (DiscRobot(1e-8), 0), (DiscRobot(0.1), 0), (bar, 0), (bar, 1)):
            dof = robot.dof
            rows = [[(*start, 0)[:dof]], [(*end, turn)[:dof]]]
            assert not report([robot], *rows, workspace=thin).valid
        assert not report([POINT], [start], [inside], [end], workspace=thin).valid
        for via in (inside, tip):
            assert report([POINT], [start], [via], [start], workspace=thin).valid
        assert report([POINT], [start], [tip], [other_tip], [end], workspace=thin).valid


CONTACT = Workspace(((-1, -1), (3, 3)), [box(0, 0, 1, 1), box(1, 1, 2, 2)])  # they touch at (1, 1)
ABOVE, BELOW, AT = (0.5, 1.5), (1.5, 0.5), (1, 1)  # on either side of the contact, and on it


CROSSINGS = [
    ([ABOVE, BELOW], 0),
    ([ABOVE, AT, BELOW], 1),
    ([ABOVE, BELOW, AT, ABOVE], 0),
    ([ABOVE, AT, AT, BELOW], 2),
    ([ABOVE, (1 - 1e-10, 1 + 1e-10), AT, (1 + 1e-10, 1 - 1e-10), BELOW], 3),
    ([ABOVE, (1 - 1e-10, 1 + 1e-10), (1 + 1e-10, 1 - 1e-10), BELOW], 2),
    ([(0.9, 1.1), AT, (0.9, 1.2), AT, (1.1, 0.9), BELOW], 3),
    ([AT, ABOVE, AT, BELOW], 2),
    ([(1, 2), AT, (1, 0)], 1),
    ([ABOVE, AT, (0.2, 1.8)], None),
    ([(0, 1), AT, (1, 2)], None),
    ([AT, ABOVE, AT, (0.2, 1.8)], None),
    ([AT, BELOW], None),
    ([AT, AT], None),
]


@pytest.mark.parametrize("robot", [POINT, DiscRobot(1e-10)], ids=["point", "tiny"])
def test_crossing_a_contact_of_obstacles_squeezes(robot):
    squeezing = Workspace(CONTACT.bounds, CONTACT.obstacles, squeeze=True)
    for rows, when in CROSSINGS:
        rows = [[row] for row in rows]
        result = report([robot], *rows, workspace=CONTACT)
        assert (result.valid, result.when) == (when is None, when), result.message
        assert result.valid or "squeezes between obstacles that touch" in result.message
        assert report([robot], *rows, workspace=squeezing).valid


def test_contact_of_three_obstacles_has_three_sides():
    star = [[(2, 2), (2 + c, 2 + s), (2 + d, 2 + t)] for c, s, d, t in
            ((1, -0.3, 1, 0.3), (-0.8, 0.8, -0.3, 1), (-0.8, -0.8, -0.3, -1))]  # fmt: skip
    sides = [(2.4, 2.8), (1.2, 2), (2.4, 1.2)]
    for i, one in enumerate(sides):
        for j, other in enumerate(sides):
            result = report([POINT], [one], [(2, 2)], [other], workspace=Workspace(ROOM.bounds, star))
            assert result.valid == (i == j), (one, other, result.message)


def test_tiny_disc_is_stopped_by_wall():
    radius = 1e-9
    assert not report([DiscRobot(radius)], [(1, 2)], [(2, 2)], [(3, 2)]).valid
    assert not MotionTest(ROOM, DiscRobot(radius))(np.array([(1.0, 2.0)]), np.array([(3.0, 2.0)])).any()


SOLVED = Problem(ROOM, [BAR, DISC], [(1, 1, 0), (3, 1, 0)], [(1, 3, 0), (3, 2.5, 9)])
PATH = np.array([SOLVED.starts, SOLVED.goals])


def test_ends_must_be_exact_except_headings_of_discs():
    assert validate(SOLVED, PATH).valid
    for row, i, axis in ((0, 0, 0), (0, 1, 1), (1, 0, 2), (1, 1, 0)):
        wrong = PATH.copy()
        wrong[row, i, axis] = np.nextafter(wrong[row, i, axis], 10)
        result = validate(SOLVED, wrong)
        assert not result.valid and f"Robot {i} {('begins', 'ends')[row]} at" in result.message
        assert (result.who, result.when) == ((i,), row)
    turned = PATH.copy()
    turned[:, 1, 2] = 5
    assert validate(SOLVED, turned).valid


def test_malformed_paths_are_invalid():
    malformed = [PATH[:0], PATH[0], PATH[:, :1], PATH[..., :2], "path", [[1], [1, 2]]]
    for path in (*malformed, np.ma.masked_array(PATH, True)):
        result = validate(SOLVED, path)
        assert not result.valid and "A path must" in result.message and np.isnan(result.cost)
    assert "solution.path is None, see solution.status" in validate(SOLVED, None).message
    path = np.insert(PATH, 1, PATH[0], axis=0)
    path[1, 1, 0] = np.nan
    result = validate(SOLVED, path)
    assert (result.valid, result.who, result.when) == (False, (1,), 1.0)
    assert "not finite" in result.message


def sampled_clearance(problem, path, num_samples=201):
    """Return the smallest distance over dense samples, by geometry that does not come from the package."""
    if path.shape[2] == 2:
        path = np.pad(path, ((0, 0), (0, 0), (0, 1)))
    bodies = [shapes(robot, along(path[:-1, i], path[1:, i], num_samples)) for i, robot in enumerate(problem.robots)]
    radii = [robot.rounding for robot in problem.robots]
    blocked = shapely.difference(shapely.box(-99, -99, 99, 99), problem.workspace.free_space)
    shapely.prepare(blocked)
    distances = [(shapely.distance(body, blocked) - r).min() for body, r in zip(bodies, radii, strict=True)]
    for i, j in combinations(range(len(bodies)), 2):
        distances.append((shapely.distance(bodies[i], bodies[j]) - radii[i] - radii[j]).min())
    return min(distances)


@pytest.mark.parametrize("one, other", [(BAR, DISC), (WING, PEBBLE)])
def test_random_motions_agree_with_samples_and_planner(one, other):
    rng = np.random.default_rng(8)
    q0, q1 = (q.reshape(30, 2, 3) for q in random_motions(rng, 60, 4.0, 0.3, 0.6))
    planner = JointMotionTest(ROOM, (one, other))(q0, q1)
    solved = 0
    for a, b, free in zip(q0, q1, planner, strict=True):
        try:
            problem = Problem(ROOM, [one, other], a, b)
        except ValueError:
            assert not free
            continue
        result = validate(problem, [a, b])
        sampled = sampled_clearance(problem, np.array([a, b]))
        assert result.valid == free == (sampled > 0)
        if result.valid:
            assert result.clearance == pytest.approx(sampled, abs=3e-3)
            assert result.clearance <= sampled + 1e-6
        solved += result.valid
    assert solved > 2


@pytest.mark.parametrize("seed", range(2))
def test_team_report_is_the_worst_pair_report(seed):
    rng = np.random.default_rng(seed)
    team = [BAR, DISC, WING, PEBBLE, DISC, POINT]
    hall = Workspace(((-3, -3), (12, 9)))
    grid = np.array([(0, 0, 0), (4, 0, 1), (8, 0, 2), (0, 4, 3), (4, 4, 4), (8, 4, 5)])
    q0 = grid + rng.uniform(-1, 1, (6, 3))
    q1 = grid[rng.permutation(6)] if seed % 2 else grid
    q1 = q1 + rng.uniform(-1, 1, (6, 3))
    pairs, alone = [list(pair) for pair in combinations(range(6), 2)], []
    for pair in pairs:
        two = [team[i] for i in pair]
        path = np.array([q0[pair], q1[pair]])[..., : max(robot.dof for robot in two)]
        alone.append(validate(Problem(hall, two, *path), path))
    result = validate(Problem(hall, team, q0, q1), [q0, q1])
    assert result.valid == all(report.valid for report in alone)
    if result.valid:
        assert result.clearance == min(report.clearance for report in alone)
    else:
        first = min((r.when, *(pair[k] for k in r.who)) for r, pair in zip(alone, pairs, strict=True) if not r.valid)
        assert (result.when, *result.who) == first


@pytest.mark.full
@pytest.mark.parametrize(
    ("problem", "solution"),
    [
        ("dbcbs/classic", "dbcbs/solutions/classic_solution"),
        ("dbcbs/swap2_unicycle", "dbcbs/solutions/swap3_unicycle_solution"),  # two of its three robots
        ("dynobench/multirobot/example/swap4_unicycle", "dynobench/multirobot/results/swap4_unicycle_solution"),
        ("dynobench/unicycle1_v0/bugtrap_0", "dynobench/unicycle1_v0/bugtrap_0/idbastar_v0_solution_v0"),
        (
            "dynobench/unicycle1_v0/parallelpark_0",
            "dynobench/unicycle1_v0/parallelpark_0/idbastar_v0_opt_solution_v0",
        ),
    ],
)
def test_published_trajectories_are_valid_until_a_robot_is_moved(data_dir, problem, solution):
    path = _dbcbs.read_trajectories(data_dir / f"{solution}.yaml")
    stated = _dbcbs.read_problem(data_dir / f"{problem}.yaml")
    np.testing.assert_allclose(path[0, : len(stated.robots)], stated.starts, atol=1e-9)
    problem = Problem(stated.workspace, [stated.robots[0]] * path.shape[1], path[0], path[-1])
    result = validate(problem, path)
    assert result.valid, result.message
    assert 0.01 < result.clearance < 0.031  # between its rows, a trajectory may keep less than 0.02
    assert result.clearance <= sampled_clearance(problem, path) + 1e-6
    if path.shape[1] > 1:
        path[30, 0] = path[30, 1]
        result = validate(problem, path)
        assert not result.valid and 0 in result.who and 29 <= result.when <= 30
