"""Guide: plan paths for one robot or a team, check them, and replan while robots are under way.

```python
import plr_jax

workspace = plr_jax.Workspace(((0, 0), (10, 10)), [[(4.8, 0), (5.2, 0), (5.2, 4), (4.8, 4)]])
robots = [plr_jax.DiscRobot(0.4), plr_jax.DiscRobot(0.4)]
problem = plr_jax.Problem(workspace, robots, starts=[(2, 2), (8, 2)], goals=[(8, 2), (2, 2)])
solution = plr_jax.bl_plan(problem)

print(solution.status, solution.cost, solution.factor)  # cost / optimal cost <= factor, by straight lines
report = plr_jax.validate(problem, solution.path)
assert report.valid, report.message
print(solution.path.shape, solution.path_at(1.5))  # (steps, robots, dof); positions of all robots at time 1.5
solution.save("path.json")  # plr_jax.Solution.load("path.json") reads it
plr_jax.plot.animate(problem, solution.path).save("path.html")  # or "path.gif"
plr_jax.scenes.save(problem, "rooms.json")  # plr_jax.scenes.load reads it; so does `plr-jax plan rooms.json`
```

# Problems

A `plr_jax.Problem` has a row of `starts` and of `goals` for each robot: `(x, y)`, or `(x, y, heading)`, in radians,
if any robot can turn. In such a team, give robots without a heading rows `(x, y, 0)`. A `plr_jax.Robot` is convex:
`plr_jax.PointRobot` and `plr_jax.DiscRobot` do not turn, `plr_jax.RectangleRobot` and `plr_jax.PolygonRobot` do.
`plr_jax.scenes` has ready-made problems. Obstacles have an area: for a wall with corners `(0, 3), (4, 3), (4, 5)`,
pass `shapely.LineString([(0, 3), (4, 3), (4, 5)]).buffer(0.1, cap_style="flat")`.

Paths may touch obstacles and other robots. For a margin of 0.05, plan with robots that are larger by 0.05 on every
side. If robots turn, give both problems the same `rotation_weight`, as the default grows with the robot. Check the
path with the real robots: `plr_jax.validate(problem, solution.path).clearance` is at least 0.05, up to rounding.
Robots stay 0.1 apart.

The cost of a path is the sum of what the robots travel, plus `rotation_weight` for each radian of turning:
`plr_jax.metrics.path_cost`. All robots move from one row of the path to the next at the same time.
`plr_jax.metrics.makespan` is the time that this takes, at unit speed.

# The planner

`plr_jax.bl_plan` searches finer and finer lattices with two alternating searches: LaCAM, and the best-first search of
Barraquand and Latombe. It stops after the first search that succeeds, and shortens the path. If a few discs can move
one after the other, it has a path at once, and searches only three lattices for a cheaper one. If it finds no path,
one may still exist. Paths let robots change speed and direction instantly. A `plr_jax.Solution` has a
`plr_jax.Status`, which says why the search ended, and `plr_jax.planners.Stats`.

`plr_jax.validate` shares no collision test with the planner. Its `plr_jax.ValidationReport` says whether a path is
valid, how close robots come to obstacles and to one another, and what the first violation is.

# Heuristics, bounds and better paths

Without a heuristic, the planner uses each robot's cost-to-go along its lattice. In our experiments, the paths of
other heuristics cost at most 1 % less. The lower bound, `solution.lower_bound`, is then the length of straight
lines. For robots that do not turn, the sum of their exact distances is a better lower bound,
`plr_jax.exact_lower_bound`, also for a path that you already have:

```python
bound = plr_jax.exact_lower_bound(problem)
print(solution.lower_bound, bound, solution.cost / bound)

options = plr_jax.BLOptions(lower_bound=bound, cost_factor=1.05, time_limit=10)
better = plr_jax.bl_plan(problem, options=options)
print(better.status is plr_jax.Status.SOLVED, better.factor, plr_jax.metrics.path_cost(problem, better.path))

starts = problem.starts[None]  # one joint configuration, (1, robots, dof)
exact = plr_jax.robot_distance_fns(problem)  # one VisibilityGraph for each robot, obstacles grown by its radius
print(plr_jax.sum_of_distances(exact)(starts), plr_jax.straight_line(problem)(starts), plr_jax.zero()(starts))
```

With `cost_factor=1.05` in `plr_jax.BLOptions`, the planner improves the path until the cost is at most 1.05 times the
lower bound, `time_limit` seconds (default 60) have passed, or lattices cannot get finer. A factor that is met early
ends the search and the shortening, so the path may cost more than without a factor. The exact lower bound leaves out
the cost of turns, so robots that turn may never reach a small factor.

In place of the cost-to-go along lattices, `bl_plan` accepts a `plr_jax.HeuristicFn`: `plr_jax.zero`,
`plr_jax.straight_line`, or `plr_jax.sum_of_distances` of one distance function for each robot. If the heuristic is a
lower bound, its value at the starts also counts for `solution.lower_bound`. PLRs can replace slow distance functions:
`sum_of_distances([plr.lower for plr in plrs])`.

For planners of OMPL, `plr_jax.ompl_objective` makes a heuristic of one certified PLR:

```text
setup.setOptimizationObjective(plr_jax.ompl_objective(setup.getSpaceInformation(), plr))
```

# Under way

`plr_jax.replan` plans again for robots whose goals have changed or whose paths are blocked, and for robots in their
way. If this fails, it plans for the whole team. All other robots keep their routes, but at other times. So all robots
must switch to the new path at once. For straighter paths, pass `plr_jax.BLOptions(lower_bound=..., cost_factor=1.02)`
with `plr_jax.exact_lower_bound(now)`: if the new path costs over 1.02 times the bound, the whole team is planned.

```python
import numpy as np

at = 1.5
now = plr_jax.Problem(workspace, robots, starts=solution.path_at(at), goals=[(8, 8), (2, 2)])
rest = plr_jax.replan(now, solution, at)
assert plr_jax.validate(now, rest.path).valid

before = solution.path[: np.searchsorted(solution.times, at)]
whole = np.concatenate([before, rest.path])  # the path from the first start to the new goals
assert plr_jax.validate(plr_jax.Problem(workspace, robots, problem.starts, now.goals), whole).valid
```

`plr_jax.lifelong` gives each robot that arrives its next goal, while the other robots go on. It returns a
`plr_jax.planners.LifelongRun`.

```python
docks = [(2, 2), (8, 2), (2, 8), (8, 8)]

def next_goal(robot, goals_of_others):
    taken = {tuple(goal) for goal in goals_of_others.tolist()} | {tuple(last[robot])}
    last[robot] = next(dock for dock in docks if dock not in taken)
    return last[robot]

last = [(8, 2), (2, 2)]
run = plr_jax.lifelong(problem, next_goal, num_goals=6)
print(run.goals, run.times[run.rows])  # which goals were reached, and when
assert plr_jax.validate(run.problem, run.path).valid
print(plr_jax.metrics.makespan(run.problem, run.path))
```
"""
