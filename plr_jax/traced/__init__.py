"""Shortest-path distances on grids and among polygons that may be traced, inside ``jax.jit``."""

from plr_jax.traced._grid_distance import GridDistance as GridDistance
from plr_jax.traced._grid_distance import GridDistances as GridDistances
from plr_jax.traced._grid_distance import grid_distance as grid_distance
from plr_jax.traced._polygon_distance import PolygonDistance as PolygonDistance
from plr_jax.traced._polygon_distance import PolygonDistances as PolygonDistances
from plr_jax.traced._polygon_distance import polygon_distance as polygon_distance
from plr_jax.traced._polygon_distance import polygons_of_discs as polygons_of_discs
