"""Named scenes, the scene file format, and readers of public map formats."""

from plr_jax.scenes._file import is_scene as is_scene
from plr_jax.scenes._file import load as load
from plr_jax.scenes._file import save as save
from plr_jax.scenes._movingai import Scenario as Scenario
from plr_jax.scenes._movingai import read_map as read_map
from plr_jax.scenes._movingai import read_scen as read_scen
from plr_jax.scenes._polygons import read_polygons as read_polygons
from plr_jax.scenes._published import maze as maze
from plr_jax.scenes._published import thin_maze as thin_maze
