"""Distance functions over maps and configuration spaces, compressed into kilobytes and queried in batches under JAX.

The compressed function is a PLR (piecewise linear regression): the map is divided into boxes, and the function has
one simple formula in each box.

```python
import plr_jax

workspace = plr_jax.Workspace(((0, 0), (10, 6)), obstacles=[[(3, 0), (4, 0), (4, 4), (3, 4)]])
oracle = plr_jax.VisibilityGraph(workspace, goal=(9, 1))  # computes exact distances to the goal
plr = plr_jax.construct(oracle, workspace.bounds, leaf="cone", max_bytes=1024, certified=True)  # compresses them

x = workspace.sample_free(1000, seed=0)  # points (n, 2), one per row
distance = plr(x)  # (n,); also under jit, vmap and grad
lower, upper = plr.bounds(x)  # proven
print(plr_jax.metrics.error_map(plr, oracle, x))
plr_jax.save(plr, "field.plr")
```

# Guides, with examples that run

- `plr_jax.guides.distance_function`: maps, exact distances, PLRs, files. `construct`, `certify`, `save`, `load`.
- `plr_jax.guides.any_two_points`: `construct_pairs`, `construct_grid_pairs`, `construct_many`, `stack`.
- `plr_jax.guides.heuristics`: `PLR.lower`, `PLRStack.lower`, `PairPLR.bounds`, for A*.
- `plr_jax.guides.buildings`: `Building`, `Link`, `BuildingPLR`, `BuildingPairs`.
- `plr_jax.guides.inside_jit`: `grid_distance`, on maps that are created inside `jit`.
- `plr_jax.guides.changing_map`: `Workspace.with_obstacles`, `VisibilityGraph.with_workspace`.
- `plr_jax.guides.costs_and_volumes`: `solve_eikonal`; cost maps, voxels, bodies, arms.
- `plr_jax.guides.cost_distance`: `cost_distance` over rasters, for GIS.
- `plr_jax.guides.teams`: `bl_plan`, `validate`, `replan`, `lifelong`.
- `plr_jax.guides.follow_the_field`: `descend`, `trace`.
- `plr_jax.guides.gradients`: `polygon_distance`, `VisibilityGraph.vertex_gradient`, `PLR.tunable`.
- `plr_jax.guides.c_and_javascript`: `PLR.c_header`, `PLR.js_module`, `load_numpy`.
- `plr_jax.guides.command_line`: the command `plr-jax`.

`plr_jax.guides` itself lists, for each class whose objects are called like functions, the arguments and the result.
Modules hold the names that fewer programs need:

- `plr_jax.buildings`, `plr_jax.pairs`, `plr_jax.traced`: classes of results, such as routes and prepared goals.
- `plr_jax.metrics`: errors of PLRs; costs and durations of paths.
- `plr_jax.planners`: statistics of the team planner.
- `plr_jax.plot`: pictures, animations and web pages.
- `plr_jax.plr`: rules of construction, leaf models, and classes of PLRs.
- `plr_jax.scenes`: ready-made maps, and functions that read map files.
- `plr_jax.spaces`: interfaces for spaces and costs of your own.

# Which axis is which

Points are rows `(x, y)` or `(x, y, z)` in every call: queries, starts, goals, agents.

- Pixels and cells are `free[row, column]`, and row 0 has the lowest `y`: `Workspace.from_mask`, `GridGraph`,
  `construct_grid_pairs`, `grid_distance`, and the windows that `GridPairs.window` returns.
- Rasters of numbers are `values[row, column]`, or `values[z, y, x]` in three dimensions, with the last axis along
  `x`: `GridField`, `RasterCost`.
- Voxels are `free[x, y, z]`, with the first axis along `x`: `VoxelSpace`, `VoxelGraph`, `scenes.read_volume`.

In an image, row 0 is the top: use `Workspace.from_mask(free, row0="top")`, and `values[::-1]` for rasters. The
transpose `.T` turns a raster into voxels and back.

A name of this package is imported when it is first used. So loading and querying a PLR imports neither Shapely nor
Matplotlib.
"""

import warnings
from typing import Any

import lazy_loader

__version__ = "0.3.0"
_import_public, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)  # names are listed in __init__.pyi
# Names that were in `plr_jax` in release 0.2, by the module that has them now. Release 0.4 removes this table.
_MOVED = {
    "metrics": "makespan path_cost",
    "pairs": "MetricPairs",
    "planners": "LifelongRun Stats",
    "plr": """CellFit NumpyPLR PLRStack Traces best_axis center_error cyclic_axis largest_error least_squares
        maximum_depth""",
    "spaces": """CellState ConfigurationSpace CostMap DirectionalCost FreeTest LipschitzCost MotionCost SeesBoxes""",
    "traced": "GridDistances",
}
_SUCCESSORS = {name: module for module, names in _MOVED.items() for name in names.split()}


def __getattr__(name: str) -> Any:
    if name not in _SUCCESSORS:
        return _import_public(name)
    module = _SUCCESSORS[name]
    warnings.warn(f"plr_jax.{name} is now plr_jax.{module}.{name}.", DeprecationWarning, stacklevel=2)
    return getattr(_import_public(module), name)
