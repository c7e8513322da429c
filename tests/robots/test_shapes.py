"""A shape is one class: what it states is all that planners, checks, pictures and optimization read."""

from dataclasses import dataclass, replace

import numpy as np
import pytest
from PIL import Image
from robot_helpers import PEBBLE, WING, AnyShape, pebble, sled

from plr_jax import (
    DiscRobot,
    PointRobot,
    PolygonRobot,
    Problem,
    RectangleRobot,
    Robot,
    Workspace,
    bl_plan,
    optimize_paths,
    path_cost,
    plot,
    robot_distance_fns,
    scenes,
    sum_of_distances,
    validate,
)

# A door, 1.2 wide, between two rooms.
DOOR = Workspace(
    ((0, 0), (6, 3)), [[(2.9, 0), (3.1, 0), (3.1, 0.9), (2.9, 0.9)], [(2.9, 2.1), (3.1, 2.1), (3.1, 3), (2.9, 3)]]
)


@dataclass(frozen=True)
class Hexagon(Robot):
    """A regular hexagon that turns about its center."""

    side: float
    rounding = 0.0
    dof = 3

    @property
    def core(self):
        angle = np.arange(6) * np.pi / 3
        return self.side * np.stack([np.cos(angle), np.sin(angle)], axis=1)


def swap(first, second):
    """Two robots that change rooms through the door."""
    ends = np.array([(1.0, 1.0, 0.3), (5.0, 2.0, -2.0)])[:, : max(first.dof, second.dof)]
    return Problem(DOOR, [first, second], ends, ends[::-1])


def planned(problem):
    """A path that the planner finds and an independent check finds valid."""
    solution = bl_plan(problem, sum_of_distances(robot_distance_fns(problem)))
    report = validate(problem, solution.path)
    assert solution.solved and report.valid, report.message
    return solution


@pytest.mark.parametrize("first, second", [(Hexagon(0.3), PEBBLE), (WING, DiscRobot(0.25)), (sled(), PointRobot())])
def test_any_convex_shape_plans_and_its_path_is_checked_and_drawn(first, second, tmp_path):
    problem = swap(first, second)
    animation = plot.animate(problem, planned(problem).path, seconds=0.2)
    for ending in ("gif", "html"):
        animation.save(tmp_path / f"path.{ending}")
    with Image.open(tmp_path / "path.gif") as image:
        assert image.n_frames == 5


def test_any_convex_shape_is_optimized():
    """Two bodies side by side make a detour through a row in the middle."""
    starts, goals = (np.array([(x, 1.0, 0.5), (x, 2.2, -0.5)]) for x in (1.0, 2.3))
    problem = Problem(DOOR, [PEBBLE, sled()], starts, goals)
    path = np.stack([starts, (starts + goals) / 2 + np.array([0.0, 0.3, 0.0]), goals])
    assert validate(problem, path).valid
    better = optimize_paths(problem, path, num_retimings=0, num_iterations=50)
    assert better.valid.all() and validate(problem, better.path).valid
    assert path_cost(problem, [starts, goals]) <= better.cost < 0.99 * path_cost(problem, path)


def test_turning_costs_the_way_of_the_farthest_point():
    problem = Problem(DOOR, [Hexagon(0.3), PEBBLE, DiscRobot(0.1)], *(
        [(1.0, 0.5, 0.0), (1.0, 1.6, 0.0), (1.0, 2.6, 0.0)] for _ in range(2)
    ))  # fmt: skip
    np.testing.assert_allclose(problem.rotation_weights, [0.3, 0.36 + 0.12, 0.0])
    assert Problem(DOOR, [sled()], [(1, 1)], [(2, 1)]).dof == 2


def test_a_polygon_goes_where_a_rectangle_goes():
    """The same shape by its vertices."""
    box = RectangleRobot(0.7, 0.3)
    ends = np.array([(1.0, 1.5, 0.0), (5.0, 1.5, 0.2)])
    rectangle, polygon = (Problem(DOOR, [r], ends[:1], ends[1:]) for r in (box, PolygonRobot(box.core)))
    solution = planned(polygon)
    assert solution.cost == pytest.approx(planned(rectangle).cost, rel=1e-9)
    assert validate(rectangle, solution.path).valid


def test_a_scene_file_refuses_a_shape_that_it_has_no_word_for(tmp_path):
    with pytest.raises(ValueError, match=r"Robot 0 cannot be saved: .* polygon, got Hexagon\(side=0.3\)"):
        scenes.save(swap(Hexagon(0.3), WING), tmp_path / "a.json")
    assert list(tmp_path.iterdir()) == []


SQUARE = AnyShape(((-1, -1), (1, -1), (1, 1), (-1, 1)))


@pytest.mark.parametrize(
    ("robot", "message"),
    [
        (replace(SQUARE, body=SQUARE.body[::-1]), "be convex, its vertices counterclockwise"),
        (replace(SQUARE, body=(*SQUARE.body, (-1, 1))), "each given once"),
        (replace(SQUARE, body=()), "core of finite vertices"),
        (replace(SQUARE, body=((np.nan, 0),)), "core of finite vertices"),
        (replace(SQUARE, rounding=-1.0), "finite rounding"),
        (replace(SQUARE, dof=4), "dof of 2 or 3"),
        (AnyShape(((1.0, 0.0),), rounding=0.5), "reference point"),
    ],
)
def test_a_problem_refuses_what_is_no_convex_body_about_its_reference_point(robot, message):
    with pytest.raises(ValueError, match=f"Robot 0 must .*{message}"):
        Problem(Workspace(((0, 0), (9, 9))), [robot], [(4, 4, 0)], [(5, 5, 0)])


def test_a_disc_may_turn_about_any_point_of_it():
    """On a wheel: half a turn about a point of its rim swings it past what it only touches at both ends."""
    wheel = AnyShape(((0.5, 0.0),), rounding=0.5)
    problem = Problem(
        Workspace(((0, 0), (9, 9))), [wheel, PointRobot()], [(4, 4, 0), (4, 4.9, 0)], [(4, 4, np.pi), (4, 4.9, 0)]
    )
    assert wheel.inscribed_radius == 0.0 and wheel.circumscribed_radius == 1.0
    report = validate(problem, [problem.starts, problem.goals])
    assert not report.valid and report.who == (0, 1)


def test_pebbles_are_values():
    assert pebble() == pebble() and len({pebble(), pebble(), pebble(0.2)}) == 2
