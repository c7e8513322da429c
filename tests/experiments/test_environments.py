"""Environments of other packages, each where it is installed."""

import importlib
from importlib.metadata import version

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import shapely
from grid_helpers import dijkstra

from plr_jax import Workspace, grid_distance

pytestmark = pytest.mark.full


def bridge(name, package):
    pytest.importorskip(package, reason=f"{package} is not installed: see experiments/environments/__init__.py")
    return importlib.import_module(f"experiments.environments.{name}")


def require_version(distribution, tested):
    if (found := version(distribution)) != tested:
        pytest.skip(f"what is told of {distribution} {tested} may not hold of {found}")


def test_rewards_of_jaxnav_are_those_of_the_way_around():
    jaxnav = bridge("jaxnav", "jaxmarl")
    shaped = jaxnav.ShapedJaxNav(num_agents=2, discount=1.0, weight=1.0)
    unshaped = jaxnav.JaxNav(num_agents=2, weight_g=0.0)
    _, state = jax.jit(shaped.reset)(jax.random.key(0))
    actions = {agent: jnp.array([1.0, 0.1]) for agent in shaped.env.agents}
    _, (after, _), rewards, _, _ = jax.jit(shaped.step)(jax.random.key(1), state, actions)
    *_, without, _, _ = unshaped.step_env(jax.random.key(1), state[0], actions)
    for number, agent in enumerate(shaped.env.agents):
        field = grid_distance(np.asarray(after.map_data) == 0, after.goal[number])
        nearer = field(state[0].pos[number]) - field(after.pos[number])
        assert rewards[agent] - without[agent] == pytest.approx(float(nearer), abs=1e-5)


def test_where_a_map_is_wider_than_high_its_path_length_is_another():
    """``dikstra_path`` of JaxNav numbers cells ``x * w + y``, of which there are fewer than that if ``w > h``."""
    maps = bridge("jaxnav", "jaxmarl") and importlib.import_module("jaxmarl.environments.jaxnav.maps.grid_map")
    for h, w in ((12, 12), (5, 12)):
        free = np.zeros((h, w), bool)
        free[1:-1, 1:-1] = True
        start, end = np.array([1.5, 1.5]), np.array([w - 1.5, h - 1.5])
        theirs = maps.GridMapCircleAgents.dikstra_path(None, jnp.asarray(~free, int), start, end)
        truth = dijkstra(free, (1, 1), 4)[h - 2, w - 2]
        assert grid_distance(free, end, moves=4)(start) == truth
        if w > h:
            require_version("jaxmarl", "0.2.0")
        assert (float(theirs[1]) == truth) == (w <= h)


def test_minimax_is_told_the_steps_that_breadth_first_search_finds():
    """Its own are right where cell (0, 0), from which its flood fill goes on when it is done, is in the same part."""
    maze = bridge("minimax", "minimax")
    theirs = importlib.import_module("minimax.util.graph").shortest_path_len
    env = maze.ShapedMaze(n_walls=60, discount=0.9, weight=1.0)
    kinds = set()
    for seed in range(30):
        _, state = env.reset_env(jax.random.key(seed))
        free = ~np.asarray(state.wall_map)
        (x, y), (x_goal, y_goal) = (np.asarray(each, int) for each in (state.agent_pos, state.goal_pos))
        lengths = dijkstra(free, (y, x), 4)
        truth = lengths[y_goal, x_goal]
        metrics = env.get_env_metrics(state)
        assert metrics["passable"] == np.isfinite(truth)
        assert metrics["shortest_path_length"] == (truth if np.isfinite(truth) else 0)
        is_filled = np.isfinite(lengths[0, 0])
        length = int(theirs(state.wall_map, state.agent_pos, state.goal_pos))
        if is_filled and np.isfinite(truth):
            assert length == truth
        kinds.add((bool(is_filled), bool(np.isfinite(truth)), bool(length == metrics["shortest_path_length"])))
    require_version("minimax-lib", "0.2.0")
    assert {(True, True, True), (True, False, False), (False, True, False)} <= kinds


def check_maze(pairs, free, center, unit):
    """Between the centers of a cell and all others: as long as a path on a grid of finer cells, or little less."""
    fine = 5
    row, column = np.argwhere(free)[0]
    finer = np.kron(free, np.ones((fine, fine), bool))
    octile = dijkstra(finer, (row * fine + 2, column * fine + 2), 8) * unit / fine
    cells = np.argwhere(free)
    ours = np.asarray(pairs(center((row, column)), np.array([center(cell) for cell in cells])))
    truth = octile[tuple(cells.T * fine + 2)]
    assert np.isfinite(truth).all()
    assert (ours <= truth + 1e-4).all() and (truth <= 1.1 * ours + unit).all()
    straight = (cells == (row, column)).any(axis=1) & (truth < unit * 1.5)
    np.testing.assert_allclose(ours[straight], truth[straight], atol=1e-4)


@pytest.mark.parametrize("name", ["PointMaze_UMaze-v3", "PointMaze_Large_Diverse_G-v3", "AntMaze_UMaze-v5"])
def test_mazes_of_gymnasium_robotics(name):
    robotics = bridge("gymnasium_robotics", "gymnasium_robotics")
    env = robotics.gymnasium.make(name, continuing_task=False)
    maze = env.unwrapped.maze
    free = np.array([[cell != 1 for cell in row] for row in maze.maze_map])
    pairs = robotics.maze_distance(env)
    check_maze(pairs, free, maze.cell_rowcol_to_xy, maze.maze_size_scaling)
    shaped = robotics.ShapedMaze(env, discount=0.9)
    before, _ = shaped.reset(seed=0)
    after, reward, *_ = shaped.step(env.action_space.sample())
    distances = [float(pairs(each["achieved_goal"], after["desired_goal"])) for each in (before, after)]
    assert reward == pytest.approx(distances[0] - 0.9 * distances[1], abs=1e-5)  # sparse: 0 else


@pytest.mark.parametrize("name", ["pointmaze-medium-v0", "pointmaze-giant-v0", "antmaze-large-v0"])
def test_mazes_of_ogbench(name):
    ogbench = bridge("ogbench", "ogbench")
    env = ogbench.WithDistance(ogbench.gymnasium.make(name))
    maze = env.unwrapped
    check_maze(env.distance, maze.maze_map == 0, maze.ij_to_xy, maze._maze_unit)
    env.reset(seed=0)
    *_, info = env.step(env.action_space.sample())
    _, steps = maze.get_oracle_subgoal(maze.get_xy(), maze.cur_goal_xy)
    line = np.linalg.norm(maze.get_xy() - maze.cur_goal_xy)
    assert line - 1e-4 <= info["distance"] <= (steps[maze.xy_to_ij(maze.get_xy())] + 1) * maze._maze_unit


@pytest.mark.parametrize("layout", ["u_maze", "big_maze_eval", "hardest_maze"])
def test_mazes_of_jaxgcrl(layout):
    jaxgcrl = bridge("jaxgcrl", "jaxgcrl")
    free = np.array([[cell != 1 for cell in row] for row in getattr(jaxgcrl.ant_maze, layout.upper())])
    check_maze(jaxgcrl.maze_distance(layout), free, lambda cell: 4.0 * np.asarray(cell), 4.0)


def test_agents_of_jupedsim_walk_around_a_wall_to_the_nearest_exit():
    pedestrians = bridge("jupedsim", "jupedsim")
    hall = Workspace(((0, 0), (12, 6)), [[(5, 0), (6, 0), (6, 4), (5, 4)]])
    left, right = (
        [(0.5, 0.5), (1.5, 0.5), (1.5, 1.5), (0.5, 1.5)],
        [(10.5, 0.5), (11.5, 0.5), (11.5, 1.5), (10.5, 1.5)],
    )
    exits = pedestrians.Exits(hall, [left, right])
    starts = np.array([(4.0, 1.0), (4.0, 2.0), (4.5, 3.0), (7.0, 1.0), (7.0, 2.0)])
    nearest, targets = exits.targets(starts)
    np.testing.assert_array_equal(nearest, [0, 0, 0, 1, 1])
    np.testing.assert_allclose(targets, [(1, 1)] * 3 + [(11, 1)] * 2, atol=1e-5)
    around = pedestrians.Exits(hall, [right])
    _, targets = around.targets(starts[:3])
    np.testing.assert_allclose(targets, [(5 - pedestrians.RADIUS, 4 + pedestrians.RADIUS)] * 3, atol=1e-5)
    corners = np.linalg.norm(starts[:3] - (5, 4), axis=1) + 1 + np.hypot(5, 3)
    for is_steered in (False, True):
        seconds, stuck = pedestrians.evacuate(hall, around, starts[:3], is_steered=is_steered, limit=60)
        assert len(seconds) == 3 and len(stuck) == 0
        assert seconds[0] >= (corners.min() - 1) / 1.2  # nobody is faster than 1.2 m/s, to a corner of the exit


def test_routes_of_jupedsim_beside_exact_ones():
    pedestrians = bridge("jupedsim_routes", "jupedsim")
    hall = Workspace(((0, 0), (12, 6)), [[(5, 0), (6, 0), (6, 4), (5, 4)]])
    found = pedestrians.compare_routes(hall, np.array([(7.0, 1.0)]), np.array([[(4.0, 1.0), (8.0, 3.0)]]), 512)
    exact = np.array([2 * np.hypot(1, 3) + 1, np.hypot(1, 2)])
    for name, routes in found.items():
        lengths = [np.linalg.norm(np.diff(path, axis=0), axis=1).sum() for path in routes.paths]
        np.testing.assert_allclose(routes.over_exact, lengths / exact, rtol=1e-9)
        np.testing.assert_array_equal(routes.depth, 0)
        assert (routes.over_exact >= 1 - 1e-6).all() and (
            routes.over_exact < (1.1 if name == "JuPedSim" else 1 + 1e-6)
        ).all()
    through = shapely.linestrings([[(4, 1), (7, 1)], [(4, 5), (7, 5)]])
    np.testing.assert_allclose(pedestrians._depths(hall, through), [0.5, 0], atol=0.005)
