"""Shortest-path distances on grids whose cells may be traced, inside ``jax.jit``."""

from plr_jax.traced._grid_distance import GridDistance as GridDistance
from plr_jax.traced._grid_distance import GridDistances as GridDistances
from plr_jax.traced._grid_distance import grid_distance as grid_distance
