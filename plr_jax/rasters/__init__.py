"""Cost distance over rasters: the least accumulated cost between each cell and the nearest source."""

from plr_jax.rasters._cost_distance import CostDistance as CostDistance
from plr_jax.rasters._cost_distance import cost_distance as cost_distance
