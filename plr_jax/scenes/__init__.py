"""Named scenes, the scene file format, readers of public formats, and variants of a problem."""

from plr_jax.scenes._dbcbs import read_dbcbs as read_dbcbs
from plr_jax.scenes._dbcbs import read_trajectories as read_trajectories
from plr_jax.scenes._file import is_scene as is_scene
from plr_jax.scenes._file import load as load
from plr_jax.scenes._file import save as save
from plr_jax.scenes._movingai import Scenario as Scenario
from plr_jax.scenes._movingai import read_map as read_map
from plr_jax.scenes._movingai import read_scen as read_scen
from plr_jax.scenes._perturbed import perturbed as perturbed
from plr_jax.scenes._polygons import read_polygons as read_polygons
from plr_jax.scenes._published import cross as cross
from plr_jax.scenes._published import floor_plan as floor_plan
from plr_jax.scenes._published import four_rooms as four_rooms
from plr_jax.scenes._published import maze as maze
from plr_jax.scenes._published import single_door as single_door
from plr_jax.scenes._published import tangle as tangle
from plr_jax.scenes._published import thin_maze as thin_maze
