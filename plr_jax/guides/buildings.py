"""Guide: distances through buildings: several floors, stairs, lifts, and links that lead one way.

A `plr_jax.Building` has a `plr_jax.Workspace` for each floor, and a `plr_jax.Link` for each way between two points
that has a cost of its own: a flight of stairs, a lift, an escalator, a door that opens one way, a teleporter. Both
ends of a link may be on one floor. The cost has the unit of the floors: 9 means as much as walking 9 m. For travel
times, scale all coordinates to seconds of walking, and give links their times.

# Exact distances

```python
import numpy as np

import plr_jax

ground = plr_jax.Workspace(((0, 0), (20, 10)), obstacles=[[(8, 0), (8.2, 0), (8.2, 8), (8, 8)]])
upper = plr_jax.Workspace(((0, 0), (20, 10)), obstacles=[[(12, 2), (12.2, 2), (12.2, 10), (12, 10)]])
links = [
    plr_jax.Link(start=(0, (2, 9)), end=(1, (2, 8)), cost=9),  # stairs
    plr_jax.Link((0, (18, 5)), (1, (18, 5)), cost=15),  # a lift
    plr_jax.Link((1, (19, 9)), (0, (12, 5)), cost=0.5, both_ways=False),  # a slide
]
building = plr_jax.Building([ground, upper], links)
oracle = building.oracle(0, (10, 1))  # the goal: floor 0, point (10, 1)

x = ground.sample_free(1000, seed=0)
print(oracle(0, x)[:3], oracle(1, [(1, 1), (19, 1)]))  # distances, costs of links included
print(oracle.which(1, x)[:3])  # the first link of each path; -1: walk to the goal, -2: no path
route = oracle.shortest_path(1, (13, 8))  # a plr_jax.buildings.Route
print(route.length, route.links, route.legs)  # a leg is a floor and points (m, 2)
```

Links are named by their indices in `links`. The floor may also be an array `(n,)`, one index per point. Another goal
needs little more time: `building.oracle(1, (5, 5))` shares the preprocessing. For the nearest of several goals, pass
a list: see *Exits and queues*. If a lift must not be used, as in a fire, make a building without it.

For functions of plr_jax that take one workspace, `oracle[1]` is a `plr_jax.NearestGoal` of points of floor 1. It
returns the same distances as `oracle(1, x)`.

# Kilobytes, proofs, batches

```python
plr = oracle.construct(leaf="cone", max_bytes=2048, certified=True)  # a plr_jax.buildings.BuildingPLR
print(plr(1, (13, 8)), plr.bounds(1, (13, 8)), plr.max_error)  # proven
print(plr.which(0, x[:3]), plr.trace(1, [(13, 8)], building)[0].links)
plr_jax.save(plr, "building.plr")  # one file for all floors; plr_jax.load reads it
f = plr_jax.load_numpy("building.plr")  # a plr_jax.buildings.NumpyBuildingPLR, without JAX
print(f([0, 1], [(1, 1), (13, 8)]))

from pathlib import Path

Path("building.h").write_text(plr.c_header("home"))  # float home_distance(int floor, const float x[2])
plr_jax.plot.page(plr, building.plane).save("building.html")  # a page with a switch of floors
```

`plr(floor, x)` works under `jit`, `vmap` and `grad`, and `construct` takes every leaf and option of
`plr_jax.construct`. All floors lie side by side in one plane: `building.plane` is their workspace, `plr.plane` the
PLR, and point `x` of floor `k` is `x + plr.floors.shift[k]` there. Functions of plr_jax that know no floors take this
PLR and workspace:

```python
ax = plr_jax.plot.plot_contours(plr.plane, workspace=building.plane)
for floor, points in route.legs:
    ax.plot(*(points + plr.floors.shift[floor]).T, color="crimson", marker="o")
plr_jax.plot.save(ax, "building.png")
```

# Any two places

```python
pairs = plr_jax.construct_pairs(building)  # plr_jax.pairs.BuildingPairs
print(pairs((0, x[:3]), (1, (5, 5))), pairs.bounds((0, x[:3]), (1, (5, 5))))
```

A place is a pair of a floor and points; batches are broadcast. With one-way links, the distance back differs.
`pairs.numpy()` answers in NumPy, without compiling. To read a saved file of pairs, `plr_jax.load` needs JAX.

# Levels of a game: jumping down

A jump down a ledge is a one-way link, and so is a teleporter or a zip line. Ways of other costs, such as swimming,
need a cost map: see `plr_jax.guides.costs_and_volumes`.

```python
ledge = plr_jax.Workspace(((0, 0), (12, 6)))
valley = plr_jax.Workspace(((0, -10), (12, 0)), obstacles=[[(5, -10), (6, -10), (6, -1), (5, -1)]])
jumps = [plr_jax.Link((0, (px, 0)), (1, (px, 0)), cost=1, both_ways=False) for px in (1, 3, 9, 11)]
ladder = plr_jax.Link((0, (11.5, 0)), (1, (11.5, 0)), cost=6)
level = plr_jax.Building([ledge, valley], [*jumps, ladder])
print(level.oracle(1, (2, -9)).shortest_path(0, (3, 5)).links)  # down by a jump
print(level.oracle(0, (3, 5)).shortest_path(1, (2, -9)).links)  # up by the ladder
```

# Exits and queues

Several goals may each cost something to use, such as waiting in a queue. Such costs are `offsets`, here 12 m of
walking at the first exit. Distances include the offset of the goal; lengths of routes do not.

```python
exits = [(0, (0, 5)), (0, (20, 5)), (1, (0, 2))]
nearest = building.oracle(exits, offsets=[12, 0, 0])
print(nearest(1, [(1, 8)]), nearest.nearest_goal(1, [(1, 8)]))  # the index of the exit, -1: no path
each = [building.oracle(*place).construct(max_bytes=1024) for place in exits]  # a PLR of each exit
costs = np.array([f(1, [(1, 8)]) for f in each]) + np.array([[12], [0], [0]])
print(costs.argmin(axis=0))  # the index of the exit; if all costs are inf, there is no path
```

PLRs of `nearest.construct` include the offsets. On one floor, `plr_jax.NearestGoal` and `plr_jax.descend` take them.

# Files

`plr_jax.scenes.save_building(building, "building.json")` writes floors and links; `plr_jax.scenes.read_building`
reads them. In the file, a floor may be the name of a file beside it, such as `"ground.wkt"`. On the command line:
`plr-jax build building.json --goal 0,10,1`, then `plr-jax query building.plr` with rows `floor,x,y`.

# Limits

For JavaScript, `plr.plane.js_module()` takes points of the plane. Links have no queues and no time tables. In rooms
from which no goal can be reached, PLRs answer `inf`, except closer than 1/64 of the width of `building.plane` to
points that can reach a goal. All floors lie in equal cells of the plane, so points of a small floor are rounded as
coarsely as those of the largest floor. `construct_pairs` takes at most 8,192 corners and ends of links in all.
"""
