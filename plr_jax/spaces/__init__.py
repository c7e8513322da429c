"""Configuration spaces: which configurations and boxes of configurations are free, and what a motion costs."""

from plr_jax.spaces._arm import PlanarArm as PlanarArm
from plr_jax.spaces._clearance import ClearanceSpace as ClearanceSpace
from plr_jax.spaces._costs import CostMap as CostMap
from plr_jax.spaces._costs import DirectionalCost as DirectionalCost
from plr_jax.spaces._costs import LipschitzCost as LipschitzCost
from plr_jax.spaces._costs import cost_bounds as cost_bounds
from plr_jax.spaces._costs import motion_costs as motion_costs
from plr_jax.spaces._costs import pulled as pulled
from plr_jax.spaces._plane import PlaneSpace as PlaneSpace
from plr_jax.spaces._raster_cost import RasterCost as RasterCost
from plr_jax.spaces._rigid_body import RigidBodySpace as RigidBodySpace
from plr_jax.spaces._space import CellState as CellState
from plr_jax.spaces._space import CheckedFreeTest as CheckedFreeTest
from plr_jax.spaces._space import ConfigurationSpace as ConfigurationSpace
from plr_jax.spaces._space import FreeTest as FreeTest
from plr_jax.spaces._space import MotionCost as MotionCost
from plr_jax.spaces._space import SeesBoxes as SeesBoxes
from plr_jax.spaces._space import Separable as Separable
from plr_jax.spaces._space import require_space as require_space
from plr_jax.spaces._voxels import VoxelSpace as VoxelSpace
