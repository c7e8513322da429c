"""Scenes of our experiments, the scene file format, readers of public map formats, and random variants.

All readers raise ``OSError`` if a file cannot be read.
"""

from plr_jax.scenes._file import is_scene, load, save
from plr_jax.scenes._geojson import read_geojson, read_polygons, read_wkt
from plr_jax.scenes._movingai import Scenario, read_cells, read_map, read_scen
from plr_jax.scenes._pictures import read_cost_map, read_image, read_map_server
from plr_jax.scenes._published import (
    cross,
    crowd,
    door,
    floor_plan,
    four_rooms,
    maze,
    perturbed,
    single_door,
    tangle,
    thin_maze,
)
from plr_jax.scenes._volumes import read_volume
from plr_jax.scenes._workspaces import read_workspace

__all__ = [
    "Scenario",
    "cross",
    "crowd",
    "door",
    "floor_plan",
    "four_rooms",
    "is_scene",
    "load",
    "maze",
    "perturbed",
    "read_cells",
    "read_cost_map",
    "read_geojson",
    "read_image",
    "read_map",
    "read_map_server",
    "read_polygons",
    "read_scen",
    "read_volume",
    "read_wkt",
    "read_workspace",
    "save",
    "single_door",
    "tangle",
    "thin_maze",
]
