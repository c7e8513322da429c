"""Guides: one page for each task, with examples that run.

- `plr_jax.guides.distance_function`: store the distance to a goal in kilobytes.
- `plr_jax.guides.any_two_points`: distances between any two points, and to many goals.
- `plr_jax.guides.heuristics`: lower bounds as heuristics of A* and other searches.
- `plr_jax.guides.buildings`: floors, stairs, lifts, one-way links.
- `plr_jax.guides.inside_jit`: distances inside `jit`, also on maps that are created inside `jit`.
- `plr_jax.guides.changing_map`: obstacles that come and go.
- `plr_jax.guides.costs_and_volumes`: cost maps, voxels, bodies, arms; no oracle needed.
- `plr_jax.guides.cost_distance`: travel times over rasters to the nearest of several sources, for GIS.
- `plr_jax.guides.teams`: plans for one robot or a team, also after changes while robots move.
- `plr_jax.guides.follow_the_field`: paths and directions to the goal.
- `plr_jax.guides.gradients`: derivatives of distances, by points, goals, walls and stored values.
- `plr_jax.guides.c_and_javascript`: queries without JAX.
- `plr_jax.guides.command_line`: the command `plr-jax`.

In Python, `help(plr_jax.guides.teams)` shows a page. On each page, examples run from top to bottom.

# Classes that are called like functions

Oracles, costs and heuristics take batches `(n, dim)`, return `(n,)`, and run on the host, in NumPy. All other classes
in this table take points of shape `(..., dim)`, and return distances of shape `(...)`. These classes also work under
`jax.jit`, except `NumpyPLR` and `NumpyBuildingPLR`, which compute in NumPy.

| class | call | answer |
| --- | --- | --- |
| `plr_jax.PLR` | `plr(x)` | distance to the goal |
| `plr_jax.plr.TunablePLR` | `tunable(x)` | distance to the goal, by values that can be trained |
| `plr_jax.plr.NumpyPLR` | `f(x)` | distance to the goal, in NumPy |
| `plr_jax.plr.PLRStack` | `stack(index, x)` | distance to the goal of PLR number `index` |
| `plr_jax.PairPLR`, `plr_jax.pairs.MetricPairs` | `pairs(x, y)` | distance between two points |
| `plr_jax.pairs.NumpyPairs` | `f(x, y)` | distance between two points, in NumPy |
| `plr_jax.GridPairs` | `pairs(x, y)` | length of a shortest grid path between the cells of two points |
| `plr_jax.pairs.DistanceToCell` | `to_cell(x)` | length of a shortest grid path to one cell |
| `plr_jax.buildings.BuildingPLR` | `plr(floor, x)` | distance to the nearest goal of a building |
| `plr_jax.buildings.NumpyBuildingPLR` | `f(floor, x)` | distance to the nearest goal of a building, in NumPy |
| `plr_jax.buildings.BuildingOracle` | `oracle(floor, x)` | distance to the nearest goal of a building, on the host |
| `plr_jax.pairs.BuildingPairs` | `pairs((floor, x), (floor, y))` | distance between two places of a building |
| `plr_jax.GridDistance` | `field(x)` | distance to the goal |
| `plr_jax.traced.GridDistances` | `field(x, y)` | distance between two points |
| `plr_jax.traced.PolygonDistance` | `field(x)` | distance to the nearest goal |
| `plr_jax.traced.PolygonDistances` | `field(x, y)` | distance between two points |
| `plr_jax.VisibilityGraph`, `plr_jax.Roadmap`, `plr_jax.Euclidean` | `oracle(x)` | distance to the goal |
| `plr_jax.Dubins`, `plr_jax.ReedsShepp` | `oracle(poses)` | length of a car's path; poses are `(n, 3)` |
| `plr_jax.GridField`, `plr_jax.GridGraph`, `plr_jax.VoxelGraph` | `oracle(x)` | distance to the goal |
| `plr_jax.NearestGoal` | `oracle(x)` | distance to the nearest goal |
| `plr_jax.spaces.CostMap`, `plr_jax.spaces.LipschitzCost` | `cost_map(q)` | cost per unit of length at `q`, `(n,)` |
| `plr_jax.RasterCost`, `plr_jax.spaces.DirectionalCost` | `cost_map(q)` | cost per unit of length at `q`, `(n,)` |
| `plr_jax.HeuristicFn` | `heuristic(q)` | cost-to-go of joint configurations `(n, robots, dof)` |
"""

import lazy_loader

__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
