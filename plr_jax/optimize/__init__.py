"""Above the rooms: descent along a distance field, placements and trajectories, by their gradients."""

from plr_jax.optimize._descend import descend as descend
from plr_jax.optimize._descent import Descent as Descent
from plr_jax.optimize._descent import DescentStatus as DescentStatus
from plr_jax.optimize.placement.place import Placement as Placement
from plr_jax.optimize.placement.place import place as place
from plr_jax.optimize.trajectory.optimize_paths import OptimizationInterrupted as OptimizationInterrupted
from plr_jax.optimize.trajectory.optimize_paths import OptimizedPaths as OptimizedPaths
from plr_jax.optimize.trajectory.optimize_paths import optimize_paths as optimize_paths
