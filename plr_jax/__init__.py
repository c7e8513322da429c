"""Distance functions over configuration spaces, compressed into kilobytes of planes.

A `DistanceFn` is any function of points ``(n, dim)`` that answers distances ``(n,)``, ``inf`` where the goal cannot
be reached; a `HeuristicFn` answers costs-to-go ``(n,)`` of joint configurations ``(n, robots, dof)``.

# Discover: how far is it?

```python
import plr_jax

workspace = plr_jax.Workspace(((0, 0), (10, 6)), obstacles=[[(3, 0), (4, 0), (4, 4), (3, 4)]])
oracle = plr_jax.VisibilityGraph(workspace, goal=(9, 1))
```

- Where: `Workspace`, `Box`; ready-made and from files, `scenes`; for several robots, `Problem`, of a
  `Robot`: `PointRobot`, `DiscRobot`, `RectangleRobot`, `PolygonRobot`.
- Oracles: `VisibilityGraph`, `Roadmap`, `Euclidean`, `Dubins`, `ReedsShepp`, `GridField`, `GridGraph`, `VoxelGraph`,
  `NearestGoal`; `robot_distance_fns`, one for each robot.
- Inside `jit`, on maps that are arrays and change: `grid_distance`, to a goal a `GridDistance`, else `GridDistances`.
- Without an oracle, `solve_eikonal` takes a space, `PlaneSpace`, `VoxelSpace`, `RigidBodySpace`, `PlanarArm`, of any
  robot by its clearance a `ClearanceSpace`, or your own, a `FreeTest`, `SeesBoxes` or `ConfigurationSpace`, which
  tells a `CellState`; what a motion costs there is a `MotionCost`: `CostMap`, `RasterCost`,
  `LipschitzCost`, or your own `DirectionalCost`.

**Which axis of an array is which.** Points are rows `(x, y)` or `(x, y, z)` in every call: queries, starts, goals,
and the agents of `GridPairs.window`.

- Pixels and cells are `free[row, column]`, rows along `y`, row 0 at the lowest: `Workspace.from_mask`, `GridGraph`,
  `construct_grid_pairs`, `grid_distance`, and what `GridPairs.window` returns.
- Rasters of numbers are `values[row, column]` likewise, in space `values[z, y, x]`, the last axis along `x`:
  `GridField`, `RasterCost`.
- Voxels are `free[x, y, z]`, the first axis along `x`: `VoxelSpace`, `VoxelGraph`, `scenes.read_volume`.

The first row of a picture is its top: use `Workspace.from_mask(free, row0="top")`, and `values[::-1]`. The transpose
`.T` turns a raster into voxels and back.

# Store: the answer in kilobytes

```python
field = plr_jax.construct(oracle, workspace.bounds, max_bytes=1024, certified=True)
plr_jax.save(field, "field.plr")
field = plr_jax.load("field.plr")
```

- A `PLR` of one goal: `construct`, with many goals `construct_many`; of a changed map: `plr.updated`; proofs:
  `certify`.
- Pairs, of any two points: `construct_pairs` makes a `PairPLR`, quickest to goals that it has `prepared`;
  `construct_grid_pairs` `GridPairs`, `construct_metric_pairs` `MetricPairs`; more in
  `pairs`.
- Files: `save` and `load`, `from_bytes`; without JAX `load_numpy`, a `NumpyPLR`.
- How `construct` works, `BuildOptions`: a `CellFit`, `least_squares`; `largest_error`,
  `center_error`, `maximum_depth`; `best_axis`, `cyclic_axis`. Cut short, `construct` warns:
  `ConstructionInterrupted`. Formats and arithmetic are in `plr`.

# Use: in a batch, under a gradient, in a planner

```python
import jax
import numpy as np

x = workspace.sample_free(1000, seed=0)
distance, slope = field(x), jax.vmap(jax.grad(field))(x)
lower, upper = field.bounds(x)
```

- A PLR is called, which is `evaluate`; several at once: `stack` makes a `PLRStack`. `trace` reads paths from cones,
  `Traces` with a `TraceStatus`.
- `descend` follows a field to its goal (`Descent`, `DescentStatus`).
- `bl_plan` plans for a team, with `BLOptions`, led by `zero`, `straight_line` or `sum_of_distances`; it returns a
  `Solution`, with `Status` and `Stats`; a team that is under way: `replan`; goals that keep coming: `lifelong`, a
  `LifelongRun`. `ompl_objective` leads planners of OMPL.

# Look: is it right?

```python
print(plr_jax.metrics.error_map(field, oracle, x))
plr_jax.plot.plot_contours(field, workspace=workspace, goal=(9, 1))
```

- `metrics` measures errors, `plot` draws; `validate` checks a path by geometry of its own, a
  `ValidationReport`; `path_cost` and `makespan` say what it costs and takes.

The names are listed in ``__init__.pyi`` and loaded when they are first used: a program that only loads and
queries a PLR imports neither Shapely nor NetworkX nor Matplotlib, nor the slow parts of SciPy.
"""

import lazy_loader

__version__ = "0.2.0"
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # the list is in __init__.pyi
