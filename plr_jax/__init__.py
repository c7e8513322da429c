"""Distance functions over configuration spaces, compressed into kilobytes of planes.

Discover distance (``VisibilityGraph``, ``Roadmap``, ``Euclidean`` or any function of a batch of points), store it
(``construct``, ``save``, ``load``), use it (``plr(x)`` under ``jax.jit``, ``jax.vmap`` and ``jax.grad``; or as the
heuristic of ``bl_plan``, which plans for several robots at once). ``descend`` follows a distance function to its
goal, and ``optimize_paths`` shortens paths.

Names are loaded when they are first used: a program that only loads and queries a PLR imports neither Shapely nor
NetworkX nor Matplotlib, nor the slow parts of SciPy.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from plr_jax import metrics as metrics
    from plr_jax import plot as plot
    from plr_jax import scenes as scenes
    from plr_jax._box import Box as Box
    from plr_jax._problem import Problem as Problem
    from plr_jax._problem import makespan as makespan
    from plr_jax._problem import path_cost as path_cost
    from plr_jax._robot import DiscRobot as DiscRobot
    from plr_jax._robot import PointRobot as PointRobot
    from plr_jax._robot import RectangleRobot as RectangleRobot
    from plr_jax._types import DistanceFn as DistanceFn
    from plr_jax._types import HeuristicFn as HeuristicFn
    from plr_jax._validate import ValidationReport as ValidationReport
    from plr_jax._validate import validate as validate
    from plr_jax._workspace import Workspace as Workspace
    from plr_jax.optimize import Descent as Descent
    from plr_jax.optimize import DescentStatus as DescentStatus
    from plr_jax.optimize import OptimizationInterrupted as OptimizationInterrupted
    from plr_jax.optimize import OptimizedPaths as OptimizedPaths
    from plr_jax.optimize import descend as descend
    from plr_jax.optimize import optimize_paths as optimize_paths
    from plr_jax.oracles import Euclidean as Euclidean
    from plr_jax.oracles import Roadmap as Roadmap
    from plr_jax.oracles import VisibilityGraph as VisibilityGraph
    from plr_jax.oracles import robot_distance_fns as robot_distance_fns
    from plr_jax.planners import BLOptions as BLOptions
    from plr_jax.planners import Solution as Solution
    from plr_jax.planners import Stats as Stats
    from plr_jax.planners import Status as Status
    from plr_jax.planners import bl_plan as bl_plan
    from plr_jax.planners import ompl_plan as ompl_plan
    from plr_jax.planners import sba_star_plan as sba_star_plan
    from plr_jax.planners import straight_line as straight_line
    from plr_jax.planners import sum_of_distances as sum_of_distances
    from plr_jax.planners import zero as zero
    from plr_jax.plr import PLR as PLR
    from plr_jax.plr import CellFit as CellFit
    from plr_jax.plr import ConstructionInterrupted as ConstructionInterrupted
    from plr_jax.plr import ContinuousPLR as ContinuousPLR
    from plr_jax.plr import Refinement as Refinement
    from plr_jax.plr import RefinementInterrupted as RefinementInterrupted
    from plr_jax.plr import best_axis as best_axis
    from plr_jax.plr import center_error as center_error
    from plr_jax.plr import construct as construct
    from plr_jax.plr import construct_continuous as construct_continuous
    from plr_jax.plr import cyclic_axis as cyclic_axis
    from plr_jax.plr import evaluate as evaluate
    from plr_jax.plr import from_bytes as from_bytes
    from plr_jax.plr import largest_error as largest_error
    from plr_jax.plr import least_squares as least_squares
    from plr_jax.plr import load as load
    from plr_jax.plr import maximum_depth as maximum_depth
    from plr_jax.plr import midrange as midrange
    from plr_jax.plr import refine as refine
    from plr_jax.plr import save as save

_MODULES = ("metrics", "plot", "scenes")
_HOME = {
    "Box": "_box",
    "Problem": "_problem",
    "makespan": "_problem",
    "path_cost": "_problem",
    "DiscRobot": "_robot",
    "PointRobot": "_robot",
    "RectangleRobot": "_robot",
    "DistanceFn": "_types",
    "HeuristicFn": "_types",
    "ValidationReport": "_validate",
    "validate": "_validate",
    "Workspace": "_workspace",
    "Descent": "optimize",
    "DescentStatus": "optimize",
    "OptimizationInterrupted": "optimize",
    "OptimizedPaths": "optimize",
    "descend": "optimize",
    "optimize_paths": "optimize",
    "Euclidean": "oracles",
    "Roadmap": "oracles",
    "VisibilityGraph": "oracles",
    "robot_distance_fns": "oracles",
    "BLOptions": "planners",
    "Solution": "planners",
    "Stats": "planners",
    "Status": "planners",
    "bl_plan": "planners",
    "ompl_plan": "planners",
    "sba_star_plan": "planners",
    "straight_line": "planners",
    "sum_of_distances": "planners",
    "zero": "planners",
    "PLR": "plr",
    "CellFit": "plr",
    "ConstructionInterrupted": "plr",
    "ContinuousPLR": "plr",
    "Refinement": "plr",
    "RefinementInterrupted": "plr",
    "best_axis": "plr",
    "center_error": "plr",
    "construct": "plr",
    "construct_continuous": "plr",
    "cyclic_axis": "plr",
    "evaluate": "plr",
    "from_bytes": "plr",
    "largest_error": "plr",
    "least_squares": "plr",
    "load": "plr",
    "maximum_depth": "plr",
    "midrange": "plr",
    "refine": "plr",
    "save": "plr",
}

__all__ = sorted([*_MODULES, *_HOME])


def __getattr__(name: str) -> Any:
    if name in _MODULES:
        return import_module(f"plr_jax.{name}")
    if name not in _HOME:
        raise AttributeError(f"module 'plr_jax' has no attribute {name!r}")
    value = globals()[name] = getattr(import_module(f"plr_jax.{_HOME[name]}"), name)
    return value


def __dir__() -> list[str]:
    return __all__
