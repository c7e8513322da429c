"""Guide: plan paths for one robot or a team, check them, and replan while robots are under way.

```python
import plr_jax

workspace = plr_jax.Workspace(((0, 0), (10, 10)), [[(4.8, 0), (5.2, 0), (5.2, 4), (4.8, 4)]])
robots = [plr_jax.DiscRobot(0.4), plr_jax.DiscRobot(0.4)]
problem = plr_jax.Problem(workspace, robots, starts=[(2, 2), (8, 2)], goals=[(8, 2), (2, 2)])
solution = plr_jax.bl_plan(problem)

print(solution.status, solution.cost, solution.factor)  # factor: a proven limit of cost / optimal cost
report = plr_jax.validate(problem, solution.path)
assert report.valid, report.message
print(solution.path.shape, solution.path_at(1.5))  # (steps, robots, dof); where all robots are at time 1.5
solution.save("path.json")  # plr_jax.Solution.load reads it
plr_jax.plot.animate(problem, solution.path).save("path.html")
```

# Problems

A `plr_jax.Problem` has a row of `starts` and of `goals` for each robot: `(x, y)`, or `(x, y, heading)` for all robots
if any of them can turn. A `plr_jax.Robot` is convex: `plr_jax.PointRobot` and `plr_jax.DiscRobot` do not turn,
`plr_jax.RectangleRobot` and `plr_jax.PolygonRobot` do. `plr_jax.scenes` has ready-made problems.

The cost of a path is the sum of what the robots travel, plus `rotation_weight` for each radian of turning:
`plr_jax.path_cost`. All robots move from one row of the path to the next at the same time. `plr_jax.makespan` is the
time that this takes, at unit speed.

# The planner

`plr_jax.bl_plan` searches lattices of growing fineness with two searches in turn, LaCAM and best-first search (BL).
It returns the first path that it finds, shortened. Finding no path proves nothing. There are no dynamics.
A `plr_jax.Solution` has a `plr_jax.Status`, which says why the search ended, and `plr_jax.Stats`.

`plr_jax.validate` shares no geometry with the planner. Its `plr_jax.ValidationReport` says whether a path is valid,
how close robots come to obstacles and to one another, and what is wrong first.

# Heuristics, bounds and better paths

Without a heuristic, the planner uses the cost along each robot's lattice, the best choice if you only need a plan. A
`plr_jax.HeuristicFn` replaces it: `plr_jax.zero`, `plr_jax.straight_line`, or `plr_jax.sum_of_distances` of one
distance function for each robot. A heuristic that is a lower bound also raises `solution.lower_bound`, which
otherwise is the length of straight lines. With `cost_factor=1.05` in `plr_jax.BLOptions`, the planner improves the
path until it costs at most 1.05 times the lower bound, or until `time_limit` seconds have passed.

```python
exact = plr_jax.robot_distance_fns(problem)  # one VisibilityGraph for each robot, obstacles grown by its radius
heuristic = plr_jax.sum_of_distances(exact)
better = plr_jax.bl_plan(problem, heuristic, plr_jax.BLOptions(cost_factor=1.05, time_limit=10))
print(solution.lower_bound, better.lower_bound, better.factor)
print(better.status is plr_jax.Status.SOLVED, better.stats.num_nodes, plr_jax.path_cost(problem, better.path))

starts = problem.starts[None]  # one joint configuration, (1, robots, dof)
print(plr_jax.zero()(starts), plr_jax.straight_line(problem)(starts), heuristic(starts))
```

PLRs serve in place of slow distance functions: `sum_of_distances([plr.lower for plr in plrs])`.
For planners of OMPL, `plr_jax.ompl_objective` makes a heuristic of one certified PLR:

```text
setup.setOptimizationObjective(plr_jax.ompl_objective(setup.getSpaceInformation(), plr))
```

# Under way

`plr_jax.replan` keeps the motions of a solution as far as they still lead to the goals. It plans again only for
robots whose goal has changed, or that a new wall or a broken robot stops.

```python
now = plr_jax.Problem(workspace, robots, starts=solution.path_at(1.5), goals=[(8, 8), (2, 2)])
rest = plr_jax.replan(now, solution, at=1.5)
assert plr_jax.validate(now, rest.path).valid
```

`plr_jax.lifelong` gives each robot that arrives its next goal while the others go on. It returns a
`plr_jax.LifelongRun`.

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
print(plr_jax.makespan(run.problem, run.path))
```
"""
