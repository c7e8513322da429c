"""Oracles: distances to a goal, computed on the host from a map, a roadmap, a grid, or in closed form."""

from plr_jax.oracles._car import Dubins as Dubins
from plr_jax.oracles._car import ReedsShepp as ReedsShepp
from plr_jax.oracles._euclidean import Euclidean as Euclidean
from plr_jax.oracles._euclidean import NearestGoal as NearestGoal
from plr_jax.oracles._grids import GridField as GridField
from plr_jax.oracles._grids import GridGraph as GridGraph
from plr_jax.oracles._grids import VoxelGraph as VoxelGraph
from plr_jax.oracles._roadmap import Roadmap as Roadmap
from plr_jax.oracles._robot_distances import robot_distance_fns as robot_distance_fns
from plr_jax.oracles._visibility_graph import VisibilityGraph as VisibilityGraph
